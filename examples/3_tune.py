"""Search gains for the thesis's PID, and fly them against table 7.1 through the lab's camera: 3_tune.png."""

import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np

from crazyflie_gym import CrazyflieVectorEnv
from crazyflie_gym.training import LAB


def distances(controller, ticks=500):
    """The distance to the marker, one column per seed, on the thesis's 80 cm."""
    start = {"start_m": [0.8, 0.0, 0.7]}
    envs = CrazyflieVectorEnv(32, vertical="pwm", effects=LAB, task_options=start, true_state=True)
    pilot = envs.controller(controller)
    _, info = envs.reset(seed=0)
    rows = []
    for _ in range(ticks):
        rows.append(np.linalg.norm(info["true_state"][:, :3] - [0, 0, 0.7], axis=1))
        _, _, _, _, info = envs.step(envs.act(pilot))
    return np.array(rows)


def main():
    tune = [sys.executable, "-m", "crazyflie_gym", "tune", "--out", "gains.json", "--picture", "3_tune.svg"]
    subprocess.run(tune, check=True)
    for controller in ("thesis-pid", "pid:gains.json"):
        flown = distances(controller)
        rms = 100 * np.sqrt(np.median((flown**2).mean(axis=0)))
        print(f"{controller}: RMS error {rms:.1f} cm over 10 s")
        plt.plot(np.arange(len(flown)) * 0.02, np.median(flown, axis=1), label=controller)
    plt.gca().set(xlabel="s", ylabel="distance to the set-point, m (median of 32)", ylim=(0, None))
    plt.title("80 cm to the marker, through the lab's camera")
    plt.legend()
    plt.savefig("3_tune.png", dpi=100)
    print("the pictures are 3_tune.png and 3_tune.svg")


if __name__ == "__main__":
    main()
