"""Train with Stable-Baselines3's PPO, and compare with the thesis's PID on unseen seeds."""

import argparse
import time

import numpy as np

import crazyflie_gym

# with the velocity of the Kalman filter, which no sensor measures; without it PPO does not learn to hover
OBSERVATION = ["est_error_m", "est_vel_mps", "attitude_rad", "gyro_radps", "last_action"]
UNSEEN, FLIGHTS, TICKS = 10**9, 64, 500


def median_return(act, observation="measured"):
    """The median of the returns of unseen flights that `act` flies, observations to actions; a crash ends a flight."""
    envs = crazyflie_gym.CrazyflieVectorEnv(FLIGHTS, autoreset_mode="same_step", observation=observation)
    observations, _ = envs.reset(seed=UNSEEN)
    returns, flying = np.zeros(FLIGHTS), np.ones(FLIGHTS, bool)
    for _ in range(TICKS):
        observations, rewards, terminated, _, _ = envs.step(act(observations))
        returns += flying * rewards
        flying &= ~terminated
    return np.median(returns)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=600_000)
    parser.add_argument("--envs", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
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
    envs = VecMonitor(Sb3VecEnv("Crazyflie-v0", num_envs=args.envs, observation=OBSERVATION))
    envs = VecNormalize(envs, norm_reward=False, gamma=0.97)
    model = PPO(
        "MlpPolicy", envs, n_steps=32, batch_size=1024, n_epochs=5, gamma=0.97, learning_rate=1e-3, device="cpu",
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, seed=args.seed,
    )  # fmt: skip
    model.learn(args.steps)
    print(f"{model.num_timesteps} steps in {time.perf_counter() - start:.0f} s")
    pid = crazyflie_gym.CrazyflieVectorEnv(FLIGHTS).pid()
    envs.training = False
    ppo = median_return(lambda rows: model.predict(envs.normalize_obs(rows), deterministic=True)[0], OBSERVATION)
    print(
        f"median return of {FLIGHTS} unseen flights, {TICKS} at most: PPO {ppo:.0f}, PID {median_return(pid.act):.0f}"
    )


if __name__ == "__main__":
    main()
