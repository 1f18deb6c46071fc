"""Train Stable-Baselines3's PPO with nothing set, seed by seed, and compare it with controllers on unseen seeds.

    python python_client/bench_stock_ppo.py --seeds 5 --steps 300000

Returns are medians of flights that no policy was trained on; a crash ends a flight. 300 000 steps take 4 minutes.
"""

import argparse
import platform
import time

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO

import crazyflie_gym  # noqa: F401  it registers the ids

UNSEEN, FLIGHTS = 10**9, 64


def median_return(env_id, pilot, **options):
    """The median of the returns of unseen flights. `pilot` is a controller's name, or a function of observations."""
    ticks = gym.spec(env_id).max_episode_steps
    envs = gym.make_vec(env_id, num_envs=FLIGHTS, autoreset_mode="same_step", **options)
    rows, _ = envs.reset(seed=UNSEEN)
    controller = envs.controller(pilot) if isinstance(pilot, str) else None
    returns, flying = np.zeros(FLIGHTS), np.ones(FLIGHTS, bool)
    for _ in range(ticks):
        rows, rewards, terminated, _, _ = envs.step(envs.act(controller) if controller else pilot(rows))
        returns += flying * rewards
        flying &= ~terminated
    return np.median(returns), FLIGHTS - flying.sum()


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--id", default="Crazyflie-v0")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--vertical", help="the vertical form that actions command; the model's first unless given")
    args = parser.parse_args()
    torch.set_num_threads(1)
    options = {"vertical": args.vertical} if args.vertical else {}
    print(f"{platform.processor() or platform.machine()}, {args.id}, {options or 'nothing set'}", flush=True)
    others = {"nothing": lambda rows: np.zeros((len(rows), 4), np.float32)}
    others |= {name: name for name in ("thesis-pid", "lqr")}
    for name, pilot in others.items():
        median, crashed = median_return(args.id, pilot, **options)
        print(f"{name:10s} median return {median:6.1f}, {crashed} of {FLIGHTS} crashed", flush=True)
    for seed in range(args.seeds):
        start = time.perf_counter()
        model = PPO("MlpPolicy", gym.make(args.id, **options), seed=seed, device="cpu")
        model.learn(args.steps)
        median, crashed = median_return(
            args.id, lambda rows, model=model: model.predict(rows, deterministic=True)[0], **options
        )
        took = time.perf_counter() - start
        print(f"PPO, seed {seed}: {median:6.1f}, {crashed} of {FLIGHTS} crashed, {took:.0f} s", flush=True)


if __name__ == "__main__":
    main()
