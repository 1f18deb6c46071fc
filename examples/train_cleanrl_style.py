"""A CleanRL-style loop in one file, with resets in the same step; evolution strategies improve the policy, in NumPy."""

import argparse

import gymnasium as gym
import numpy as np

import crazyflie_gym  # noqa: F401  registers the environments

# what the policy sees: set-point minus position, attitude, rates, and how fast the position changes
WIDTH = 12


def features(observations, last):
    """The policy's view of observations, and what it must remember: the position error."""
    error = observations[:, 16:19] - observations[:, 0:3]
    return np.concatenate([error, observations[:, 6:12], (error - last) * 50], axis=1), error


def evaluate(envs, weights, steps):
    """The mean reward of each environment's own policy, weights (num_envs, WIDTH, 4)."""
    observations, _ = envs.reset(seed=1)
    seen, last = features(observations, observations[:, 16:19] - observations[:, 0:3])
    total = np.zeros(envs.num_envs)
    for _ in range(steps):
        actions = np.tanh(np.einsum("nf,nfa->na", seen, weights)).astype(np.float32)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        seen, last = features(observations, last)
        if "final_obs" in infos:  # the observation is already the first of the next episode: no speed is known yet
            done = terminated | truncated
            seen[done, 9:] = 0.0
        total += rewards
    return total / steps


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--generations", type=int, default=30)
    parser.add_argument("--population", type=int, default=256)
    args = parser.parse_args()
    envs = gym.make_vec("Crazyflie-v0", num_envs=args.population, autoreset_mode="same_step", max_episode_steps=250)
    rng, mean, spread = np.random.default_rng(0), np.zeros((WIDTH, 4)), 0.5
    for generation in range(args.generations):
        weights = mean + spread * rng.standard_normal((args.population, WIDTH, 4))
        rewards = evaluate(envs, weights, 250)
        best = np.argsort(rewards)[-args.population // 8 :]
        mean, spread = weights[best].mean(axis=0), max(0.1, 0.95 * spread)
        if generation % 5 == 4:
            print(f"generation {generation + 1:3d}: mean reward {rewards.mean():.3f}, best {rewards.max():.3f}")


if __name__ == "__main__":
    main()
