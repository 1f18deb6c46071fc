"""Train with RLlib on the native batch: every worker calls gymnasium.make_vec with the vector entry point."""

import argparse


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=1)
    parser.add_argument("--envs", type=int, default=16)
    args = parser.parse_args()
    try:
        import ray
        from ray.rllib.algorithms.ppo import PPOConfig
    except ImportError:
        print('SKIPPED: RLlib is not installed: pip install "crazyflie-gym[rllib]"')
        return
    # a cluster of its own: one that another program runs may end at any time
    ray.init(address="local")
    config = (
        PPOConfig()
        # the module before the colon is imported in every worker; env_config goes to gymnasium.make_vec
        .environment(
            "crazyflie_gym:Crazyflie-v0", env_config={"effects": {"drag_linear": 0.3}, "max_episode_steps": 250}
        )
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=args.envs,
            gym_env_vectorize_mode="vector_entry_point",
        )
        .training(train_batch_size=args.envs * 250, minibatch_size=500, num_epochs=2)
    )
    algorithm = config.build_algo()
    for iteration in range(args.iterations):
        result = algorithm.train()["env_runners"]
        print(f"iteration {iteration + 1}: mean return {result['episode_return_mean']:.2f}")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
