"""Eight drones change places through the middle, with and without the layer that avoids collisions: swarm_swap.png."""

import matplotlib.pyplot as plt
import numpy as np

from crazyflie_gym.swarm import METRICS, CrazyflieSwarm

WORLDS, STEPS = 100, 800


def fly(avoid):
    """The metrics of every world's first episode, and the tracks of the first world, (ticks, drones, 2)."""
    worlds = CrazyflieSwarm(WORLDS, "swap", drones=8, max_episode_steps=STEPS)
    pid = worlds.controller("thesis-pid", avoid=avoid)
    worlds.reset(seed=1)
    ended, tracks = {}, []
    while len(ended) < WORLDS:
        _, _, _, _, info = worlds.step(worlds.act(pid))
        if 0 not in ended:
            tracks.append(worlds.states()[0, :, :2])
        over = ~info["flying"].any(axis=1)
        for world in np.flatnonzero(over):
            ended.setdefault(int(world), info["metrics"][world])
        pid.reset(over)
    metrics = np.array(list(ended.values()))
    return {name: metrics[:, i] for i, name in enumerate(METRICS)}, np.array(tracks)


def main():
    figure, axes = plt.subplots(1, 2, figsize=(10, 5), sharex=True, sharey=True)
    print(f"{WORLDS} swaps of 8 drones   collided  arrived  least separation  settled (median)")
    for ax, (name, avoid) in zip(axes, {"without avoidance": False, "with avoidance": True}.items(), strict=True):
        metrics, tracks = fly(avoid)
        hit, done = metrics["collisions"].sum(), metrics["done"].sum()
        print(
            f"{name:24s} {hit:8.0f} {done:8.0f} {100 * metrics['min_separation_m'].min():14.1f} cm"
            f" {np.median(metrics['settled_s']):12.1f} s"
        )
        for drone in range(tracks.shape[1]):
            ax.plot(*tracks[:, drone].T, linewidth=1)
            ax.plot(*tracks[0, drone], "o", color=ax.lines[-1].get_color())
        ax.set(title=f"{name}: {hit:.0f} of {8 * WORLDS} drones collided", xlabel="x, m", aspect="equal")
    axes[0].set_ylabel("y, m")
    figure.tight_layout()
    figure.savefig("swarm_swap.png", dpi=100)
    print("the picture is swarm_swap.png")


if __name__ == "__main__":
    main()
