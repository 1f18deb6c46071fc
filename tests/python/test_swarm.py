"""Several drones: PettingZoo's own tests, shapes, seeds, mistakes, and tasks flown to the end."""

import gymnasium
import numpy as np
import pytest

import crazyflie_gym
from crazyflie_gym.swarm import METRICS, CrazyflieSwarm

TASKS = [task for task in crazyflie_gym.tasks() if task["drones"] > 1]


def column(metrics, name):
    return metrics[..., METRICS.index(name)]


@pytest.mark.parametrize("task", [task["name"] for task in TASKS])
def test_pettingzoo_accepts_every_task(task):
    testing = pytest.importorskip("pettingzoo.test")
    from crazyflie_gym.parallel import parallel_env

    testing.parallel_api_test(parallel_env(task), num_cycles=300)
    testing.parallel_seed_test(lambda: parallel_env(task), num_cycles=50)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task["name"])
def test_one_agent_flies_them_all(task):
    envs = gymnasium.make_vec(task["id"], num_envs=3, drones=3)
    rows, _ = envs.reset(seed=1)
    assert rows.shape == (3, 3, 24 + 2 * 8) and envs.observation_space.contains(rows)
    rows, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
    assert rows.shape == (3, 3, 40) and rewards.shape == terminated.shape == truncated.shape == (3,)
    assert np.allclose(rewards, infos["drone_rewards"].mean(axis=1))


def test_what_has_another_name_now_warns():
    with pytest.warns(DeprecationWarning, match="CrazyflieTeamEnv is crazyflie_gym.CrazyflieEnv now"):
        assert crazyflie_gym.CrazyflieTeamEnv is crazyflie_gym.CrazyflieEnv
    with pytest.warns(DeprecationWarning, match="missions is crazyflie_gym.tasks now"):
        assert crazyflie_gym.missions() == TASKS
    with pytest.raises(AttributeError, match="no attribute 'CrazyflieTeem'"):
        _ = crazyflie_gym.CrazyflieTeem


def test_agents_have_a_true_state_and_a_picture():
    env = pytest.importorskip("crazyflie_gym.parallel").parallel_env("swap", drones=3, render_mode="rgb_array")
    env.reset(seed=2)
    first, state = env.render(), env.state()
    assert first.shape == (360, 480, 3) and state.shape == env.state_space.shape == (36,)
    for _ in range(10):
        env.step({agent: np.array([0, 0.5, 0, -0.2], np.float32) for agent in env.agents})
    assert (env.render() != first).any() and (env.state() != state).any()


def test_observations_name_what_is_known_of_the_others():
    env = gymnasium.make("CrazyflieSwap-v0", drones=3, form="dict", true_state=True, observation="measured").unwrapped
    fields, info = env.reset(seed=4)
    assert env.observation_space.contains(fields)
    assert fields["neighbour_pos_m"].shape == (3, 2, 3) and fields["neighbour_known"].tolist() == [[[1]] * 2] * 3
    pos_m = info["true_state"][:, :3]
    np.testing.assert_allclose(fields["neighbour_pos_m"][0], pos_m[1:] - pos_m[0], atol=1e-6)
    rows, _ = gymnasium.make("CrazyflieSwap-v0", drones=3, observation="measured").reset(seed=4)
    np.testing.assert_array_equal(crazyflie_gym.flatten(fields), rows)


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_one_crash_ends_no_environment(mode):
    envs = gymnasium.make_vec("CrazyflieFormation-v0", 2, drones=2, autoreset_mode=mode)
    envs.reset(seed=0)
    actions = np.tile(np.array([0, 0, 0, -0.2], np.float32), (2, 2, 1))
    actions[1, 0, 1] = 1.0
    crashed = False
    for _ in range(200):
        _, _, terminated, truncated, infos = envs.step(actions)
        crashed |= not infos["flying"][1, 0]
        assert not terminated.any() and not truncated.any() and not infos.get("_final_obs", np.zeros(2, bool)).any()
    assert crashed and infos["flying"].sum() == 3


def test_a_world_is_the_same_in_every_batch_and_form():
    from_parallel = pytest.importorskip("crazyflie_gym.parallel").parallel_env("formation", drones=3)
    many, one = CrazyflieSwarm(5, "formation", drones=3), CrazyflieSwarm(1, "formation", drones=3)
    team = gymnasium.make("CrazyflieFormation-v0", drones=3)
    rows, _ = many.reset(seed=40)
    single, _ = one.reset(seed=43)
    alone, _ = team.reset(seed=43)
    agents, _ = from_parallel.reset(seed=43)
    rng = np.random.default_rng(0)
    for _ in range(60):
        for other in (single[0], alone, np.stack([agents[agent] for agent in from_parallel.possible_agents])):
            np.testing.assert_array_equal(rows[3], other)
        actions = rng.uniform(-0.1, 0.1, (5, 3, 4)).astype(np.float32)
        rows, *_ = many.step(actions)
        single, *_ = one.step(actions[3:4])
        alone, *_ = team.step(actions[3])
        agents, *_ = from_parallel.step(dict(zip(from_parallel.agents, actions[3], strict=True)))


def test_eight_swap_places_and_nobody_is_hit():
    worlds = CrazyflieSwarm(16, "swap", autoreset_mode="disabled", max_episode_steps=-1)
    pid = worlds.controller()
    worlds.reset(seed=7)
    starts = worlds.states()[..., :2]
    for _ in range(900):
        *_, info = worlds.step(worlds.act(pid))
    metrics = info["metrics"]
    print("least separation", column(metrics, "min_separation_m").min(), "m; settled", column(metrics, "settled_s"))
    assert column(metrics, "collisions").sum() == 0 and column(metrics, "done").tolist() == [8.0] * 16
    np.testing.assert_allclose(worlds.states()[..., :2], -starts, atol=0.25)


def test_agents_carry_different_controllers_and_models():
    module = pytest.importorskip("crazyflie_gym.parallel")
    light = crazyflie_gym.model_text()
    heavy = light.replace("mass = { value = 0.0368", "mass = { value = 0.0468")
    assert heavy != light
    models = [light, heavy, light]
    env = module.parallel_env("formation", drones=3, model=models, vertical="thrust")
    team = env.controller(["lqr", "thesis-pid", "velocity"])
    observations, _ = env.reset(seed=4)
    same = CrazyflieSwarm(1, "formation", drones=3, model=models, vertical="thrust")
    same.reset(seed=4)
    apart = {name: same.controller(name) for name in ("lqr", "thesis-pid", "velocity")}
    for _ in range(150):
        actions = team.act(observations)
        # each agent's action is what a team of its own kind would do in its place
        for j, (agent, crowd) in enumerate(zip(env.possible_agents, apart.values(), strict=True)):
            np.testing.assert_array_equal(actions[agent], same.act(crowd)[0, j])
        observations, *_ = env.step(actions)
        same.step(np.stack(list(actions.values()))[None])
    assert len(env.agents) == 3
    with pytest.raises(ValueError, match="one for each of the 3 drones, got 2"):
        env.controller(["lqr", "hover"])
    with pytest.raises(ValueError, match="one drone, got 2"):
        crazyflie_gym.CrazyflieEnv().controller(["lqr", "hover"])


def test_a_load_hangs_below_those_who_carry_it():
    worlds = CrazyflieSwarm(3, "carry")
    worlds.reset(seed=5)
    carriers = worlds.states()[..., :3]
    loads = worlds.loads()
    assert loads is not None and loads.shape == (3, 3)
    assert (loads[:, 2] < carriers[..., 2].min(axis=1)).all()
    assert (np.abs(loads - carriers.mean(axis=1))[:, :2] < 0.3).all()
    assert CrazyflieSwarm(1, "swap").loads() is None


def test_who_crashes_leaves_and_the_others_fly_on():
    env = pytest.importorskip("crazyflie_gym.parallel").parallel_env("formation", drones=3)
    env.reset(seed=0)
    hold = np.array([0, 0, 0, -0.2], np.float32)
    away = np.array([0, 1, 0, -0.2], np.float32)
    ended = {}
    while len(env.agents) == 3:
        actions = {agent: away if agent == "drone_1" else hold for agent in env.agents}
        _, rewards, terminated, truncated, infos = env.step(actions)
        ended = {agent for agent in terminated if terminated[agent]}
    assert ended == {"drone_1"} and env.agents == ["drone_0", "drone_2"]
    assert rewards["drone_1"] < -8 and not any(truncated.values())
    assert infos["drone_0"]["metrics"]["crashes"] == 1
    with pytest.raises(ValueError, match="drone_1: it no longer flies; those that do: drone_0, drone_2"):
        env.step({agent: hold for agent in env.possible_agents})
    with pytest.raises(ValueError, match="no action of drone_2"):
        env.step({"drone_0": hold})
    with pytest.raises(ValueError, match="'drone_9': there is no such drone"):
        env.step({"drone_0": hold, "drone_2": hold, "drone_9": hold})
    with pytest.raises(ValueError, match=r"actions\[0\]\[2\]\[1\] is NaN"):
        env.step({"drone_0": hold, "drone_2": np.array([0, np.nan, 0, 0], np.float32)})
    # after all of that the two fly on
    seen, *_ = env.step({"drone_0": hold, "drone_2": hold})
    assert set(seen) == {"drone_0", "drone_2"}


def test_a_swarm_is_a_vector_environment_of_drones():
    options = {"drones": 3, "max_episode_steps": 4}
    worlds = CrazyflieSwarm(2, "formation", true_state=True, render_mode="rgb_array", form="dict", **options)
    envs = crazyflie_gym.CrazyflieVectorEnv(2, "formation", true_state=True, **options)
    assert repr(worlds).startswith("CrazyflieSwarm(task=formation, environments=2, drones=3") and "Swarm" not in repr(
        envs
    )
    assert worlds.interface.vertical == envs.interface.vertical
    seen, infos = worlds.reset(seed=3)
    _, there = envs.reset(seed=3)
    np.testing.assert_array_equal(infos["true_state"], there["true_state"])
    assert set(seen) == set(worlds.single_observation_space) and worlds.single_action_space.shape == (4,)
    assert worlds.render()[1].shape == (360, 480, 3)
    hold = np.zeros((2, 3, 4), np.float32)
    plain = CrazyflieSwarm(2, "formation", **options)
    plain.reset(seed=3)
    joined, shared = plain.step_many(np.stack([hold] * 4)), envs.step_many(np.stack([hold] * 4))
    np.testing.assert_allclose(joined[1].mean(axis=-1), shared[1], rtol=1e-6)
    assert joined[3].shape == (4, 2, 3) and joined[3][-1].all() and shared[3][-1].all()


def test_same_step_resets_keep_the_last_observations():
    worlds = CrazyflieSwarm(2, "formation", drones=2, autoreset_mode="same_step", max_episode_steps=5)
    rows, _ = worlds.reset(seed=0)
    hold = np.tile(np.array([0, 0, 0, -0.2], np.float32), (2, 2, 1))
    for step in range(5):
        rows, _, _, truncated, info = worlds.step(hold)
        assert truncated.all() == (step == 4)
    assert info["_final_obs"].all() and info["flying"].all()
    assert not np.array_equal(info["final_obs"][1], rows[1])


def test_mistakes_are_named():
    for options, words in [
        ({"task": "swop"}, "did you mean"),
        ({"drones": 65}, "1 to 64"),
        ({"each": [{}]}, "0 or 4"),
        ({"neighbours": {"by": "radio", "loss": 2}}, "neighbours.loss is 2"),
        ({"effects": {"downwosh": 1}}, "downwash"),
    ]:
        with pytest.raises(ValueError, match=words):
            CrazyflieSwarm(1, **options)
    worlds = CrazyflieSwarm(2, drones=3)
    with pytest.raises(RuntimeError, match="reset"):
        worlds.step(np.zeros((2, 3, 4), np.float32))
    worlds.reset(seed=1)
    with pytest.raises(ValueError, match=r"expected shape \(2, 3, 4\)"):
        worlds.step(np.zeros((2, 2, 4), np.float32))
    with pytest.raises(TypeError, match="expected numbers"):
        worlds.step(np.zeros((2, 3, 4), bool))
    with pytest.raises(ValueError, match="controller"):
        worlds.controller("pidd")
    with pytest.raises(ValueError, match="avoid"):
        worlds.controller(avoid={"spead_mps": 1})
