"""Drones that share one policy, by Stable-Baselines3's PPO, against the thesis's PID."""

import argparse
import time

import numpy as np

from crazyflie_gym import CrazyflieSwarm

# the way to the set-point and the velocity by the Kalman filter; what is known of the other drones follows by itself
OBSERVATION = ["est_error_m", "est_vel_mps", "attitude_rad", "gyro_radps", "last_action"]
UNSEEN, WORLDS, TICKS = 10**9, 32, 1000


def fly(worlds, act):
    """Mean return of a drone and share of drones that crashed, over unseen worlds; `act` gives actions for rows."""
    rows, _ = worlds.reset(seed=UNSEEN)
    returns, flying = np.zeros(rows.shape[:2]), np.ones(rows.shape[:2], bool)
    for _ in range(TICKS):
        rows, rewards, terminated, _, _ = worlds.step(act(rows))
        returns += flying * rewards
        flying &= ~terminated
    return returns.mean(), 1 - flying.mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="formation")
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecNormalize
    except ImportError:
        print('SKIPPED: Stable-Baselines3 is not installed: pip install "crazyflie-gym[sb3]"')
        return
    from crazyflie_gym.sb3 import Sb3SwarmVecEnv

    start = time.perf_counter()
    torch.set_num_threads(1)
    envs = Sb3SwarmVecEnv(args.task, args.worlds, observation=OBSERVATION, max_episode_steps=TICKS)
    envs = VecNormalize(envs, norm_reward=False, gamma=0.98)
    model = PPO(
        "MlpPolicy", envs, n_steps=64, batch_size=4096, n_epochs=5, gamma=0.98, learning_rate=1e-3, device="cpu",
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, seed=args.seed,
    )  # fmt: skip
    model.learn(args.steps)
    envs.training = False
    print(f"{model.num_timesteps} steps of drones in {time.perf_counter() - start:.0f} s")
    worlds = CrazyflieSwarm(
        WORLDS, args.task, autoreset_mode="same_step", max_episode_steps=TICKS, observation=OBSERVATION
    )

    def act(rows):
        flat = envs.normalize_obs(rows.reshape(-1, rows.shape[-1]))
        return model.predict(flat, deterministic=True)[0].reshape(*rows.shape[:2], -1)

    pilots = {}
    for avoid in (False, True):
        pid = worlds.controller(avoid=avoid)
        pilots[f"thesis PID, avoidance {avoid}"] = lambda _, pid=pid: worlds.act(pid)
    pilots["PPO"] = act
    for name, pilot in pilots.items():
        returns, crashed = fly(worlds, pilot)
        print(f"{name:28s} return per drone {returns:5.0f}, crashed {100 * crashed:.0f} %")


if __name__ == "__main__":
    main()
