"""The benchmark in this process: controllers by name or of one's own, without a server.

from crazyflie_gym.benchmark import robustness, submit

attempt, = submit(Mine, "hover-aruco")
score = attempt["result"]["score"]
print(score["score"], score["low"], score["high"])
for row in robustness(["thesis-pid", Mine], ["fly-80cm"]):
    print(row["controller"], row["condition"], row["score"])
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, TypedDict, cast

from crazyflie_gym import _native
from crazyflie_gym._parts import need
from crazyflie_gym._types import AnyController
from crazyflie_gym.options import to_json

need("bench")

FIRST_SEED = 1_000_000
"""Far from where training begins, so that nobody has seen these flights."""


class RobustnessRow(TypedDict):
    """Result of a controller in a scenario under a condition: score and its 95 % interval; medians of flights."""

    controller: str
    scenario: str
    condition: str
    score: float
    low: float
    high: float
    failed: int
    flights: int
    rmse_m: float | None
    overshoot_m: float | None
    settled: int
    settling_s: float | None


def submit(
    controller: AnyController | Sequence[AnyController],
    scenario: str = "all",
    *,
    collision_avoidance: bool = False,
    data: str | PathLike[str] | None = None,
    **options: Any,
) -> list[dict[str, Any]]:
    """Fly a controller through scenarios of the benchmark, store the attempts, and return them as they were signed.

    Args:
        controller: a name, or one of one's own (see `crazyflie_gym.custom`); a list for several drones, one for each.
        scenario: `name` or `name@version` (see `crazyflie bench scenarios`), or "all".
        collision_avoidance: where drones share the air, keep out of each other's way.
        data: the benchmark's database, made on first use; that of `crazyflie bench` unless given.
        options: the controller's own.

    Raises:
        ValueError: for names, options and files that are wrong.
        RuntimeError: for a database that cannot be used.
        Exception: what a controller of one's own raises; the attempt counts as abandoned.
    """
    flown = _native.submit(
        _each(controller), scenario, options=_json(options), collision_avoidance=collision_avoidance, data=data
    )
    return cast("list[dict[str, Any]]", json.loads(flown))


def robustness(
    controllers: Sequence[AnyController],
    scenarios: Sequence[str] = ("hover-aruco", "fly-80cm"),
    *,
    seeds: int = 48,
    first_seed: int = FIRST_SEED,
    **options: Any,
) -> list[RobustnessRow]:
    """Fly controllers in scenarios as declared, with everything drawn anew, and with an effect unknown to them.

    Args:
        controllers: names, or controllers of one's own.
        scenarios: which, as of `submit`.
        seeds: flights per controller, scenario and condition, at least 20.
        first_seed: the first of them.
        options: of all controllers.

    Raises:
        ValueError: for names, options and files that are wrong.
        Exception: what a controller of one's own raises.
    """
    if not 20 <= seeds <= 10_000:
        raise ValueError(f"seeds is {seeds}, expected 20 to 10000")
    flown = _native.robustness(list(controllers), list(scenarios), seeds, first_seed, options=_json(options))
    return cast("list[RobustnessRow]", json.loads(flown))


def _each(controller: AnyController | Sequence[AnyController]) -> list[AnyController]:
    return list(controller) if isinstance(controller, (list, tuple)) else [cast("AnyController", controller)]


def _json(options: Mapping[str, Any]) -> str:
    return to_json(**options) if options else "null"
