"""Model predictive path integral control: each tick a thousand flights are predicted, and the best agree: mppi.png.

Williams, Aldrich, Theodorou 2017, "Model Predictive Path Integral Control". The simulator predicts: `copy_state` gives
its state to every environment of a batch, and `rollout` flies them all. Predictions see other noise than the flight.

    python examples/mppi.py            # hover and figure eight, beside the thesis's PID
"""

import argparse
import time

import gymnasium as gym
import numpy as np

import crazyflie_gym

TASKS = {"hover": "Crazyflie-v0", "figure eight": "CrazyflieTrack-v0"}
# roll, pitch, yaw rate, height: how far samples are from the plan
SPREAD = np.array([0.25, 0.25, 0.05, 0.05], np.float32)


class PathIntegral:
    """A planner for one environment."""

    def __init__(self, env_id, samples=1024, steps=30, temperature=0.1, threads=2, seed=0):
        self.envs = gym.make_vec(
            env_id, num_envs=samples, autoreset_mode="disabled", max_episode_steps=-1, threads=threads
        ).unwrapped
        self.temperature = temperature
        self.plan = np.zeros((steps, 4), np.float32)
        # steady pushes of five ticks; a part of the table is used each time
        self.rng = np.random.default_rng(seed)
        held = self.rng.normal(0.0, SPREAD, (64, samples, 4))
        self.table = np.repeat(held, 5, axis=0).astype(np.float32)
        self.flown = None
        self.predicted, self.seconds = 0, 0.0

    def act(self, env):
        """The next action for an environment, which stays as it is."""
        first = self.rng.integers(len(self.table) - len(self.plan))
        samples = self.table[first : first + len(self.plan)] + self.plan[:, np.newaxis]
        samples[:, 0] = self.plan
        np.clip(samples, -1.0, 1.0, out=samples)
        start = time.perf_counter()
        self.envs.copy_state(env, seeds=int(self.rng.integers(2**32)))
        self.flown = self.envs.rollout(samples, keep=(), out=self.flown)
        self.seconds += time.perf_counter() - start
        self.predicted += samples.shape[0] * samples.shape[1]
        returns = self.flown.returns
        weights = np.exp((returns - returns.max()) / self.temperature)
        self.plan = np.tensordot(samples, weights / weights.sum(), axes=(1, 0)).astype(np.float32)
        action = self.plan[0].copy()
        self.plan[:-1] = self.plan[1:]
        return action


def fly(env, pilot, ticks, seed):
    """The mean reward of a flight."""
    env.reset(seed=seed)
    total = 0.0
    for _ in range(ticks):
        _, reward, terminated, truncated, _ = env.step(pilot())
        total += reward
        if terminated or truncated:
            break
    return total / ticks


def compare(env_id, ticks, seed=0, picture=None, **planner):
    """Mean rewards of the PID and of the planner on the same flight, and predicted steps per second."""
    env = gym.make(env_id, disable_env_checker=True, render_mode="rgb_array").unwrapped
    controller = env.pid()
    pid = fly(env, lambda: env.act(controller), ticks, seed)
    mppi = PathIntegral(env_id, **planner)
    # the height that the task begins at
    env.reset(seed=seed)
    mppi.plan[:, 3] = 2.0 * env.sim.states()[0, 2] / env.interface.lift_max - 1.0
    planned = fly(env, lambda: mppi.act(env), ticks, seed)
    if picture:
        crazyflie_gym.save_png(picture, env.render())
    return pid, planned, mppi.predicted / mppi.seconds


def main():
    """Print both flights of every task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=400)
    parser.add_argument("--samples", type=int, default=1024)
    options = parser.parse_args()
    for name, env_id in TASKS.items():
        pid, planned, rate = compare(env_id, options.ticks, picture="mppi.png", samples=options.samples)
        rewards = f"PID {pid:.4f}, planner {planned:.4f}"
        print(f"{name:12s}  mean reward: {rewards}; {rate / 1e6:.1f} M predicted steps/s")
    print("the picture of the figure eight is mppi.png")


if __name__ == "__main__":
    main()
