"""Identifies a vehicle from some flights of a folder and predicts the others, until each was left out once.

    python tests/left_out_flights.py ../shared/data/nanobench --parts 4 [options of crazyflie identify]

Test flights are no place to choose in. This is: it prints the root mean square errors of velocity 0.5 and 2 s ahead
over all predictions of left-out flights. The flights that docs/identification.md keeps for the test are not read.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import subprocess
from pathlib import Path

# of README.md beside the recordings; one more flight of the fit holds no commands
FIT = (
    "B10_lissajous_fast_rep1",
    "B2_circle_fast_rep2",
    "B2_circle_medium_rep2",
    "B3_figure8_fast_rep1",
    "B3_figure8_medium_rep2",
    "B5_helix_medium_rep1",
    "B6_linear_ramp_rep2",
    "B7_oval_fast_rep2",
    "B8_star_fast_rep1",
    "B8_star_slow_rep1",
    "B9_trefoil_fast_rep14",
)
AXES = ("sideways", "vertical", "in space")
HORIZONS_S = (0.5, 2.0)


def predict_left_out(program: str, fit: list[Path], left_out: list[Path], options: list[str]) -> list[dict]:
    """Errors of each left-out flight: its name, its number of predictions and `rms[axis][horizon]`."""
    command = [program, "identify", "--fit", *map(str, fit), "--test", *map(str, left_out), "--json", *options]
    found = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(found.stdout)["flights"]["test"]["errors"]


def pool(errors: list[dict], axis: int, horizon: int) -> float:
    """Root mean square over the predictions of all flights."""
    squares = sum(flight["predictions"] * flight["rms"][axis][horizon] ** 2 for flight in errors)
    return math.sqrt(squares / sum(flight["predictions"] for flight in errors))


def main() -> None:
    """Identifies, predicts and prints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="recordings of NanoBench")
    parser.add_argument("--parts", type=int, default=4, help="how often it is identified (default: 4)")
    parser.add_argument("--seed", type=int, default=1, help="decides which flights go together (default: 1)")
    parser.add_argument("--program", default="target/release/crazyflie", help="(default: %(default)s)")
    args, options = parser.parse_known_args()
    flights = sorted((args.folder / f"{name}.csv.gz" for name in FIT), key=lambda path: path.name)
    if missing := [path for path in flights if not path.exists()]:
        parser.error(f"{missing[0]} is missing")
    random.Random(args.seed).shuffle(flights)
    errors = []
    for part in range(args.parts):
        left_out = flights[part :: args.parts]
        fit = [path for path in flights if path not in left_out]
        errors += predict_left_out(args.program, fit, left_out, options)
    for horizon, horizon_s in enumerate(HORIZONS_S):
        figures = (f"{name} {pool(errors, axis, horizon):.4f} m/s" for axis, name in enumerate(AXES))
        print(f"velocity {horizon_s} s ahead: {', '.join(figures)}")


if __name__ == "__main__":
    main()
