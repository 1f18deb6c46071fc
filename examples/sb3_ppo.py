"""Train Stable-Baselines3's PPO on an estimate, export the policy, and compare it with controllers on unseen seeds."""

import argparse
import time

import crazyflie_gym
from crazyflie_gym.evaluation import Scenario, Work, fly, median

# a Kalman filter's estimate from camera and IMU, so that the policy flies without the true state
OBSERVATION = ["est_error_m", "est_vel_mps", "attitude_rad", "gyro_radps", "last_action"]
UNSEEN, FLIGHTS = 10**9, 64


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=600_000)
    parser.add_argument("--envs", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="sb3_ppo.safetensors")
    args = parser.parse_args()
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
    except ImportError:
        print('SKIPPED: Stable-Baselines3 is not installed: pip install "crazyflie-gym[sb3]"')
        return
    from crazyflie_gym.sb3 import Sb3VecEnv

    start = time.perf_counter()
    # networks this small are no faster on two threads, which wait for each other
    torch.set_num_threads(1)
    envs = VecMonitor(Sb3VecEnv("Crazyflie-v0", num_envs=args.envs, observation=OBSERVATION, vertical="pwm"))
    envs = VecNormalize(envs, norm_reward=False, gamma=0.97)
    model = PPO(
        "MlpPolicy", envs, n_steps=32, batch_size=1024, n_epochs=5, gamma=0.97, learning_rate=1e-3, device="cpu",
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, seed=args.seed,
    )  # fmt: skip
    model.learn(args.steps)
    print(f"{model.num_timesteps} steps in {time.perf_counter() - start:.0f} s")
    crazyflie_gym.export_policy(model, args.out)
    for name in ("hover", "thesis-pid", "lqr", f"policy:{args.out}"):
        flights = fly(Work.of(Scenario(), name, first_seed=UNSEEN, count=FLIGHTS))
        failed = sum(flight["failed"] for flight in flights)
        print(f"{name:30s} median return {500 * median(flights, 'reward'):.0f} of 500, failed {failed} of {FLIGHTS}")


if __name__ == "__main__":
    main()
