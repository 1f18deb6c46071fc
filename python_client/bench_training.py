"""Training from scratch, five seeds of each task: where the seconds went, and unseen flights against the thesis's PID.

    python python_client/bench_training.py [--seeds 5] [--tasks hover track]

Needs the extra `train`. A policy beats the PID if its median reward is higher, its median RMS error smaller, and none
of its flights fails.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time

from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.training import LAB

HOVER = {"start_radius_m": 0.8, "start_yaw_deg": 20.0}
FLOWN = {
    "hover": {
        "hover": Scenario(ticks=500, effects=LAB, task_options=HOVER),
        "80 cm": Scenario(ticks=750, effects=LAB, task_options={"start_m": [0.8, 0.0, 0.7]}),
    },
    "track": {
        "figure eight, 8 s": Scenario("CrazyflieTrack-v0", 1000, effects=LAB),
        "figure eight, 10 s": Scenario("CrazyflieTrack-v0", 1000, effects=LAB, task_options={"period_s": 10.0}),
    },
}
UNSEEN, FLIGHTS = 10**9, 128
PARTS = ("compiling", "network", "simulation", "learning", "rest", "whole", "processor")


def figures(controller, scenario):
    """Median reward, median RMS error in cm, failed flights."""
    flights = fly(Work.of(scenario, controller, UNSEEN, FLIGHTS))
    failed = sum(flight["failed"] for flight in flights)
    return median(flights, "reward"), 100 * median(flights, "rmse_m"), failed


def train(task, seed, out):
    """The seconds of each part, of a process of its own from its start to its end, and of the processor for it."""
    start, before = time.perf_counter(), os.times()
    command = [sys.executable, "-m", "crazyflie_gym.ppo", task, "--seed", str(seed), "--out", out, "--json"]
    result = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    whole, after = time.perf_counter() - start, os.times()
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    parts = result["seconds"] | {
        "rest": whole - sum(result["seconds"][part] for part in PARTS[:4]),
        "whole": whole,
        "processor": processor,
    }
    return [parts[part] for part in PARTS]


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--tasks", nargs="+", choices=FLOWN, default=list(FLOWN))
    args = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}")
    for task in args.tasks:
        pid = {name: figures("thesis-pid", scenario) for name, scenario in FLOWN[task].items()}
        spent, won = [], 0
        print(f"\n{task}: seconds for {', '.join(PARTS)}; then reward, RMS error, failed of {FLIGHTS}")
        summary = "; ".join(f"{name} {reward:.3f} {cm:.1f} cm {failed}" for name, (reward, cm, failed) in pid.items())
        print(f"thesis PID                                            {summary}")
        for seed in range(args.seeds):
            with tempfile.TemporaryDirectory() as folder:
                out = f"{folder}/policy.safetensors"
                spent.append(train(task, seed, out))
                ours = {name: figures(f"policy:{out}", scenario) for name, scenario in FLOWN[task].items()}
            beats = all(
                ours[name][0] > r and ours[name][1] < cm and ours[name][2] == 0 for name, (r, cm, _) in pid.items()
            )
            won += beats
            summary = "; ".join(
                f"{name} {reward:.3f} {cm:.1f} cm {failed}" for name, (reward, cm, failed) in ours.items()
            )
            seconds = " ".join(f"{s:6.1f}" for s in spent[-1])
            print(f"seed {seed} {seconds}  {summary}  {'beats it' if beats else 'DOES NOT BEAT IT'}", flush=True)
        medians = " ".join(f"{statistics.median(part):6.1f}" for part in zip(*spent, strict=True))
        print(f"median {medians}  {won} of {args.seeds} beat the PID")


if __name__ == "__main__":
    main()
