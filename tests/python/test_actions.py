"""What an action sets: every level, through every door."""

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym as cf
from crazyflie_gym._native import Sim
from crazyflie_gym.parallel import parallel_env

LEVELS = [level["name"] for level in cf.action_levels()]


def act(interface, set_point):
    low, high = np.array(interface.action_ranges).T
    return np.clip((np.array(set_point) - low) / (high - low) * 2 - 1, -1, 1).astype(np.float32)


def test_the_table_says_what_each_number_of_an_action_is():
    assert LEVELS[0] == "attitude"
    for level in cf.action_levels():
        assert len(level["channels"]) == 4 and level["validity"] and level["source"]
        for channel in level["channels"]:
            assert channel["low"] < channel["high"] and channel["bandwidth_radps"] > 0
        env = gym.make("Crazyflie-v0", action=level["name"]).unwrapped
        assert env.interface.action == level["name"]
        assert env.interface.action_ranges == [(c["low"], c["high"]) for c in level["channels"]]


def test_a_place_is_flown_to():
    env = gym.make("Crazyflie-v0", action="position", true_state=True).unwrapped
    env.reset(seed=3)
    action = act(env.interface, [0.5, -0.5, 1.0, 0.0])
    for _ in range(300):
        *_, info = env.step(action)
    np.testing.assert_allclose(info["true_state"][:3], [0.5, -0.5, 1.0], atol=0.03)


@pytest.mark.parametrize("task", [task["id"] for task in cf.tasks()])
@pytest.mark.parametrize("level", LEVELS)
def test_every_id_flies_at_every_level(task, level):
    env = gym.make(task, action=level)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(20):
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(observation).all() and np.isfinite(reward)
        if terminated or truncated:
            break


@pytest.mark.parametrize("level", LEVELS)
def test_vector_swarm_and_agents_fly_as_the_single_environment(level):
    rng = np.random.default_rng(0)
    single = gym.make("CrazyflieSwap-v0", action=level).unwrapped
    vector = gym.make_vec("CrazyflieSwap-v0", num_envs=3, vectorization_mode="vector_entry_point", action=level)
    agents = parallel_env("swap", action=level)
    one, _ = single.reset(seed=5)
    many, _ = vector.reset(seed=[1, 5, 9])
    each, _ = agents.reset(seed=5)
    for _ in range(10):
        actions = rng.uniform(-0.5, 0.5, (3, *single.action_space.shape)).astype(np.float32)
        one = single.step(actions[1])[0]
        many = vector.step(actions)[0]
        each = agents.step({agent: actions[1, j] for j, agent in enumerate(agents.possible_agents)})[0]
        np.testing.assert_array_equal(one, many[1])
        for j, agent in enumerate(agents.possible_agents):
            np.testing.assert_array_equal(one[j], each[agent])


def test_mistakes_are_named():
    with pytest.raises(ValueError, match=r'unknown action level "velocty".*did you mean "velocity"'):
        gym.make("Crazyflie-v0", action="velocty")
    with pytest.raises(ValueError, match="action level"):
        Sim(1, '{"action": "acceleration"}')
    env = gym.make("Crazyflie-v0", action="velocity").unwrapped
    for controller in ("thesis-pid", "lqr", "velocity"):
        with pytest.raises(ValueError, match=r'commands attitudes.*level "velocity".*action="attitude"'):
            env.controller(controller)
    with pytest.raises(ValueError, match="commands attitudes"):
        env.pid()
    assert env.controller("random") is not None
