"""A flight is a function of seed, episode and actions."""

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym
from common import FIVE, random_actions

KWARGS = {"effects": FIVE, "vertical": "pwm", "max_episode_steps": 60}


def flight(num_envs=35, steps=150, seed=4, **kwargs):
    """All that a flight returns, as one array."""
    envs = gym.make_vec("Crazyflie-v0", num_envs=num_envs, **{**KWARGS, **kwargs})
    rows = [envs.reset(seed=seed)[0]]
    for actions in random_actions(steps, 64)[:, :num_envs]:
        obs, rewards, terminated, truncated, _ = envs.step(np.ascontiguousarray(actions))
        rows.append(np.column_stack([obs, rewards, terminated, truncated]))
    return np.stack([row[:, :24] for row in rows]), np.stack([row[:, 24:] for row in rows[1:]])


def test_the_same_seed_is_the_same_flight():
    assert all(np.array_equal(a, b) for a, b in zip(flight(), flight(), strict=True))
    assert not np.array_equal(flight()[0], flight(seed=5)[0])


@pytest.mark.parametrize(
    "kwargs", [{"threads": 2}, {"threads": 7}, {"isa": "baseline"}, {"isa": "baseline", "threads": 2}]
)
def test_threads_and_instruction_sets_change_nothing(kwargs):
    best = crazyflie_gym.CrazyflieVectorEnv(1).sim.isa
    assert best in ("baseline", "avx2", "avx512")
    for a, b in zip(flight(), flight(**kwargs), strict=True):
        assert np.array_equal(a, b)


def test_the_size_of_the_batch_changes_nothing():
    large = flight(num_envs=64)
    for count in (1, 16, 17):
        small = flight(num_envs=count)
        assert all(np.array_equal(a[:, :count], b) for a, b in zip(large, small, strict=True))


def test_lists_of_seeds():
    envs = gym.make_vec("Crazyflie-v0", num_envs=3)
    consecutive, _ = envs.reset(seed=10)
    listed, _ = envs.reset(seed=[12, 11, 10])
    assert np.array_equal(consecutive[::-1], listed)
    # None goes on to the next episode of that environment
    envs.reset(seed=10)
    second, _ = envs.reset()
    envs.reset(seed=10)
    mixed, _ = envs.reset(seed=[10, None, 12])
    assert np.array_equal(mixed, np.stack([consecutive[0], second[1], consecutive[2]]))
    assert not np.array_equal(second, consecutive)


def test_without_a_seed_starts_differ_and_np_random_decides():
    a, b = (gym.make("Crazyflie-v0") for _ in range(2))
    assert not np.array_equal(a.reset()[0], b.reset()[0])
    for env in (a, b):
        env.unwrapped._seeded = False
        env.unwrapped.np_random = np.random.default_rng(3)
    assert np.array_equal(a.reset()[0], b.reset()[0])
    envs = [gym.make_vec("Crazyflie-v0", num_envs=2) for _ in range(2)]
    assert not np.array_equal(envs[0].reset()[0], envs[1].reset()[0])


def test_large_seeds():
    env = crazyflie_gym.CrazyflieEnv()
    env.reset(seed=2**64 - 1)
    for seed in (2**64, 2**70):
        with pytest.raises(ValueError, match="expected 0 to 18446744073709551615"):
            env.reset(seed=seed)
    envs = crazyflie_gym.CrazyflieVectorEnv(2)
    with pytest.raises(ValueError, match="seed is 18446744073709551616"):
        envs.reset(seed=2**64 - 1)
    with pytest.raises(ValueError, match="expected a list of 2, got 3"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises((ValueError, gym.error.Error)):
        env.reset(seed=-1)


def test_domain_randomisation_differs_between_episodes_and_reproduces_by_seed():
    env = gym.make(
        "Crazyflie-v0",
        effects={"wind": {"x_mps2": {"uniform": [-2.0, 2.0]}}},
        task_options={"start_radius_m": 0.0},
        true_state=True,
    )

    def drift(**kwargs):
        env.reset(**kwargs)
        hold = np.array([0, 0, 0, 2 * 0.7 / 1.5 - 1], np.float32)
        for _ in range(50):
            *_, info = env.step(hold)
        return info["true_state"][0]

    first = [drift(seed=3), drift(), drift()]
    again = [drift(seed=3), drift(), drift()]
    assert first == again
    assert len({round(float(x), 4) for x in first}) == 3 and max(abs(x) for x in first) > 0.01
