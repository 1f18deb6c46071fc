"""Train with Stable-Baselines3's PPO for a few seconds; --steps 1000000 for a policy that hovers."""

import argparse


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=8_192)
    parser.add_argument("--envs", type=int, default=32)
    args = parser.parse_args()
    try:
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
    except ImportError:
        print('SKIPPED: Stable-Baselines3 is not installed: pip install "crazyflie-gym[sb3]"')
        return
    from crazyflie_gym.sb3 import Sb3VecEnv

    envs = VecNormalize(VecMonitor(Sb3VecEnv("Crazyflie-v0", num_envs=args.envs)), norm_reward=False)
    model = PPO("MlpPolicy", envs, n_steps=128, batch_size=1024, n_epochs=3, gamma=0.98, device="cpu", seed=0)
    model.learn(args.steps)
    envs.training = False
    observations, total = envs.reset(), 0.0
    for _ in range(250):
        observations, rewards, _, _ = envs.step(model.predict(observations, deterministic=True)[0])
        total += rewards.mean()
    print(f"mean reward per step after {model.num_timesteps} steps: {total / 250:.3f} (1 is perfect)")


if __name__ == "__main__":
    main()
