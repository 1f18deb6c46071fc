"""A CleanRL-style loop in one file: evolution strategies improve a linear policy: train_cleanrl_style.png.

Episodes are reset in the same step.
"""

import argparse

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

import crazyflie_gym  # noqa: F401  registers the environments

# the policy's observation, with the velocity of a Kalman filter, and the values scaled to 1
OBSERVATION = {"est_error_m": 3, "est_vel_mps": 3, "attitude_rad": 3, "gyro_radps": 3}
SCALE = np.repeat([1.0, 1.0, 0.3, 3.0], list(OBSERVATION.values())).astype(np.float32)
TICKS = 250


def evaluate(envs, act, seed):
    """The mean reward per tick of each environment; `act` gives actions (num_envs, 4) for observations."""
    observations, _ = envs.reset(seed=seed)
    total = np.zeros(envs.num_envs)
    for _ in range(TICKS):
        # at the end of an episode, the observation is already the first of the next one
        observations, rewards, *_ = envs.step(act(observations))
        total += rewards
    return total / TICKS


def linear(weights):
    """Policies with weights (num_envs, 12, 4): each environment has its own."""
    return lambda rows: np.tanh(np.einsum("nf,nfa->na", rows / SCALE, weights)).astype(np.float32)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--generations", type=int, default=40)
    parser.add_argument("--population", type=int, default=512)
    args = parser.parse_args()
    mode = {"autoreset_mode": "same_step", "max_episode_steps": TICKS}
    envs = gym.make_vec("Crazyflie-v0", num_envs=args.population, observation=list(OBSERVATION), **mode)
    rng, mean, spread, curve = np.random.default_rng(0), np.zeros((len(SCALE), 4)), 0.5, []
    for generation in range(1, args.generations + 1):
        weights = mean + spread * rng.standard_normal((args.population, *mean.shape))
        rewards = evaluate(envs, linear(weights), generation)
        best = np.argsort(rewards)[-args.population // 8 :]
        mean, spread = weights[best].mean(axis=0), max(0.03, 0.95 * spread)
        curve.append((rewards.mean(), rewards.max()))
        if generation % 5 == 0:
            print(f"generation {generation:3d}: mean reward {rewards.mean():.3f}, best {rewards.max():.3f}")
    unseen, pid = 10**9, envs.pid()
    found = evaluate(envs, linear(np.broadcast_to(mean, (args.population, *mean.shape))), unseen)
    known = evaluate(envs, lambda _: envs.act(pid), unseen)
    print(f"unseen flights: {np.median(found):.3f}, thesis PID {np.median(known):.3f}")
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for name, rewards in zip(("mean of the population", "best"), np.transpose(curve), strict=True):
        axes.plot(np.arange(1, len(curve) + 1), rewards, label=name)
    axes.axhline(np.median(known), color="k", ls="--", label="thesis PID, unseen flights")
    axes.set(xlabel="generation", ylabel="reward per tick")
    axes.legend()
    figure.savefig("train_cleanrl_style.png", dpi=100)
    print("the picture is train_cleanrl_style.png")


if __name__ == "__main__":
    main()
