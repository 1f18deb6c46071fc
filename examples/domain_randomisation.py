"""Another vehicle on another day in every flight, and an effect that nobody was told of: domain_randomisation.png.

python -m crazyflie_gym.ppo track --out plain.safetensors
python -m crazyflie_gym.ppo track --randomised --out randomised.safetensors
python examples/domain_randomisation.py thesis-pid policy:plain.safetensors policy:randomised.safetensors
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from crazyflie_gym.evaluation import Scenario, Work, fly
from crazyflie_gym.training import LAB, RANDOMISED

CONDITIONS = {
    "nominal": LAB,
    "randomised": RANDOMISED,
    "centre of mass": LAB | {"com_offset": {"roll_deg": 2.5, "pitch_deg": -2.0}},
    "motor lag": LAB | {"motor_lag": {"torque_lag_s": 0.06}},
    "weak motor": LAB | {"weak_motor": {"motor": 2, "loss": 0.08}},
}
FLIGHTS = 256


def main():
    controllers = sys.argv[1:] or ["thesis-pid", "lqr"]
    figure, panel = plt.subplots(figsize=(10, 4))
    print(f"RMS error of {FLIGHTS} flights of 10 s from up to 80 cm away, in cm: median, 90 %, failed")
    print(" " * 28 + "".join(f"{name:>22s}" for name in CONDITIONS))
    for place, controller in enumerate(controllers):
        cells, boxes = [], []
        for effects in CONDITIONS.values():
            flights = fly(Work.of(Scenario(ticks=500, effects=effects), controller, first_seed=10**9, count=FLIGHTS))
            errors = np.array([np.inf if flight["failed"] else 100 * flight["rmse_m"] for flight in flights])
            middle, most = np.quantile(errors, [0.5, 0.9], method="lower")
            cells.append(f"{middle:8.1f} {most:7.1f} {np.isinf(errors).sum():5d}")
            boxes.append(np.where(np.isinf(errors), 100.0, errors))
        print(f"{controller:28s}" + "".join(f"{cell:>22s}" for cell in cells))
        places = np.arange(len(CONDITIONS)) + 0.2 * place
        drawn = panel.boxplot(boxes, positions=places, widths=0.15, sym="", patch_artist=True, manage_ticks=False)
        for box in drawn["boxes"]:
            box.set(facecolor=f"C{place}", label=controller if box is drawn["boxes"][0] else None)
    panel.set(ylabel="RMS error, cm (a failed flight counts 100)", ylim=(0, 100))
    panel.set_xticks(np.arange(len(CONDITIONS)) + 0.1 * (len(controllers) - 1), CONDITIONS)
    panel.legend()
    figure.savefig("domain_randomisation.png", dpi=100)
    print("the picture is domain_randomisation.png")


if __name__ == "__main__":
    main()
