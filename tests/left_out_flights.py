"""Identifies a vehicle from some flights and predicts the others, until each was left out once.

    python tests/left_out_flights.py a.csv b.csv c.csv d.csv [--parts 4] [--seed 1] [-- options of crazyflie identify]

Test flights are no place to choose in. This is: it prints the root mean square errors of velocity 0.5 and 2 s ahead
over all predictions of left-out flights.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import subprocess
import sys
from pathlib import Path

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
    parser.add_argument("flights", type=Path, nargs="+", help="logs to fit and to predict")
    parser.add_argument("--parts", type=int, default=4, help="how often it is identified (default: 4)")
    parser.add_argument("--seed", type=int, default=1, help="decides which flights go together (default: 1)")
    parser.add_argument("--program", default="target/release/crazyflie", help="(default: %(default)s)")
    given = sys.argv[1:]
    end = given.index("--") if "--" in given else len(given)
    options = given[end + 1 :]
    args = parser.parse_args(given[:end])
    flights = sorted(args.flights, key=lambda path: path.name)
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
