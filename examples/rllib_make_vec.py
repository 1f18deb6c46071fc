"""Train with RLlib on the native batch: every worker calls gymnasium.make_vec with the vector entry point."""

import argparse
import math

# with the velocity of the Kalman filter, which no sensor measures
OBSERVATION = ["est_error_m", "est_vel_mps", "attitude_rad", "gyro_radps", "last_action"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--envs", type=int, default=64)
    args = parser.parse_args()
    try:
        import ray
        from ray.rllib.algorithms.ppo import PPOConfig
        from ray.rllib.connectors.env_to_module import MeanStdFilter
    except ImportError:
        print('SKIPPED: RLlib is not installed: pip install "crazyflie-gym[rllib]"')
        return
    # a cluster of its own: one that another program runs may end at any time
    ray.init(address="local")
    options = {"observation": OBSERVATION, "effects": {"drag_linear": 0.3}, "max_episode_steps": 250}
    config = (
        PPOConfig()
        # the module before the colon is imported in every worker; env_config goes to gymnasium.make_vec
        .environment("crazyflie_gym:Crazyflie-v0", env_config=options)
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=args.envs,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=128,
            env_to_module_connector=lambda env, spaces, device: MeanStdFilter(),
        )
        .rl_module(model_config={"fcnet_hiddens": [64, 64], "vf_share_layers": False})
        .training(
            train_batch_size=args.envs * 128, minibatch_size=1024, num_epochs=5, lr=1e-3, gamma=0.97, grad_clip=0.5
        )
    )
    algorithm = config.build_algo()
    for iteration in range(args.iterations):
        result = algorithm.train()["env_runners"]
        # nothing, or no number, where no flight has ended
        if math.isfinite(mean := result.get("episode_return_mean", math.nan)):
            print(f"iteration {iteration + 1}: mean return {mean:.2f}", flush=True)
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
