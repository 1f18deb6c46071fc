"""Compares the speed of stepping between an older commit and this checkout, in alternating runs.

    python tests/paired_bench.py COMMIT [--repeats 9]

Both are built in worktrees of their own under `target/paired`. Each pair of runs gives a ratio new / old; printed are
the medians and the spread of the ratios. Keep the machine idle: what else runs makes the spread wider.
"""

import argparse
import re
import statistics
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
# file of the bench, name of the case: one drone bare and with five effects, eight drones
CASES = [
    ("step", "bare/{isa}/1024_envs_one_core"),
    ("step", "five_effects/{isa}/1024_envs_one_core"),
    ("swarm", "swarm/downwash/8_drones_1024_worlds"),
]
UNITS = {"K": 1e-3, "M": 1.0, "G": 1e3}


def build(commit, folder):
    """Returns the programs of the benches of a commit, by file."""
    source = folder / "source"
    if not source.exists():
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(source)], check=True)
    subprocess.run(["git", "fetch", "--quiet", str(ROOT), commit], cwd=source, check=True)
    subprocess.run(["git", "checkout", "--quiet", "--detach", "FETCH_HEAD"], cwd=source, check=True)
    command = ["cargo", "bench", "-p", "crazyflie-env", "--no-run", "--target-dir", str(folder / "target")]
    said = subprocess.run(command, cwd=source, check=True, capture_output=True, text=True).stderr
    return dict(re.findall(r"benches/(\w+)\.rs \((\S+)\)", said))


def measure(program, case, folder):
    """Returns the median throughput in million steps per second."""
    command = [
        program,
        "--bench",
        f"^{case}$",
        "--measurement-time",
        "1",
        "--warm-up-time",
        "0.5",
        "--sample-size",
        "10",
    ]
    said = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
    found = re.search(r"thrpt:\s+\[\S+ \S+ (\S+) (\S)elem", said)
    if found is None:
        raise SystemExit(f"{program} has no case {case!r}:\n{said}")
    return float(found[1]) * UNITS[found[2]]


def main():
    """Builds both, runs them in turn, and prints a line for each case."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("commit", help="the older commit, as Git names it")
    arguments.add_argument("--repeats", type=int, default=9, help="pairs of runs for each case (default 9)")
    arguments.add_argument("--isa", default="avx512", help="instruction set of the bench's cases (default avx512)")
    chosen = arguments.parse_args()
    paired = ROOT / "target/paired"
    hashes = [
        subprocess.run(["git", "rev-parse", name], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
        for name in (chosen.commit, "HEAD")
    ]
    programs = []
    for name, commit in zip(("old", "new"), hashes, strict=True):
        folder = paired / name
        folder.mkdir(parents=True, exist_ok=True)
        programs.append(build(commit, folder))
    print(f"old {hashes[0][:9]}, new {hashes[1][:9]}; million drone-steps per second, one core")
    for file, template in CASES:
        case = template.format(isa=chosen.isa)
        pairs = [tuple(measure(each[file], case, paired) for each in programs) for _ in range(chosen.repeats)]
        old, new = (statistics.median(side) for side in zip(*pairs, strict=True))
        ratios = [b / a for a, b in pairs]
        spread = f"{min(ratios):.3f} to {max(ratios):.3f}"
        print(f"{case}: old {old:.1f}, new {new:.1f}; ratio {statistics.median(ratios):.3f} ({spread})", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
