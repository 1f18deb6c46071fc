"""Lane i of a batch with seed s is the single environment with seed s + i, bit for bit, whatever the autoreset mode."""

import gymnasium as gym
import numpy as np
import pytest

from common import random_actions, single_env

LIMIT, ENVS, STEPS, SEED = 12, 19, 40, 100
KWARGS = {
    "effects": {"wind": {"x_mps2": {"uniform": [-1, 1]}}, "camera_noise": {"xy_m": 0.01}, "camera_latency": 0.05},
    "vertical": "pwm",
    "true_state": True,
    # so close to the wall that some episodes terminate, and others are truncated
    "task_options": {"start_radius_m": 2.0, "start_yaw_deg": 90.0},
    "max_episode_steps": LIMIT,
}


def make(mode, **kwargs):
    return gym.make_vec("Crazyflie-v0", num_envs=ENVS, autoreset_mode=mode, **{**KWARGS, **kwargs})


def lanes():
    """Single environments, as Gymnasium's SyncVectorEnv would hold them."""
    return [single_env(**KWARGS) for _ in range(ENVS)]


def equal(a, b):
    return np.array_equal(np.asarray(a), np.asarray(b))


def test_next_step():
    envs, singles = make("next_step"), lanes()
    obs, info = envs.reset(seed=SEED)
    for i, env in enumerate(singles):
        first, single_info = env.reset(seed=SEED + i)
        assert equal(obs[i], first) and equal(info["true_state"][i], single_info["true_state"])
    ended, ends = np.zeros(ENVS, bool), 0
    for actions in random_actions(STEPS, ENVS):
        obs, rewards, terminated, truncated, info = envs.step(actions)
        for i, env in enumerate(singles):
            if ended[i]:
                first, single_info = env.reset()
                result = (first, 0.0, False, False, single_info)
            else:
                result = env.step(actions[i])
            assert equal(obs[i], result[0]) and rewards[i] == result[1]
            assert terminated[i] == result[2] and truncated[i] == result[3]
            assert equal(info["true_state"][i], result[4]["true_state"]) and info["_true_state"][i]
        ended = terminated | truncated
        ends += ended.sum()
    assert ends >= 2 * ENVS


def test_same_step():
    envs, singles = make("same_step"), lanes()
    envs.reset(seed=SEED)
    for i, env in enumerate(singles):
        env.reset(seed=SEED + i)
    ends = 0
    for actions in random_actions(STEPS, ENVS):
        obs, rewards, terminated, truncated, info = envs.step(actions)
        done = terminated | truncated
        assert ("final_obs" in info) == ("final_info" in info) == done.any()
        if done.any():
            assert equal(info["_final_obs"], done) and equal(info["_final_info"], done)
            assert equal(info["final_info"]["_true_state"], done)
            assert info["final_obs"].dtype == object
        for i, env in enumerate(singles):
            result = env.step(actions[i])
            assert rewards[i] == result[1] and terminated[i] == result[2] and truncated[i] == result[3]
            if done[i]:
                assert equal(info["final_obs"][i], result[0])
                assert equal(info["final_info"]["true_state"][i], result[4]["true_state"])
                first, single_info = env.reset()
                result = (first, 0.0, False, False, single_info)
            elif done.any():
                assert info["final_obs"][i] is None
            assert equal(obs[i], result[0]) and equal(info["true_state"][i], result[4]["true_state"])
        ends += done.sum()
    assert ends >= 2 * ENVS


def test_disabled():
    envs, singles = make("disabled"), lanes()
    obs, _ = envs.reset(seed=SEED)
    for i, env in enumerate(singles):
        env.reset(seed=SEED + i)
    ends = 0
    for actions in random_actions(STEPS, ENVS):
        obs, rewards, terminated, truncated, _ = envs.step(actions)
        done = terminated | truncated
        before = obs.copy()
        for i, env in enumerate(singles):
            result = env.step(actions[i])
            assert equal(obs[i], result[0]) and rewards[i] == result[1]
            assert terminated[i] == result[2] and truncated[i] == result[3]
        if done.any():
            with pytest.raises(RuntimeError, match=rf"environment {np.flatnonzero(done)[0]} has ended: reset it"):
                envs.step(actions)
            # changes of the returned array do not change the environment
            obs[:] = np.nan
            options = {"reset_mask": done}
            obs, info = envs.reset(options=options)
            assert options == {"reset_mask": done}, "the options are the caller's"
            assert equal(info["_true_state"], done)
            assert equal(obs[~done], before[~done])
            for i in np.flatnonzero(done):
                assert equal(obs[i], singles[i].reset()[0])
        ends += done.sum()
    assert ends >= 2 * ENVS


def test_final_observations_by_field():
    envs = make("same_step", form="dict")
    flat = make("same_step")
    envs.reset(seed=1)
    flat.reset(seed=1)
    for actions in random_actions(LIMIT, ENVS):
        *_, info = envs.step(actions)
        *_, flat_info = flat.step(actions)
    at = np.flatnonzero(info["_final_obs"])[0]
    assert equal(np.concatenate(list(info["final_obs"][at].values())), flat_info["final_obs"][at])


def test_partial_reset_with_seeds_restarts_only_those():
    envs = make("disabled")
    first, _ = envs.reset(seed=5)
    first = first.copy()
    envs.step(random_actions(1, ENVS)[0])
    mask = np.arange(ENVS) % 2 == 0
    obs, _ = envs.reset(seed=5, options={"reset_mask": mask})
    assert equal(obs[mask], first[mask]) and not equal(obs[~mask], first[~mask])
