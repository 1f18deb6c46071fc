"""Predicts the same real flights with several simulators: the tables and the picture of docs/simulators.md.

    python examples/simulators/compare.py ../shared/data/nanobench [--json F] [--page F.md] [--picture F.svg]
    python examples/simulators/compare.py ../shared/data/crazyswarm2 --recordings stock [...]

From the measured state of an instant the flight's own commands drive each simulator for 2 s, every 0.25 s anew.
Simulators are those of `adapters.py` and `peers.py`, or by the forces of motors those of `motor_simulators.py`;
`real_flights.py` and `motor_flights.py` prepare the recordings.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import motor_flights
import motor_simulators  # noqa: F401, registers them, and `peers.py` too
import numpy as np
from adapters import BY_MOTORS, FITS, SIMULATORS, Entry, crazyflie
from errors import HORIZONS_S, flight_errors
from identify_motors import identify
from real_flights import DT_S, FIT, TEST, Flight, check_recordings, cut_windows, read_flight
from report import MARK, as_json, draw, filled, table

EVERY_S = 0.25


def fit_model(data: Path, names: list[str], folder: Path, model: str) -> Path:
    """Return the path of a model of FITS; where the folder has none, `crazyflie` finds it from these flights of `data`.

    `explain` judges by every third of the flights, which then say what is missing and not how large it is.

    Raises:
        subprocess.CalledProcessError: if a flight is missing or a fit fails; the program has said why.
    """
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


def fit_motors(data: Path, names: list[str], folder: Path, model: str) -> Path:
    """Return the path of the numbers that these flights of `data` give the motor-level form."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{model}.json"
    path.write_text(json.dumps(identify([motor_flights.read_motor_flight(data / name) for name in names])))
    return path


@dataclasses.dataclass(frozen=True)
class Recordings:
    """Real flights of one kind: names of those to fit and to predict, and what reads, fits and predicts them."""

    fit: list[str]
    test: list[str]
    ending: str
    read: Callable[[Path], Flight]
    fit_model: Callable[[Path, list[str], Path, str], Path]
    simulators: dict[str, Entry]


RECORDINGS = {
    "nanobench": Recordings(FIT, TEST, ".csv.gz", read_flight, fit_model, SIMULATORS),
    **{
        motors: Recordings(fit, motor_flights.TEST[motors], "", motor_flights.read_motor_flight, fit_motors, BY_MOTORS)
        for motors, fit in motor_flights.FIT.items()
    },
}


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
        errors = []
        for flight, (start, command, measured) in zip(flights, windows, strict=True):
            given = (start, command)
            if flight.forces == 4:
                given = motor_flights.trimmed(simulator, *given, measured)
            errors.append(flight_errors(simulator.predict(*given, DT_S), measured, DT_S))
        found[name] = {"errors": np.array(errors), "seconds": round(time.perf_counter() - began, 1)}
    return found


def main() -> None:
    """Fit, predict, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument(
        "--recordings", choices=RECORDINGS, default="nanobench", help="which of them (default: nanobench)"
    )
    parser.add_argument("--flights", nargs="+", help="recordings to predict (default: those of the test)")
    parser.add_argument("--fit", nargs="+", help="recordings to fit our models to (default: those of the fit)")
    parser.add_argument("--only", nargs="+", choices=[*SIMULATORS, *BY_MOTORS], help="simulators to compare")
    parser.add_argument("--models", type=Path, help="folder of our fitted models, kept and used again")
    parser.add_argument("--json", type=Path, metavar="F", help="write all figures into this file")
    parser.add_argument(
        "--page", type=Path, metavar="F.md", help=f"put the table between two lines {MARK.format('...')} of this page"
    )
    parser.add_argument("--picture", type=Path, metavar="F.svg", help="draw the errors; needs matplotlib")
    args = parser.parse_args()
    kind = RECORDINGS[args.recordings]
    test, fit = args.flights or kind.test, args.fit or kind.fit
    if seen := set(fit) & set(test):
        parser.error(f"{', '.join(sorted(seen))}: a flight of the fit says nothing of the test")
    check_recordings(parser, args.data, (f"{name}{kind.ending}" for name in test))
    flights = [kind.read(args.data / f"{name}{kind.ending}") for name in test]
    entries = {name: entry for name, entry in kind.simulators.items() if name in (args.only or kind.simulators)}
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.models or Path(scratch)
        needed = {entry.model for entry in entries.values() if entry.model}
        models = {model: kind.fit_model(args.data, fit, folder, model) for model in sorted(needed)}
        found = compare(flights, entries, models)
    text = table(found)
    if args.json:
        args.json.write_text(as_json(found, test))
    if args.picture:
        draw(found, args.picture)
    if args.page:
        args.page.write_text(filled(args.page.read_text(), text, args.recordings))
    print(text)


if __name__ == "__main__":
    main()
