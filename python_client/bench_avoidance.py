"""Return and collisions of several drones with the avoidance layer and without it, on seeds that set nothing.

    python python_client/bench_avoidance.py

A table: by task, drones and controller, the collided drones, the share that arrived, the least separation and the mean
return of a drone, without the layer and with it.
"""

import argparse

import numpy as np

from crazyflie_gym.swarm import METRICS, CrazyflieSwarm

CASES = [("swap", 8), ("swap", 16), ("swap", 32), ("formation", None), ("follow", None), ("carry", None)]
CONTROLLERS = ("lqr", "thesis-pid")
FIRST_SEED = 300_000


def fly(task, drones, controller, avoid, worlds):
    """Return collided drones, the share that arrived, least separation in m and mean return, of first episodes."""
    options = {} if drones is None else {"drones": drones}
    swarm = CrazyflieSwarm(worlds, task, max_episode_steps=1000, **options)
    pilot = swarm.controller(controller, avoid=avoid)
    swarm.reset(seed=FIRST_SEED)
    returns = np.zeros((worlds, swarm.num_drones))
    metrics, over = np.zeros((worlds, len(METRICS))), np.zeros(worlds, bool)
    while not over.all():
        _, rewards, _, _, info = swarm.step(swarm.act(pilot))
        returns += np.where(over[:, None], 0.0, rewards)
        ends = ~info["flying"].any(axis=1) & ~over
        metrics[ends] = info["metrics"][ends]
        over |= ends
    column = dict(zip(METRICS, metrics.T, strict=True))
    arrived = column["done"].sum() / returns.size
    return swarm.num_drones, column["collisions"].sum(), arrived, column["min_separation_m"].min(), returns.mean()


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=32, help="worlds of each case (32)")
    worlds = parser.parse_args().worlds
    print(f"{worlds} worlds each, seeds from {FIRST_SEED}; without the layer -> with it")
    print("task      drones controller    collided      arrived       separation, m  return")
    for task, drones in CASES:
        for controller in CONTROLLERS:
            (count, *off), (_, *on) = (fly(task, drones, controller, avoid, worlds) for avoid in (False, True))
            hit, done, gap, total = ((a, b) for a, b in zip(off, on, strict=True))
            print(
                f"{task:9s} {count:6d} {controller:11s} {hit[0]:5.0f} -> {hit[1]:3.0f}  {100 * done[0]:4.0f} -> "
                f"{100 * done[1]:3.0f} %  {gap[0]:.2f} -> {gap[1]:.2f}   {total[0]:5.0f} -> {total[1]:4.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
