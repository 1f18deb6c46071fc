"""What the numbers mean: observation against true state, signs, tasks, controllers, models."""

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym
from common import FIVE
from crazyflie_gym import STATE_FIELDS, flatten, split


def fly(env, steps, seed=0, **pid):
    """Fly with the PID and return the observations and the true states."""
    controller = env.unwrapped.pid(**pid)
    obs, info = env.reset(seed=seed)
    rows, states, rewards = [obs], [info["true_state"]], []
    for _ in range(steps):
        obs, reward, terminated, truncated, info = env.step(env.unwrapped.act(controller))
        rows.append(obs)
        states.append(info["true_state"])
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.stack(rows), np.stack(states), rewards, (terminated, truncated)


def test_fields_lie_one_after_the_other():
    fields = crazyflie_gym.observation_fields()
    assert [f["first"] for f in fields] == list(np.cumsum([0] + [f["length"] for f in fields])[:-1])
    assert sum(f["length"] for f in fields) == 24
    space = gym.make("Crazyflie-v0", observation="measured").observation_space
    for field in fields:
        at = slice(field["first"], field["first"] + field["length"])
        assert (space.low[at] == np.float32(field["low"])).all() and (space.high[at] == np.float32(field["high"])).all()


def test_without_effects_the_rig_measures_the_truth():
    env = gym.make("Crazyflie-v0", observation="measured", true_state=True, task_options={"start_yaw_deg": 60.0})
    rows, states, _, _ = fly(env, 200)
    seen = split(rows)
    assert np.array_equal(seen["marker_pos_m"], states[:, STATE_FIELDS["pos_m"]])
    assert np.allclose(seen["attitude_rad"], states[:, STATE_FIELDS["att_rad"]], atol=1e-6)
    assert np.array_equal(seen["gyro_radps"], states[:, STATE_FIELDS["rate_radps"]])
    assert np.array_equal(seen["marker_yaw_rad"][:, 0], seen["attitude_rad"][:, 2])
    assert (seen["marker_valid"] == 1).all() and (seen["marker_age_s"] == 0).all()
    assert np.allclose(seen["setpoint"], [0, 0, 0.7, 0])
    # velocity is the slope of the position
    slope = np.diff(states[:, :3], axis=0) / 0.02
    mean = 0.5 * (states[1:, 3:6] + states[:-1, 3:6])
    assert np.abs(slope - mean)[10:].max() < 0.02


def test_by_field_is_the_same_as_flat():
    flat, by_field = (
        gym.make("Crazyflie-v0", observation="measured", form=form, effects=FIVE, vertical="pwm")
        for form in ("flat", "dict")
    )
    a, b = flat.reset(seed=3)[0], by_field.reset(seed=3)[0]
    assert np.array_equal(a, flatten(b)) and list(b) == [f["name"] for f in crazyflie_gym.observation_fields()]
    action = np.array([0.1, -0.2, 0.3, 0.2], np.float32)
    a, b = flat.step(action)[0], by_field.step(action)[0]
    assert np.array_equal(a, flatten(b))
    assert np.array_equal(b["last_action"], action)


def test_signs_of_the_commands():
    env = gym.make("Crazyflie-v0", true_state=True, task_options={"start_radius_m": 0.0})
    for axis, index, sign in [(1, 0, +1), (0, 1, -1), (3, 2, +1), (2, 8, env.unwrapped.interface.yaw_sign)]:
        env.reset(seed=0)
        action = np.array([0, 0, 0, 2 * 0.7 / 1.5 - 1], np.float32)
        action[axis] = 0.5
        before = env.unwrapped.sim.states()[0, index]
        for _ in range(25):
            *_, info = env.step(action)
        assert sign * (info["true_state"][index] - before) > 0.01, (axis, index)


def test_the_interface_is_the_thesiss():
    height, pwm = (gym.make("Crazyflie-v0", vertical=v).unwrapped.interface for v in (None, "pwm"))
    assert height.vertical == "height" and height.lift_max == 1.5 and height.hover_lift == 0
    assert pwm.lift_max == 60000 and pwm.hover_lift == 39342.5
    assert np.isclose(np.degrees(height.tilt_max_rad), 10) and np.isclose(np.degrees(height.yaw_rate_max_radps), 200)
    assert height.yaw_sign == -1 and height.tick_s == 0.02


@pytest.mark.parametrize("vertical", ["height", "pwm"])
def test_the_thesiss_pid_hovers(vertical):
    env = gym.make("Crazyflie-v0", vertical=vertical, true_state=True, max_episode_steps=1000)
    for seed in range(5):
        _, states, _, ended = fly(env, 500, seed=seed)
        assert len(states) == 501 and ended == (False, False)
        assert np.linalg.norm(states[450:, :3] - [0, 0, 0.7], axis=1).max() < 0.05


def test_the_pid_flies_a_batch_like_one_drone():
    envs = gym.make_vec("Crazyflie-v0", num_envs=19)
    one = gym.make("Crazyflie-v0")
    many, single = envs.pid(), one.unwrapped.pid()
    envs.reset(seed=2)
    one.reset(seed=2 + 7)
    for _ in range(100):
        actions, action = envs.act(many), one.unwrapped.act(single)
        assert np.array_equal(actions[7], action)
        rows, row = envs.step(actions)[0], one.step(action)[0]
        assert np.array_equal(rows[7], row)


def test_a_reset_controller_forgets():
    env = crazyflie_gym.CrazyflieEnv(vertical="pwm")
    pid, fresh = env.pid(), env.pid()
    env.reset(seed=1)
    expected = env.act(fresh)
    assert np.array_equal(env.act(pid), expected)
    assert not np.array_equal(env.act(pid), expected)
    pid.reset(np.array([False]))
    assert not np.array_equal(env.act(pid), expected)
    pid.reset(np.array([True]))
    assert np.array_equal(env.act(pid), expected)


@pytest.mark.parametrize(("vertical", "mode"), [("height", "automatic"), ("pwm", "takeoff"), ("thrust", "takeoff")])
def test_take_off_reaches_its_height(vertical, mode):
    env = gym.make("CrazyflieTakeoff-v0", true_state=True, vertical=vertical)
    _, states, rewards, ended = fly(env, 500, mode=mode)
    assert states[0, 2] == 0 and ended == (False, True)
    assert abs(states[-1, 2] - 0.7) < 0.1 and rewards[-1] > 0.7


def test_landing_ends_at_touch_down_and_pays_for_softness():
    paid = []
    for descent in (0.9, 0.5):
        env = gym.make("CrazyflieLand-v0", vertical="thrust", true_state=True, task_options={"start_radius_m": 0.0})
        lift = 2 * descent * env.unwrapped.interface.hover_lift / env.unwrapped.interface.lift_max - 1
        env.reset(seed=0)
        height, terminated = 0.7, False
        while not terminated:
            assert height > 0
            _, reward, terminated, truncated, info = env.step(np.array([0, 0, 0, lift], np.float32))
            height = info["true_state"][2]
            assert not truncated
        assert height == 0
        paid.append(reward)
    assert 0 < paid[1] < paid[0] < 10


def test_tracking_moves_the_set_point():
    env = gym.make(
        "CrazyflieTrack-v0",
        observation="measured",
        true_state=True,
        task_options={"shape": "circle", "size_m": 0.4, "period_s": 10.0},
    )
    rows, states, _, ended = fly(env, 1000)
    setpoint = split(rows)["setpoint"]
    assert np.allclose(np.linalg.norm(setpoint[:, :2], axis=1), 0.4, atol=1e-4) and ended == (False, True)
    assert np.linalg.norm(states[200:, :2] - setpoint[200:, :2], axis=1).mean() < 0.35


def test_leaving_the_room_ends_the_episode():
    env = gym.make("Crazyflie-v0", true_state=True, task_options={"start_m": [2.0, 0.0, 0.7]})
    env.reset(seed=0)
    terminated = False
    while not terminated:
        _, _, terminated, truncated, info = env.step(np.array([0, 1, 0, 0], np.float32))
        assert not truncated and (terminated == (info["true_state"][0] > 2.5))


def test_a_model_from_a_file_flies(tmp_path):
    text = crazyflie_gym.model_text()
    assert text.count("tilt_max = { value = 10.0") == 1
    changed = text.replace("tilt_max = { value = 10.0", "tilt_max = { value = 20.0")
    path = tmp_path / "other.toml"
    path.write_text(changed)
    for model in (path, str(path), changed):
        env = gym.make("Crazyflie-v0", model=model, true_state=True)
        assert np.isclose(np.degrees(env.unwrapped.interface.tilt_max_rad), 20)
        _, states, _, _ = fly(env, 500)
        assert np.linalg.norm(states[-1, :3] - [0, 0, 0.7]) < 0.05
    default, thesis = gym.make("Crazyflie-v0"), gym.make("Crazyflie-v0", model="thesis")
    assert np.array_equal(default.reset(seed=1)[0], thesis.reset(seed=1)[0])
    assert crazyflie_gym.check_model(text) == "cf2-thesis"


def test_a_model_as_a_dict_flies():
    tomllib = pytest.importorskip("tomllib")
    env = gym.make("Crazyflie-v0", model=tomllib.loads(crazyflie_gym.model_text()))
    assert np.array_equal(env.reset(seed=1)[0], gym.make("Crazyflie-v0").reset(seed=1)[0])


def test_every_effect_at_its_off_values_changes_nothing():
    off = {e["name"]: {p["name"]: p["off"] for p in e["params"]} for e in crazyflie_gym.effects()}
    plain, switched = (gym.make_vec("Crazyflie-v0", num_envs=3, effects=e, vertical="pwm") for e in ({}, off))
    assert np.array_equal(plain.reset(seed=1)[0], switched.reset(seed=1)[0])
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 4)).astype(np.float32)
    for _ in range(30):
        assert np.array_equal(plain.step(actions)[0], switched.step(actions)[0])


def test_registries_are_complete():
    assert {t["id"] for t in crazyflie_gym.tasks()} == {
        "Crazyflie-v0",
        "CrazyflieTakeoff-v0",
        "CrazyflieLand-v0",
        "CrazyflieTrack-v0",
        "CrazyflieRace-v0",
        "CrazyflieFormation-v0",
        "CrazyflieSwap-v0",
        "CrazyflieFollow-v0",
        "CrazyflieCover-v0",
        "CrazyflieLandInTurn-v0",
        "CrazyflieCarry-v0",
        "CrazyflieOwn-v0",
    }
    for effect in crazyflie_gym.effects():
        assert effect["about"] and effect["source"] and effect["hooks"] and effect["params"]
        for param in effect["params"]:
            assert param["low"] <= param["off"] <= param["high"] and param["unit"]
