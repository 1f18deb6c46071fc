"""Predicts the same real flights with several simulators: the table and the picture of docs/simulators.md.

    python examples/simulators/compare.py ../shared/data/nanobench [--json F] [--page F.md] [--picture F.svg]

From the measured state of an instant the flight's own commands drive each simulator for 2 s, every 0.25 s anew.
Simulators are those of `adapters.py` and `peers.py`; `real_flights.py` prepares the recordings.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import peers  # noqa: F401, registers them
from adapters import FITS, SIMULATORS, Entry
from errors import HORIZONS_S, flight_errors
from real_flights import DT_S, FIT, TEST, Flight, cut_windows, read_flight
from report import MARK, as_json, draw, filled, table

EVERY_S = 0.25


def fit_model(data: Path, names: list[str], folder: Path, model: str) -> Path:
    """Return the path of a model of FITS; where the folder has none, `crazyflie` finds it from these flights of `data`.

    `explain` judges by every third of the flights, which then say what is missing and not how large it is.

    Raises:
        subprocess.CalledProcessError: if a flight is missing or a fit fails; the program has said why.
    """

    def crazyflie(*words: object) -> str:
        command = [sys.executable, "-m", "crazyflie_gym", *map(str, words)]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout

    path, found = folder / f"{model}.json", folder / f"{model}.toml"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    logs = [data / f"{name}.csv.gz" for name in names]
    verb, *options = FITS[model]
    if verb == "explain":
        declared = fit_model(data, names, folder, "identified")
        judged = logs[1::3]
        fitted = [log for log in logs if log not in judged]
        crazyflie(verb, declared, "--fit", *fitted, "--test", *judged, "--out", folder / model)
        found = folder / model / "model.toml"
    else:
        crazyflie(verb, "--fit", *logs, *options, "--out", found)
    path.write_text(crazyflie("model", found, "--show", "--json"))
    return path


def compare(flights: list[Flight], entries: dict[str, Entry], models: dict[str, Path] | None = None) -> dict[str, dict]:
    """Return for each simulator its `errors` (flights, 4, 3), or `missing`: what is not installed.

    Args:
        flights: to predict.
        entries: simulators by their names.
        models: paths of the fitted models that they need, by the names of FITS.

    Raises:
        KeyError: if a simulator needs a model that is not there.
        ValueError: if one answers with what is no prediction.
    """
    windows = [cut_windows(flight, max(HORIZONS_S), EVERY_S) for flight in flights]
    found = {}
    for name, entry in entries.items():
        try:
            simulator = entry.make(None if entry.model is None else (models or {})[entry.model])
        except ModuleNotFoundError as error:
            found[name] = {"missing": str(error.name)}
            continue
        began = time.perf_counter()
        errors = [
            flight_errors(simulator.predict(start, command, DT_S), measured, DT_S)
            for start, command, measured in windows
        ]
        found[name] = {"errors": np.array(errors), "seconds": round(time.perf_counter() - began, 1)}
    return found


def main() -> None:
    """Fit, predict, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of NanoBench recordings, *.csv.gz")
    parser.add_argument("--flights", nargs="+", default=TEST, help="recordings to predict (default: those of the test)")
    parser.add_argument(
        "--fit", nargs="+", default=FIT, help="recordings to fit our models to (default: those of the fit)"
    )
    parser.add_argument("--only", nargs="+", choices=SIMULATORS, default=list(SIMULATORS), help="simulators to compare")
    parser.add_argument("--models", type=Path, help="folder of our fitted models, kept and used again")
    parser.add_argument("--json", type=Path, metavar="F", help="write all figures into this file")
    parser.add_argument(
        "--page", type=Path, metavar="F.md", help=f"put the table between two lines {MARK} of this page"
    )
    parser.add_argument("--picture", type=Path, metavar="F.svg", help="draw the errors; needs matplotlib")
    args = parser.parse_args()
    if seen := set(args.fit) & set(args.flights):
        parser.error(f"{', '.join(sorted(seen))}: a flight of the fit says nothing of the test")
    flights = [read_flight(args.data / f"{name}.csv.gz") for name in args.flights]
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.models or Path(scratch)
        entries = {name: SIMULATORS[name] for name in args.only}
        needed = {entry.model for entry in entries.values() if entry.model}
        models = {model: fit_model(args.data, args.fit, folder, model) for model in sorted(needed)}
        found = compare(flights, entries, models)
    text = table(found)
    if args.json:
        args.json.write_text(as_json(found, args.flights))
    if args.picture:
        draw(found, args.picture)
    if args.page:
        args.page.write_text(filled(args.page.read_text(), text))
    print(text)


if __name__ == "__main__":
    main()
