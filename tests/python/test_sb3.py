"""Stable-Baselines3 flies the batch. Needs the extra `sb3`."""

import numpy as np
import pytest

pytest.importorskip(
    "stable_baselines3", reason="Stable-Baselines3 is not installed (extra sb3): its adapter is not tested"
)

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import crazyflie_gym
from crazyflie_gym.sb3 import Sb3SwarmVecEnv, Sb3VecEnv


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_the_adapter_is_what_dummy_vec_env_would_be(form):
    kwargs = {"form": form, "task_options": {"start_radius_m": 2.0}, "true_state": True}
    ours = Sb3VecEnv("Crazyflie-v0", num_envs=5, max_episode_steps=30, **kwargs)
    theirs = make_vec_env("Crazyflie-v0", n_envs=5, env_kwargs={**kwargs, "max_episode_steps": 30}, monitor_kwargs={})
    for envs in (ours, theirs):
        envs.seed(3)
    a, b = ours.reset(), theirs.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (70, 5, 4)).astype(np.float32)
    ends = 0

    def equal(x, y):
        return all(np.array_equal(x[k], y[k]) for k in x) if isinstance(x, dict) else np.array_equal(x, y)

    assert equal(a, b)
    for action in actions:
        (a, ra, da, ia), (b, rb, db, ib) = ours.step(action), theirs.step(action)
        assert equal(a, b) and np.array_equal(ra, rb) and np.array_equal(da, db) and ra.dtype == rb.dtype
        for x, y in zip(ia, ib, strict=True):
            y.pop("episode", None)
            # Gymnasium tells it for every step, this adapter at the ends
            y.pop("TimeLimit.truncated") if "terminal_observation" not in y else None
            assert x.keys() == y.keys()
            assert equal(x["true_state"], y["true_state"])
            if "terminal_observation" in x:
                ends += 1
                assert equal(x["terminal_observation"], y["terminal_observation"])
                assert x["TimeLimit.truncated"] == y["TimeLimit.truncated"]
    assert ends >= 10


def test_ppo_learns():
    envs = VecNormalize(VecMonitor(Sb3VecEnv("Crazyflie-v0", num_envs=32, max_episode_steps=100)))
    model = PPO("MlpPolicy", envs, n_steps=64, batch_size=512, n_epochs=2, seed=0, device="cpu")
    model.learn(3 * 32 * 64)
    assert model.num_timesteps == 3 * 32 * 64 and len(model.ep_info_buffer) > 0
    assert model.predict(envs.reset())[0].shape == (32, 4)


def test_drones_of_many_worlds_are_environments_that_end_together():
    worlds, drones = 5, 4
    envs = Sb3SwarmVecEnv(
        "swap", worlds, drones=drones, max_episode_steps=60, observation=["error_m", "vel_mps"], vertical="pwm"
    )
    same = crazyflie_gym.CrazyflieSwarm(
        worlds,
        "swap",
        drones=drones,
        max_episode_steps=60,
        observation=["error_m", "vel_mps"],
        vertical="pwm",
        autoreset_mode="disabled",
    )
    envs.seed(3)
    rows, (wanted, _) = envs.reset(), same.reset(seed=3)
    assert envs.num_envs == worlds * drones and np.array_equal(rows, wanted.reshape(len(rows), -1))
    rng, crashed, timed_out = np.random.default_rng(0), 0, 0
    for _ in range(150):
        actions = rng.uniform(-0.2, 0.2, (envs.num_envs, 4)).astype(np.float32)
        # the motors of one drone are off, until it hits the floor
        actions[:, 3] = 2 * 35000 / 60000 - 1
        actions[0, 3] = -1
        rows, rewards, dones, infos = envs.step(actions)
        wanted, paid, terminated, truncated, _ = same.step(actions.reshape(worlds, drones, 4))
        assert np.array_equal(rewards, paid.reshape(-1))
        ended = (terminated | truncated).any(axis=1)
        assert np.array_equal(dones, np.repeat(ended, drones))
        for env in np.flatnonzero(dones):
            own = bool(terminated.reshape(-1)[env])
            assert infos[env]["TimeLimit.truncated"] is not own
            assert np.array_equal(infos[env]["terminal_observation"], wanted.reshape(envs.num_envs, -1)[env])
            crashed, timed_out = crashed + own, timed_out + (not own)
        if ended.any():
            wanted, _ = same.reset(options={"reset_mask": ended})
        assert np.array_equal(rows, wanted.reshape(len(rows), -1))
    assert crashed and timed_out
    model = PPO("MlpPolicy", VecNormalize(VecMonitor(envs)), n_steps=16, batch_size=160, n_epochs=1, device="cpu")
    model.learn(2 * 16 * envs.num_envs)
    with pytest.raises(ValueError, match="one drone"):
        Sb3SwarmVecEnv("hover", 2)


def test_attributes_and_methods():
    envs = Sb3VecEnv("Crazyflie-v0", num_envs=3, render_mode="rgb_array")
    assert envs.get_attr("num_envs") == [3, 3, 3] and envs.get_attr("num_envs", indices=1) == [3]
    assert envs.env_is_wrapped(VecMonitor) == [False] * 3
    envs.set_attr("note", 1)
    assert envs.get_attr("note") == [1] * 3
    with pytest.raises(ValueError, match="share"):
        envs.set_attr("note", 1, indices=[0])
    assert isinstance(envs.env_method("pid", indices=0)[0], crazyflie_gym.Pid)
    with pytest.raises(RuntimeError, match="step_async"):
        envs.step_wait()
    envs.reset()
    assert len(list(envs.get_images())) == 3
    with pytest.raises(TypeError, match="expected one of crazyflie_gym's"):
        Sb3VecEnv("CartPole-v1", num_envs=2)
