"""How many environment steps a second: one drone, and thousands stepped together in Rust."""

import time

import gymnasium as gym
import numpy as np

import crazyflie_gym  # noqa: F401  registers the environments


def rate(step, actions, envs, seconds=0.3):
    """Environment steps per second, the best of three."""
    best = 0.0
    for _ in range(3):
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds:
            for _ in range(10):
                step(actions)
            count += 10
        best = max(best, count * envs / (time.perf_counter() - start))
    return best


def main():
    env = gym.make("Crazyflie-v0", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    print(f"     1 environment : {rate(env.step, np.zeros(4, np.float32), 1) / 1e6:8.2f} M steps/s")
    for count in (64, 1024, 16384):
        envs = gym.make_vec("Crazyflie-v0", num_envs=count)
        envs.reset(seed=0)
        actions = np.zeros((count, 4), np.float32)
        print(f"{count:6d} environments: {rate(envs.step, actions, count) / 1e6:8.2f} M steps/s")


if __name__ == "__main__":
    main()
