"""An environment's state taken and set, pickled and copied: what comes of it flies on as the original would."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym
from common import FIVE, actions_for
from crazyflie_gym.swarm import CrazyflieSwarm

COPIES = {"pickle": lambda env: pickle.loads(pickle.dumps(env)), "deepcopy": copy.deepcopy}


def same(a, b):
    """Whether two results are the same in every bit."""
    assert pickle.dumps(a) == pickle.dumps(b)


def fly(env, actions):
    """Fly on, beginning anew where an episode ends, and return all that was seen."""
    seen = []
    for action in actions:
        seen.append(env.step(action))
        if np.ndim(seen[-1][2]) == 0 and (seen[-1][2] or seen[-1][3]):
            seen.append(env.reset())
    return seen


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize(
    "extra",
    [
        {},
        {
            "effects": FIVE,
            "true_state": True,
            "form": "dict",
            "observation": "estimate",
            "history": 2,
            "vertical": "pwm",
        },
    ],
)
def test_a_copy_flies_on_as_the_original(env_id, how, extra):
    env = gym.make(env_id, max_episode_steps=70, **extra)
    env.reset(seed=3)
    before, after = np.split(0.3 * actions_for(env.action_space, 120), [40])
    fly(env, before)
    other = COPIES[how](env)
    same(fly(env, after), fly(other, after))


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_a_batch_goes_on_from_the_state_of_another(env_id, mode):
    def make(**extra):
        envs = gym.make_vec(env_id, num_envs=5, autoreset_mode=mode, max_episode_steps=30, effects=FIVE, **extra)
        return envs.unwrapped

    envs, other = make(), make(threads=2, isa="baseline")
    envs.reset(seed=1)
    before, after = np.split(actions_for(envs.action_space, 100), [40])
    fly(envs, before)
    other.set_state(pickle.loads(pickle.dumps(envs.get_state())))
    same(fly(envs, after), fly(other, after))
    same(fly(COPIES["pickle"](envs), after), fly(envs, after))


def test_swarms_and_agents_are_copied():
    worlds = CrazyflieSwarm(3, "swap", drones=3, max_episode_steps=50)
    worlds.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (60, 3, 3, 4)).astype(np.float32)
    fly(worlds, actions)
    other = CrazyflieSwarm(3, "swap", drones=3, max_episode_steps=50)
    other.set_state(worlds.get_state())
    same(fly(worlds, actions), fly(other, actions))
    env = pytest.importorskip("crazyflie_gym.parallel").parallel_env("formation", drones=2, render_mode="rgb_array")
    env.reset(seed=1)
    steps = [{agent: np.array([0, 0.02 * k, 0, -0.2], np.float32) for agent in env.agents} for k in range(10)]
    twin = copy.deepcopy(env)
    same([env.step(step) for step in steps], [twin.step(step) for step in steps])
    assert np.array_equal(env.render(), twin.render())


def test_agents_fly_in_the_vector_environments_of_supersuit():
    supersuit = pytest.importorskip("supersuit")
    env = pytest.importorskip("crazyflie_gym.parallel").parallel_env("formation", drones=3)
    envs = supersuit.concat_vec_envs_v1(
        supersuit.pettingzoo_env_to_vec_env_v1(env), 2, num_cpus=1, base_class="gymnasium"
    )
    rows, _ = envs.reset(seed=1)
    assert rows.shape == (6, 40)
    rows, rewards, *_ = envs.step(np.zeros((6, 4), np.float32))
    assert rows.shape == (6, 40) and rewards.shape == (6,)


def test_a_state_of_something_else_is_refused():
    env, other = gym.make("Crazyflie-v0").unwrapped, gym.make("Crazyflie-v0", effects={"drag_linear": 0.3}).unwrapped
    env.reset(seed=1)
    state = env.get_state()
    with pytest.raises(ValueError, match="other models, options or size"):
        other.set_state(state)
    broken = {**state, "sim": state["sim"][:-9] + b"x" + state["sim"][-8:]}
    with pytest.raises(ValueError, match="cut off or damaged"):
        env.set_state(broken)
    with pytest.raises(ValueError, match="state"):
        crazyflie_gym.Sim(1).set_state(b"")
