"""Training, five seeds of each task: where the seconds went, and unseen flights against other controllers.

    python python_client/bench_training.py [--seeds 5] [--tasks hover track]

Needs the extra `train`. A policy beats a rival in a scenario of the benchmark if its score is higher.
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

from crazyflie_gym.ppo import RIVALS, SCENARIOS

PARTS = ("compiling", "network", "simulation", "learning", "rest", "whole", "processor")


def train(task, seed, out):
    """The seconds of each part, of the process and of the processor for it; and the scores of its comparison."""
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
    scores = {
        (row["scenario"].split("@")[0], row["controller"].split(":")[0]): row["score"] for row in result["comparison"]
    }
    return [parts[part] for part in PARTS], scores


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--tasks", nargs="+", choices=SCENARIOS, default=list(SCENARIOS))
    args = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}")
    for task in args.tasks:
        spent, won = [], dict.fromkeys(RIVALS, 0)
        print(f"\n{task}: seconds for {', '.join(PARTS)}; then scores in {', '.join(SCENARIOS[task])}")
        for seed in range(args.seeds):
            with tempfile.TemporaryDirectory() as folder:
                seconds, scores = train(task, seed, f"{folder}/policy.safetensors")
            spent.append(seconds)
            for rival in RIVALS:
                won[rival] += all(scores[name, "policy"] > scores[name, rival] for name in SCENARIOS[task])
            if seed == 0:
                for rival in RIVALS:
                    print(f"{rival:56s} {'  '.join(f'{scores[name, rival]:5.2f}' for name in SCENARIOS[task])}")
            ours = "  ".join(f"{scores[name, 'policy']:5.2f}" for name in SCENARIOS[task])
            print(f"seed {seed} {' '.join(f'{s:6.1f}' for s in seconds)}  {ours}", flush=True)
        print("median " + " ".join(f"{statistics.median(part):6.1f}" for part in zip(*spent, strict=True)))
        print("; ".join(f"{count} of {args.seeds} beat {rival} everywhere" for rival, count in won.items()))


if __name__ == "__main__":
    main()
