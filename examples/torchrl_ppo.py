"""TorchRL's PPO on the stock id: `pip install torchrl`. Parts and numbers are those of TorchRL's tutorial."""

import argparse
import warnings

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import crazyflie_gym  # noqa: F401  registers the environments

FLIGHTS, UNSEEN = 32, 10**9


def mean_return(act, flights=64):
    """The mean return of whole flights from unseen seeds; `act` gives actions (flights, 4) for environments, rows."""
    envs = gym.make_vec("Crazyflie-v0", flights)
    rows, _ = envs.reset(seed=UNSEEN)
    total, flying = np.zeros(flights), np.ones(flights, bool)
    while flying.any():
        rows, rewards, terminated, truncated, _ = envs.step(act(envs, rows))
        total += flying * rewards
        flying &= ~(terminated | truncated)
    return total.mean()


def layers(inputs, outputs):
    """Two hidden layers of 64."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    try:
        from tensordict.nn import TensorDictModule
        from tensordict.nn.distributions import NormalParamExtractor
        from torchrl.collectors import Collector
        from torchrl.envs import GymWrapper
        from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
        from torchrl.objectives import ClipPPOLoss
        from torchrl.objectives.value import GAE
    except ImportError:
        print("SKIPPED: TorchRL is not installed: pip install torchrl")
        return
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    # TorchRL resets environments itself
    env = GymWrapper(gym.make_vec("Crazyflie-v0", FLIGHTS, autoreset_mode="disabled"))
    env.set_seed(args.seed)
    width = env.observation_spec["observation"].shape[-1]
    mean_and_spread = nn.Sequential(layers(width, 8), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(mean_and_spread, ["observation"], ["loc", "scale"]),
        spec=env.action_spec,
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(layers(width, 1), in_keys=["observation"])
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=1e-4)
    optimiser = torch.optim.Adam(loss.parameters(), 3e-4)
    for batch in Collector(env, actor, frames_per_batch=64 * FLIGHTS, total_frames=args.steps):
        for _ in range(10):
            advantage(batch)
            rows = batch.reshape(-1)
            for part in torch.randperm(len(rows)).split(256):
                found = loss(rows[part])
                optimiser.zero_grad()
                (found["loss_objective"] + found["loss_critic"] + found["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()

    def policy(_, rows):
        with torch.no_grad():
            return torch.tanh(mean_and_spread(torch.as_tensor(rows))[0]).numpy()

    pid, still = gym.make_vec("Crazyflie-v0", 64).pid(), np.zeros((64, 4), np.float32)
    print(f"doing nothing {mean_return(lambda envs, rows: still):.1f}")
    print(f"thesis PID    {mean_return(lambda envs, rows: envs.act(pid)):.1f}")
    print(f"PPO           {mean_return(policy):.1f}")


if __name__ == "__main__":
    main()
