"""Puts known faults of a rig into recorded flights, and lists the effects that `explain` names.

    python tests/recorded/faults.py ../shared/data/nanobench --jobs 2

The sets that start with `a` set the rules for turned frames and early commands, and those with `b` judge them. The rule
for late commands was shaped after a look at all four.
"""

import argparse
import gzip
import json
import math
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

PROGRAM = [sys.executable, "-m", "crazyflie_gym"]
# flights to fit, flights to test
SETS = {
    "a_fast": (
        ("B2_circle_medium_rep2", "B3_figure8_fast_rep1", "B7_oval_fast_rep2"),
        ("B8_star_fast_rep1", "B9_trefoil_fast_rep14", "B10_lissajous_fast_rep1"),
    ),
    "b_slow": (
        ("B5_helix_medium_rep1", "B6_linear_ramp_rep2", "B8_star_slow_rep1"),
        ("B2_circle_slow_rep2", "B3_figure8_slow_rep1", "B7_oval_fast_rep3", "B8_star_medium_rep1"),
    ),
    "a_mixed": (
        ("B2_circle_fast_rep2", "B3_figure8_medium_rep2", "B9_trefoil_slow_rep15"),
        ("B7_oval_fast_rep2", "B8_star_fast_rep1", "B10_lissajous_fast_rep1"),
    ),
    "b_medium": (
        ("B3_figure8_slow_rep1", "B7_oval_fast_rep3", "B8_star_medium_rep1"),
        ("B2_circle_slow_rep2", "B5_helix_medium_rep1", "B8_star_slow_rep1"),
    ),
}  # fmt: skip
FAULTS = {
    "none": {},
    "turned +8 deg": {"turn_deg": 8.0},
    "turned -8 deg": {"turn_deg": -8.0},
    "turned -5 deg": {"turn_deg": -5.0},
    "80 ms early": {"early_s": 0.08},
    "50 ms early": {"early_s": 0.05},
    "50 ms late": {"early_s": -0.05},
    "80 ms late": {"early_s": -0.08},
}


def with_faults(paths, out, turn_deg=0.0, early_s=0.0):
    """Copies of NanoBench logs with positions turned about z, or commands stamped early (late if negative)."""
    turn = math.radians(turn_deg)
    for path in paths:
        with gzip.open(path, "rt") as file:
            names = file.readline().strip().split(",")
            columns = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
        for x, y in (("px", "py"), ("vx", "vy")):
            east, north = columns[x], columns[y]
            columns[x] = math.cos(turn) * east - math.sin(turn) * north
            columns[y] = math.sin(turn) * east + math.cos(turn) * north
        for name in names:
            if name.startswith(("pid_controller", "motor_")):
                columns[name] = np.interp(columns["t"] + early_s, columns["t"], columns[name])
        rows = np.array(list(columns.values())).T
        np.savetxt(out / path.name, rows, "%.9f", ",", header=",".join(names), comments="")
    return [out / path.name for path in paths]


def explain(data, flights, out, program=PROGRAM, model="cf21", **fault):
    """A finished `explain --json` on a set of flights with a fault."""
    fit, test = (with_faults([data / f"{name}.csv.gz" for name in names], out, **fault) for names in SETS[flights])
    command = [*program, "explain", model, "--fit", *fit, "--test", *test, "--out", out / "found", "--json"]
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)


def as_row(done):
    """The verdict, the effects with their first parameters, and the seconds; or the error."""
    if done.returncode:
        return done.stderr.strip().splitlines()[0]
    found = json.loads(done.stdout)
    names = []
    for effect in found["effects"]:
        name, estimate = next(iter(effect["params"].items()))
        names.append(f"{effect['name']} ({name} {estimate['value']:.3g} +- {estimate['stderr'] or math.nan:.1g})")
    return f"{found['verdict']}: {'; '.join(names) or '-'}; {found['seconds']:.0f} s"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of NanoBench recordings")
    parser.add_argument("--model", default="cf21")
    parser.add_argument("--sets", default="", help="sets whose names start so, like `b`")
    parser.add_argument("--faults", default="", help="faults whose names contain this")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--program", nargs="+", default=PROGRAM)
    args = parser.parse_args()
    cases = [(s, f) for s in SETS if s.startswith(args.sets) for f in FAULTS if args.faults in f]

    def row(case):
        flights, fault = case
        with tempfile.TemporaryDirectory() as folder:
            return as_row(explain(args.data, flights, Path(folder), args.program, args.model, **FAULTS[fault]))

    with ThreadPoolExecutor(args.jobs) as pool:
        rows = pool.map(row, cases)
        for (flights, fault), text in zip(cases, rows, strict=True):
            print(f"{flights:8} {fault:14} {text}", flush=True)


if __name__ == "__main__":
    main()
