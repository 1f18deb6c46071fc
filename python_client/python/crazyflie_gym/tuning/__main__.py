"""The command `python -m crazyflie_gym.tuning`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crazyflie_gym._native import tasks
from crazyflie_gym.evaluation import Flight, Scenario, median
from crazyflie_gym.sweep import Store
from crazyflie_gym.training import LAB
from crazyflie_gym.tuning import FIGURES, UNSEEN, Search, Tuned, cost, tune

MEDIANS = ("reward", "rmse_m", "yaw_rmse_deg", "travel_degps")
EXAMPLES = """\
examples:
  python -m crazyflie_gym.tuning thesis-pid --out gains.json --picture tuned.png
  crazyflie fly --task fly-80cm --sensors lab --controller pid:gains.json
  python -m crazyflie_gym.tuning pid:gains.json --gains x y --figure rmse_m
  python -m crazyflie_gym.tuning lqr --id CrazyflieTrack-v0 --gains position_m velocity_mps tilt_deg --json
  python -m crazyflie_gym.tuning thesis-pid --seeds 2048 --ray auto --store tuning.sqlite
"""


def _summary(flights: Sequence[Flight]) -> dict[str, float]:
    """Return the medians over all flights, and how many failed."""
    medians = {figure: median(flights, figure) for figure in MEDIANS}
    return medians | {"failed": sum(flight["failed"] for flight in flights)}


def _report(search: Search, tuned: Tuned) -> dict[str, Any]:
    pairs: Any = zip(tuned.before, tuned.after, strict=True)
    return {
        "controller": str(search.controller),
        "figure": search.figure,
        "gains": {name: {"before": old, "after": new} for name, (old, new) in tuned.gains.items()},
        "options": tuned.options,
        "costs": tuned.costs,
        "candidates": search.population * (len(tuned.costs) - 1),
        "judged_on": {"first_seed": UNSEEN, "seeds": len(tuned.before)},
        "before": _summary(tuned.before),
        "after": _summary(tuned.after),
        "better": sum(cost([new], search.figure) < cost([old], search.figure) for old, new in pairs),
    }


def _print(report: dict[str, Any], seeds: int) -> None:
    judged = report["judged_on"]["seeds"]
    print(f"{report['controller']}: {report['candidates']} candidates on {seeds} seeds, judged on {judged} others\n")
    width = max(map(len, (*report["gains"], *MEDIANS))) + 2
    print(f"{'gain':{width}}{'before':>12}{'after':>12}")
    for name, gain in report["gains"].items():
        print(f"{name:{width}}{gain['before']:12.4g}{gain['after']:12.4g}")
    print(f"\n{'figure':{width}}{'before':>12}{'after':>12}   medians over the flights")
    for figure in MEDIANS:
        print(f"{figure:{width}}{report['before'][figure]:12.4g}{report['after'][figure]:12.4g}")
    print(f"{'failed':{width}}{report['before']['failed']:12}{report['after']['failed']:12}   of {judged}")
    print(f"\n{report['figure']} is better in {report['better']} of {judged} flights")


def _draw(tuned: Tuned, figure: str, path: str) -> None:
    """Draw the search, and the flights before and after. Needs matplotlib."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(10, 4), layout="constrained")
    left, right = drawn.subplots(1, 2)
    left.step(range(len(tuned.costs)), tuned.costs, where="post")
    left.set(xlabel="generation", ylabel="least cost on the seeds of the search")
    for name, flights in (("before", tuned.before), ("after", tuned.after)):
        right.ecdf(np.array([flight[figure] for flight in flights]), label=name)  # type: ignore[literal-required]
    right.set(xlabel=figure, ylabel="share of unseen flights with at most so much", ylim=(0, 1))
    right.grid(alpha=0.3)
    right.legend()
    drawn.savefig(path, dpi=100)


def _object(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f"{text}: expected a JSON object")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m crazyflie_gym.tuning",
        description="Tune the gains of a controller over many flights, and judge them on seeds that were not tuned on.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add, start, flown = parser.add_argument, Search(), Scenario()
    add("controller", metavar="NAME", help="NAME, NAME:FILE or python:FILE:NAME, see `crazyflie controllers`")
    add("--options", type=_object, default={}, metavar="JSON", help="where the search starts, else the defaults")
    add("--gains", nargs="+", default=[], metavar="GAIN", help="x.kp, or all of a group: x (default: all)")
    add("--figure", choices=FIGURES, default=start.figure, help="what counts (default: %(default)s)")
    single = [task["id"] for task in tasks() if task["drones"] == 1]
    add("--id", choices=single, default=flown.id, help="the task (default: %(default)s)")
    add("--task-options", type=_object, default={}, metavar="JSON")
    add("--effects", type=_object, default=LAB, metavar="JSON", help="(default: the lab's camera and the ground)")
    add("--vertical", default=flown.vertical, help="height, pwm or thrust (default: %(default)s)")
    add("--ticks", type=int, default=flown.ticks, metavar="N", help="of a flight (default: %(default)s)")
    add("--seeds", type=int, default=start.seeds, metavar="N", help="flights of a candidate (default: %(default)s)")
    add("--judged-on", type=int, default=start.judged_on, metavar="N", help="unseen seeds (default: %(default)s)")
    add("--generations", type=int, default=start.generations, metavar="N", help="(default: %(default)s)")
    add(
        "--population",
        type=int,
        default=start.population,
        metavar="N",
        help="of a generation (default: %(default)s)",
    )
    add("--seed", type=int, default=start.seed, metavar="N", help="of the search (default: %(default)s)")
    add(
        "--store",
        default="tuning.sqlite",
        metavar="FILE",
        help="keeps flights: none is flown twice (default: %(default)s)",
    )
    add("--ray", metavar="ADDRESS", help="of a Ray cluster: auto, or local for one of this machine (default: no Ray)")
    add("--out", metavar="FILE", help="write the options as JSON: all of a PID's are what pid:FILE reads")
    add("--picture", metavar="FILE", help="draw the search and the flights before and after; needs matplotlib")
    add("--json", action="store_true", help="for machines")
    return parser


def main() -> None:
    """Tune, and print the gain."""
    parser = _parser()
    args = parser.parse_args()
    scenario = Scenario(args.id, args.ticks, args.vertical, args.effects, args.task_options)
    search = Search(
        scenario, args.controller, args.gains, args.options, args.figure, args.seeds, args.judged_on, args.generations,
        args.population, args.seed,
    )  # fmt: skip
    try:
        with Store(args.store) as store:
            tuned = tune(search, store, args.ray, progress=not args.json)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    if args.out:
        Path(args.out).write_text(json.dumps(tuned.options, indent=2) + "\n")
    if args.picture:
        _draw(tuned, args.figure, args.picture)
    report = _report(search, tuned)
    if args.json:
        print(json.dumps(report))
    else:
        _print(report, search.seeds)


if __name__ == "__main__":
    main()
