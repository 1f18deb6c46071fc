"""The interface of Gymnasium, as Gymnasium itself checks it."""

import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import crazyflie_gym

EFFECTS = {"wind": {"x_mps2": {"uniform": [-0.5, 0.5]}}, "camera_noise": {"xy_m": 0.01}, "camera_fov": 120}


@pytest.mark.parametrize("form", ["flat", "dict"])
@pytest.mark.parametrize("extra", [{}, {"effects": EFFECTS, "true_state": True, "vertical": "pwm"}])
def test_check_env_has_nothing_to_say(env_id, form, extra):
    env = gym.make(env_id, form=form, **extra)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
        # and the passive checker of gymnasium.make
        env.reset(seed=1)
        for _ in range(3):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()


def test_the_time_limit_is_the_tasks(env_id):
    task = next(t for t in crazyflie_gym.tasks() if t["id"] == env_id)
    assert gym.spec(env_id).max_episode_steps == task["max_episode_steps"]
    envs = gym.make_vec(env_id, num_envs=3)
    assert envs.spec.kwargs["max_episode_steps"] == task["max_episode_steps"]


def test_specs_survive_pickle_and_json(env_id):
    env = gym.make(env_id, effects=EFFECTS, vertical="pwm", form="dict", true_state=True)
    for spec in (EnvSpec.from_json(env.spec.to_json()), pickle.loads(pickle.dumps(env.spec))):
        again = gym.make(spec)
        (a, _), (b, _) = env.reset(seed=7), again.reset(seed=7)
        assert env.spec == again.spec
        assert all(np.array_equal(a[name], b[name]) for name in a)


def test_make_vec_specs_survive_json():
    envs = gym.make_vec("Crazyflie-v0", num_envs=3, autoreset_mode="same_step", effects={"drag_linear": 0.3})
    again = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    assert again.num_envs == 3 and again.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_entry_points_make_the_native_classes():
    assert isinstance(gym.make("crazyflie_gym:Crazyflie-v0").unwrapped, crazyflie_gym.CrazyflieEnv)
    assert type(gym.make_vec("Crazyflie-v0", num_envs=2)) is crazyflie_gym.CrazyflieVectorEnv
    assert isinstance(gym.make_vec("Crazyflie-v0", 2, "sync"), gym.vector.SyncVectorEnv)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_autoreset_mode_is_in_the_metadata(mode):
    for given in (mode, mode.value, mode.name.lower()):
        envs = gym.make_vec("Crazyflie-v0", num_envs=2, autoreset_mode=given)
        assert envs.metadata["autoreset_mode"] is mode
    assert crazyflie_gym.CrazyflieVectorEnv.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_vector_spaces_hold_what_is_returned(env_id, form):
    envs = gym.make_vec(env_id, num_envs=5, form=form)
    assert envs.observation_space == gym.vector.utils.batch_space(envs.single_observation_space, 5)
    obs, info = envs.reset(seed=3)
    assert envs.observation_space.contains(obs) and info == {}
    for _ in range(50):
        obs, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(obs)
        assert rewards.dtype == np.float32 and terminated.dtype == truncated.dtype == np.bool_
        assert rewards.shape == terminated.shape == truncated.shape == (5,)


def test_returned_arrays_are_new_unless_copy_is_off():
    actions = np.zeros((4, 4), np.float32)
    envs = gym.make_vec("Crazyflie-v0", num_envs=4)
    envs.reset(seed=1)
    first = envs.step(actions)
    kept = [array.copy() for array in first[:4]]
    for _ in range(3):
        envs.step(actions)
    assert all(np.array_equal(a, b) for a, b in zip(first, kept, strict=False))
    reused = gym.make_vec("Crazyflie-v0", num_envs=4, copy=False)
    reused.reset(seed=1)
    seen = [reused.step(actions)[0] for _ in range(4)]
    assert seen[0] is seen[2] and seen[1] is seen[3] and seen[0] is not seen[1]
    envs.reset(seed=1)
    expected = [envs.step(actions)[0] for _ in range(4)]
    assert np.array_equal(seen[2], expected[2]) and np.array_equal(seen[3], expected[3])


def test_gymnasiums_wrappers_accept_the_vector_env():
    envs = gym.wrappers.vector.RecordEpisodeStatistics(gym.make_vec("Crazyflie-v0", num_envs=3, max_episode_steps=10))
    envs.reset(seed=0)
    infos = [envs.step(np.zeros((3, 4), np.float32))[4] for _ in range(10)]
    assert "episode" in infos[-1] and (infos[-1]["episode"]["l"] == 10).all()


def test_an_unmade_vector_env_has_its_tasks_limit():
    envs = crazyflie_gym.CrazyflieVectorEnv(2, task="track")
    envs.reset(seed=0)
    hold = np.zeros((2, 4), np.float32)
    pid = envs.pid()
    obs, _ = envs.reset(seed=0)
    ends = 0
    for _ in range(1000):
        obs, _, terminated, truncated, _ = envs.step(envs.act(pid) if obs.any() else hold)
        ends += int((terminated | truncated).sum())
    assert ends == 2 and truncated.all()
