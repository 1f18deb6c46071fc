"""Controllers through the benchmark: signed attempts, a leaderboard, and a picture of the scores: 5_submit.png.

    python examples/5_submit.py thesis-pid lqr policy:hover.safetensors

A controller that is not part of the program flies from afar: submit_own.py.
"""

import json
import subprocess
import sys

import matplotlib.pyplot as plt

SCENARIOS = ["hover-aruco", "fly-80cm"]


def crazyflie(*args):
    """Run the program, and return what it says."""
    done = subprocess.run([sys.executable, "-m", "crazyflie_gym", *args], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.stderr)
    return done.stdout


def main():
    controllers = sys.argv[1:] or ["thesis-pid", "stock-pid", "lqr"]
    figure, panels = plt.subplots(1, len(SCENARIOS), figsize=(10, 4), sharey=True, layout="constrained")
    for panel, scenario in zip(panels, SCENARIOS, strict=True):
        for controller in controllers:
            told = crazyflie(
                "bench",
                "submit",
                "--controller",
                controller,
                "--scenario",
                scenario,
                "--data",
                "bench.sqlite",
                "--json",
            )
            row = json.loads(told)
            score = row["result"]["score"]
            spread = [[score["score"] - score["low"]], [score["high"] - score["score"]]]
            bar = panel.bar(row["controller"], score["score"], yerr=spread, capsize=4)
            panel.bar_label(bar, fmt="%.0f", padding=4)
            # flown again from the stored actions, compared to the bit
            print(crazyflie("bench", "verify", row["id"], "--data", "bench.sqlite").strip())
        panel.set(title=scenario, ylim=(0, 100))
        print(crazyflie("bench", "leaderboard", "--scenario", scenario, "--data", "bench.sqlite"))
    panels[0].set_ylabel("score with 95 % interval")
    figure.savefig("5_submit.png", dpi=100)
    print("the picture is 5_submit.png")


if __name__ == "__main__":
    main()
