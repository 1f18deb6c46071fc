"""Every controller of the program flies the thesis's 80 cm, ideally and through the lab's camera: 2_compare.png."""

import matplotlib.pyplot as plt
import numpy as np

import crazyflie_gym
from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.training import LAB

NAMES = [c["name"] for c in crazyflie_gym.controllers() if c["file"] is None and c["name"] not in ("hover", "random")]
OPTIONS = {"start_m": [0.8, 0.0, 0.7]}
RIGS = {"ideal": {}, "lab": LAB}


def path(name, effects, ticks=400):
    """The distance to the marker over the first seconds, one column per seed."""
    envs = crazyflie_gym.CrazyflieVectorEnv(
        9, vertical="pwm", effects=effects, task_options=OPTIONS, true_state=True, max_episode_steps=-1
    )
    pilot = envs.controller(name)
    _, info = envs.reset(seed=0)
    rows = []
    for _ in range(ticks):
        rows.append(np.linalg.norm(info["true_state"][:, :3] - [0, 0, 0.7], axis=1))
        _, _, _, _, info = envs.step(envs.act(pilot))
    return np.array(rows)


def main():
    print("medians over 64 flights of 15 s      RMS error      reward    failed")
    figure, panels = plt.subplots(1, len(RIGS), figsize=(10, 4), sharey=True, layout="constrained")
    for panel, (rig, effects) in zip(panels, RIGS.items(), strict=True):
        for place, name in enumerate(NAMES):
            flights = fly(
                Work(Scenario(ticks=750, effects=effects, task_options=OPTIONS), name, first_seed=0, count=64)
            )
            failed = sum(flight["failed"] for flight in flights)
            cm = 100 * median(flights, "rmse_m")
            print(f"{rig:6s} {name:26s} {cm:10.1f} cm {median(flights, 'reward'):11.3f} {failed:9d}")
            distances = path(name, effects)
            # narrower and narrower: LQR and MPC fly alike
            panel.plot(np.arange(len(distances)) * 0.02, np.median(distances, axis=1), lw=2.8 - 0.5 * place, label=name)
        panel.set(title=f"{rig} rig", xlabel="s", ylim=(0, 1.2))
    panels[0].set_ylabel("distance to the set-point, m (median of 9)")
    panels[0].legend()
    figure.savefig("2_compare.png", dpi=100)
    print("the picture is 2_compare.png")


if __name__ == "__main__":
    main()
