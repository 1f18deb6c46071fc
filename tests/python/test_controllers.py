"""Controllers of the registry: all of them fly, alone as in a batch, and mistakes are named."""

import json

import numpy as np
import pytest

import crazyflie_gym
from crazyflie_gym import Controller, CrazyflieEnv, CrazyflieVectorEnv

BUILT_IN = [c["name"] for c in crazyflie_gym.controllers() if c["file"] is None]
EFFECTS = {"camera": 1, "camera_latency": 0.05, "camera_noise": {"xy_m": 0.005, "z_m": 0.01, "yaw_deg": 1}}


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_batch_is_flown_as_each_alone(name):
    envs = CrazyflieVectorEnv(20, effects=EFFECTS, vertical="pwm")
    one = CrazyflieEnv(effects=EFFECTS, vertical="pwm")
    place = 0 if name == "random" else 17  # dice are thrown by the place in the batch
    envs.reset(seed=5)
    one.reset(seed=5 + place)
    many, single = envs.controller(name), one.controller(name)
    for _ in range(100):
        actions, action = envs.act(many), one.act(single)
        np.testing.assert_array_equal(actions[place], action)
        rows = envs.step(actions)[0]
        row, _, terminated, truncated, _ = one.step(action)
        if terminated or truncated:  # random flights are short
            return
    np.testing.assert_array_equal(rows[place], row)


def test_the_registry_is_the_command_lines():
    entries = {c["name"]: c for c in crazyflie_gym.controllers()}
    assert {"thesis-pid", "stock-pid", "hover", "random"} < set(entries)
    for entry in entries.values():
        assert entry["about"] and entry["source"]
        assert set(json.loads(entry["defaults"])) == set(entry["options"])


def test_a_pid_is_a_controller():
    env = CrazyflieEnv()
    assert isinstance(env.pid(), Controller)
    env.reset(seed=1)
    np.testing.assert_array_equal(env.act(env.pid()), env.act(env.controller("thesis")))


def test_mistakes_are_named():
    env = CrazyflieEnv()
    with pytest.raises(ValueError, match=r'unknown controller "random-pid"'):
        env.controller("random-pid")
    with pytest.raises(ValueError, match="controller random: options: unknown field `sed`"):
        env.controller("random", sed=1)
    with pytest.raises(ValueError, match="unknown controller mode"):
        env.controller(mode="hoover")
    with pytest.raises(ValueError, match=r"gone\.json"):
        env.controller("pid:gone.json")


def test_observations_of_double_precision_and_a_name_that_is_shown():
    envs = CrazyflieVectorEnv(3, observation="measured")
    rows, _ = envs.reset(seed=1)
    one, other = envs.controller("lqr"), envs.controller("lqr")
    np.testing.assert_array_equal(one.act(rows), other.act(rows.astype(np.float64)))
    assert repr(one) == 'Controller("lqr", num_envs=3)' and "attitude" in repr(envs.interface)
