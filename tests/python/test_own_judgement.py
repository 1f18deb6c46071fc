"""Rewards, ends and tasks of one's own: expressions, functions, files."""

import copy
import pickle
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import crazyflie_gym
import crazyflie_gym.options
import crazyflie_gym.parallel
from crazyflie_gym import CrazyflieEnv, CrazyflieSwarm, CrazyflieVectorEnv

ROOT = Path(__file__).resolve().parents[2]
EFFECTS = {"camera_noise": {"xy_m": 0.004}, "gust": {"sigma_mps2": 0.3}}
EXPRESSION = "exp(-4*dist**2) - 0.01*rate2"


def reward(dist, rate2):
    """Return what EXPRESSION says."""
    return np.exp(-4 * dist**2) - 0.01 * rate2


def far_out(pos_m):
    """Return whose flight ends."""
    return np.abs(pos_m[..., 0]) > 0.5


def actions(env, step):
    """Return actions that depend on the step alone."""
    rng = np.random.default_rng(step)
    return rng.uniform(-0.6, 0.6, env.action_space.shape).astype(np.float32)


@pytest.mark.parametrize("task", [entry["name"] for entry in crazyflie_gym.tasks()])
def test_an_expression_and_a_function_give_the_same(task):
    # the others learn of an end by a function a step later, which shows where they wait for each other
    ends = (None, None) if task in ("follow", "land_in_turn") else ("abs(pos_m[0]) > 0.5", far_out)
    own = [
        CrazyflieVectorEnv(
            20, task, effects=EFFECTS, reward=given, termination=end, max_episode_steps=60, autoreset_mode="next_step"
        )
        for given, end in zip((EXPRESSION, reward), ends, strict=True)
    ]
    for env in own:
        env.reset(seed=3)
    ended = 0
    for step in range(150):
        (rows, a, over, late, info), (others, b, over_too, late_too, info_too) = [
            env.step(actions(env, step)) for env in own
        ]
        np.testing.assert_array_equal(rows, others, err_msg=f"step {step}")
        np.testing.assert_allclose(a, b, atol=1e-5, err_msg=f"step {step}")
        np.testing.assert_array_equal(over, over_too, err_msg=f"step {step}")
        np.testing.assert_array_equal(late, late_too)
        if "flying" in info:
            np.testing.assert_array_equal(info["flying"], info_too["flying"])
        ended += np.count_nonzero(~info["flying"] if "flying" in info else over)
    assert ended > 0


def test_a_single_environment_and_a_swarm_take_them():
    for given in (EXPRESSION, reward):
        env = CrazyflieEnv(reward=given, termination="dist > 3", effects=EFFECTS)
        env.reset(seed=1)
        _, value, *_ = env.step(np.zeros(4, np.float32))
        assert 0 < value < 1
        swarm = CrazyflieSwarm(3, "swap", reward=given)
        swarm.reset(seed=1)
        _, values, *_ = swarm.step(np.zeros((3, swarm.num_drones, 4), np.float32))
        assert values.shape == (3, swarm.num_drones) and (values > 0).all()
    one = CrazyflieEnv(termination=lambda time_s: time_s > 0.05, reward=reward)
    one.reset(seed=0)
    assert [one.step(np.zeros(4, np.float32))[2] for _ in range(3)] == [False, False, True]
    with pytest.raises(RuntimeError, match="has ended"):
        one.step(np.zeros(4, np.float32))


def test_a_function_s_flights_can_be_copied_pickled_and_taken_back():
    env = CrazyflieVectorEnv(5, reward=reward, termination=far_out, effects=EFFECTS)
    env.reset(seed=9)
    for step in range(40):
        env.step(actions(env, step))
    state = env.get_state()
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    want = [env.step(actions(env, step)) for step in range(40, 80)]
    env.set_state(state)
    for other in (env, *others):
        for step, before in zip(range(40, 80), want, strict=True):
            for a, b in zip(other.step(actions(other, step))[:4], before[:4], strict=True):
                np.testing.assert_array_equal(a, b)


def test_what_is_wrong_with_a_function_is_said():
    env = CrazyflieVectorEnv(4, reward=lambda dist: dist[:2])
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"reward: expected an array of shape \(4,\) from the function, got \(2,\)"):
        env.step(np.zeros((4, 4), np.float32))
    env = CrazyflieVectorEnv(4, reward=lambda time_s: np.where(time_s > 0.03, [1, 1, np.nan, 1], 0.0))
    env.reset(seed=0)
    env.step(np.zeros((4, 4), np.float32))
    with pytest.raises(ValueError, match=r"gives nan in environment 2, at step 2 of its episode"):
        env.step(np.zeros((4, 4), np.float32))
    env = CrazyflieVectorEnv(4, termination=lambda dist: dist)
    env.reset(seed=0)
    with pytest.raises(TypeError, match="expected bools"):
        env.step(np.zeros((4, 4), np.float32))
    with pytest.raises(ZeroDivisionError):
        env = CrazyflieVectorEnv(4, reward=lambda dist: 1 / 0)
        env.reset(seed=0)
        env.step(np.zeros((4, 4), np.float32))
    for wrong, words in [
        (lambda dst: dst, 'did you mean "dist"'),
        (lambda *fields: 0, "names of fields"),
        (lambda: 0, "names of fields"),
    ]:
        with pytest.raises(ValueError, match=words):
            CrazyflieVectorEnv(4, reward=wrong)
    with pytest.raises(TypeError, match="expected an expression or a function, got float"):
        CrazyflieVectorEnv(4, reward=1.0)
    with pytest.raises(ValueError, match="next_step"):
        CrazyflieVectorEnv(4, termination=far_out, autoreset_mode="same_step")
    with pytest.raises(ValueError, match="a server cannot call a function"):
        CrazyflieVectorEnv(4, reward=reward, remote="ws://127.0.0.1:1")


def test_what_is_wrong_with_an_expression_is_said():
    for wrong, words in [
        ("exp(-4*dst**2)", 'column 8: unknown field "dst"'),
        ("dist + speed", "in m and one in m/s"),
        ("dist <", "column 7"),
    ]:
        with pytest.raises(ValueError, match=words):
            gymnasium.make("Crazyflie-v0", reward=wrong)
    env = CrazyflieVectorEnv(4, reward="log(0.03 - 1*time_s)")
    env.reset(seed=0)
    env.step(np.zeros((4, 4), np.float32))
    with pytest.raises(ValueError, match="is NaN in environment 0, drone 0, at step 2"):
        env.step(np.zeros((4, 4), np.float32))


def test_a_task_file_is_an_id(tmp_path):
    path = ROOT / "examples/tasks/climb.toml"
    task = crazyflie_gym.register_task(path)
    assert task == "crazyflie/climb-v0" and gymnasium.spec(task).max_episode_steps == 300
    env = gymnasium.make(task)
    assert env.reset(seed=0)[0].shape == (24,)
    assert env.unwrapped.sim.states()[0, 2] == pytest.approx(0.3)
    batch = gymnasium.make_vec(task, 3)
    batch.reset(seed=0)
    for _ in range(299):
        _, _, _, truncated, _ = batch.step(np.tile(np.float32([0, 0, 0, 0.5]), (3, 1)))
        assert not truncated.any()
    assert batch.step(np.zeros((3, 4), np.float32))[3].any()
    batch = crazyflie_gym.make_task({"name": "short", "max_episode_steps": 5, "reward": "1 - 2*dist"}, num_envs=2)
    batch.reset(seed=0)
    assert [bool(batch.step(np.zeros((2, 4), np.float32))[3].all()) for _ in range(5)] == [False] * 4 + [True]
    costly = crazyflie_gym.make_task({"name": "costly", "cost": "2 + 1*dist"})
    costly.reset(seed=0)
    assert costly.step(np.zeros(4, np.float32))[4]["cost"] > 2
    bad = tmp_path / "bad.toml"
    bad.write_text('name = "bad"\nrewrd = "dist"\n')
    with pytest.raises(ValueError, match=r'bad.toml.*did you mean "reward"'):
        crazyflie_gym.make_task(bad)
    with pytest.raises(FileNotFoundError):
        crazyflie_gym.make_task(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="reward"):
        crazyflie_gym.register_task({"name": "f", "reward": reward})


def test_the_page_has_every_field_and_function_and_its_code_runs(monkeypatch, tmp_path):
    page = (ROOT / "docs/rewards.md").read_text()
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("| `")
    ]
    observed = {field["name"] for field in crazyflie_gym.observable_fields()}
    own = [field for field in crazyflie_gym.expression_fields() if field["name"] not in observed]
    count = {1: ""}
    assert rows == [
        [f"`{f['name']}`" + count.get(f["length"], f" ({f['length']})"), f["unit"], f["about"]] for f in own
    ]
    for name in crazyflie_gym.expression_functions():
        assert f"`{name}`" in page, name
    assert (ROOT / "examples/tasks/climb.toml").read_text().split("\n", 1)[1] == (
        page.split("<<END\n")[1].split("END\n```")[0]
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "climb.toml").write_bytes((ROOT / "examples/tasks/climb.toml").read_bytes())
    blocks = [block.split("```")[0] for block in page.split("```python\n")[1:]]
    assert len(blocks) == 3
    for block in blocks:
        exec(compile(block, "docs/rewards.md", "exec"), {})


def test_the_fields_are_listed_with_their_units():
    fields = {field["name"]: field for field in crazyflie_gym.expression_fields()}
    assert fields["dist"]["unit"] == "m" and fields["rate2"]["unit"] == "rad^2/s^2"
    assert {"exp", "norm", "min"} <= set(crazyflie_gym.expression_functions())


def test_a_cost_is_in_infos_of_every_kind_of_environment():
    cost = {"cost": "2 * time_s"}
    env = CrazyflieEnv(**cost)
    assert "cost" not in env.reset(seed=0)[1]
    assert [round(env.step(np.zeros(4, np.float32))[4]["cost"], 5) for _ in range(3)] == [0.04, 0.08, 0.12]
    # the step that resets costs nothing
    envs = CrazyflieVectorEnv(3, max_episode_steps=2, **cost)
    envs.reset(seed=0)
    costs = np.array([envs.step(np.zeros((3, 4), np.float32))[4]["cost"] for _ in range(4)])
    np.testing.assert_allclose(costs, np.repeat([[0.04], [0.08], [0.0], [0.04]], 3, axis=1), rtol=1e-5)
    swarm = CrazyflieSwarm(2, "swap", drones=3, **cost)
    swarm.reset(seed=0)
    np.testing.assert_allclose(swarm.step(np.zeros((2, 3, 4), np.float32))[4]["cost"], np.full((2, 3), 0.04), rtol=1e-5)
    team = crazyflie_gym.parallel.parallel_env("swap", drones=3, **cost)
    team.reset(seed=0)
    infos = team.step({agent: np.zeros(4, np.float32) for agent in team.agents})[4]
    assert {round(info["cost"], 5) for info in infos.values()} == {0.04}
    with pytest.raises(ValueError, match='did you mean "dist"'):
        CrazyflieEnv(cost="dits")
    # several ticks in one call, and drones that learn one policy
    envs.reset(seed=0)
    joined = envs.step_many(np.zeros((2, 3, 4), np.float32))[4]["cost"]
    np.testing.assert_allclose(joined, np.repeat([[0.04], [0.08]], 3, axis=1), rtol=1e-5)
    shared = pytest.importorskip("crazyflie_gym.sb3").Sb3SwarmVecEnv("swap", 2, drones=3, true_state=True, **cost)
    shared.reset()
    assert shared.reset_infos[5]["true_state"].shape == (12,)
    infos = shared.step(np.zeros((6, 4), np.float32))[3]
    np.testing.assert_array_equal([info["true_state"] for info in infos], shared.envs.states().reshape(6, 12))
    assert [info["cost"].round(5) for info in infos] == [np.float32(0.04)] * 6
    # a reward by a function reads fields beside it
    both = CrazyflieVectorEnv(3, reward=lambda dist: -dist, **cost)
    both.reset(seed=0)
    assert both.step(np.zeros((3, 4), np.float32))[4]["cost"].round(5).tolist() == [np.float32(0.04)] * 3


def test_a_hover_may_begin_in_motion():
    options = {"start_speed_mps": {"uniform": [0.5, 1.0]}, "start_tilt_deg": 10}
    envs = CrazyflieVectorEnv(32, task_options=options, true_state=True)
    state = envs.reset(seed=0)[1]["true_state"]
    speeds = np.linalg.norm(state[:, 3:5], axis=1)
    assert (speeds >= 0.5).all() and (speeds <= 1.0).all() and speeds.std() > 0.05
    np.testing.assert_allclose(np.linalg.norm(state[:, 6:8], axis=1), np.radians(10), rtol=1e-5)


def test_the_documented_cost_counts_beyond_its_tilt():
    page = (ROOT / "docs" / "rewards.md").read_text()
    (example,) = re.findall(r'`cost="(.*?)"`', page)
    assert f'"{example}"' in crazyflie_gym.options.EnvOptions.__doc__
    envs = CrazyflieVectorEnv(64, cost=example, true_state=True, task_options={"start_tilt_deg": 25.0})
    envs.reset(seed=0)
    infos = envs.step(np.zeros((64, 4), np.float32))[4]
    roll, pitch = infos["true_state"][:, 6:8].T
    tilt = np.hypot(roll, pitch)
    assert (tilt > 0.3).all()
    np.testing.assert_allclose(infos["cost"], tilt - 0.3, atol=1e-5)
