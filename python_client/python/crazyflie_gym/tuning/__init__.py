"""Gains of a controller, tuned over many flights, here or on a Ray cluster.

    python -m crazyflie_gym.tuning thesis-pid --out gains.json

The CMA-ES of `crazyflie tune` proposes gains, flights evaluate them. The candidates of a generation are work for
`crazyflie_gym.sweep`, so an interrupted tuning resumes, and a cluster finds the same gains as one process. The result
is judged on seeds that the search has not seen. Needs the extra `ray`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from crazyflie_gym._native import GainSearch, controllers
from crazyflie_gym._types import AnyController
from crazyflie_gym.custom import label
from crazyflie_gym.evaluation import Flight, Scenario, Work, file_of, fly
from crazyflie_gym.sweep import Store, run, split

UNSEEN = 10**9
"""The first seed that is judged on; the search flies those from 0 on."""
FIGURES = {"reward": -1, "rmse_m": 1}
"""Figures that a search can improve, with the sign that makes each a cost."""
STEP = 0.35
"""Spread of the first candidates about the start: standard deviation of the logarithm of a gain."""


@dataclass(frozen=True)
class Search:
    """Controller, scenario and length of a search. The same search finds the same gains.

    Args:
        scenario: what is flown.
        controller: `NAME` or `NAME:FILE`, as `crazyflie_gym.controllers()` lists it, `python:FILE.py:NAME`, or a class
            of one's own (see `crazyflie_gym.custom`), whose options are the start of the search.
        names: gains by their place in the options ("position_m", "x.kp"), or groups of them ("x"); all unless given.
        options: where the search starts, instead of the controller's defaults or what is in its file.
        figure: one of `FIGURES`, whose mean over the flights counts. A failed flight costs 1 more: all its reward, or a
            metre of error.
        seeds: flights of each candidate.
        judged_on: flights on unseen seeds, of the start and of what was found.
        generations: of CMA-ES, fewer if it converges.
        population: candidates of a generation.
        seed: of CMA-ES.
    """

    scenario: Scenario = field(default_factory=Scenario)
    controller: AnyController = "thesis-pid"
    names: Sequence[str] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    figure: str = "reward"
    seeds: int = 64
    judged_on: int = 256
    generations: int = 24
    population: int = 12
    seed: int = 0


@dataclass(frozen=True)
class Tuned:
    """Result of a tuning.

    Args:
        options: of the controller: `env.controller(name, **options)` flies them.
        gains: each tuned gain before and after.
        costs: the least so far, after the start and after each generation, on the seeds of the search.
        before: flights of the start on unseen seeds.
        after: flights of what was found, on the same.
    """

    options: dict[str, Any]
    gains: dict[str, tuple[float, float]]
    costs: list[float]
    before: list[Flight]
    after: list[Flight]


def tune(search: Search, store: Store, ray_address: str | None = None, progress: bool = True) -> Tuned:
    """Search, and judge what was found.

    Args:
        search: what is tuned.
        store: place of flights, each added as it finishes.
        ray_address: as of `crazyflie_gym.sweep.run`.
        progress: whether to show bars.

    Raises:
        ValueError: for what `crazyflie_gym.evaluation.fly` refuses, and for gains that the controller has not.
    """
    start = _check_search(search)
    before = _gains(search, start)
    optimiser = GainSearch(list(before.values()), STEP, search.population, search.seed)
    best, costs = start, _costs(search, [start], store, ray_address, progress)
    bar = tqdm(range(search.generations), desc=_label(search), unit="generation", disable=not progress or None)
    for _ in bar:
        asked = optimiser.ask()
        if asked is None:
            break
        tried = [replaced(start, dict(zip(before, _plain(gains), strict=True))) for gains in asked]
        answers = _costs(search, tried, store, ray_address, progress)
        optimiser.tell(answers)
        if min(answers) < costs[-1]:
            best = tried[answers.index(min(answers))]
        costs.append(min(costs[-1], *answers))
        bar.set_postfix_str(f"cost {costs[0]:.4f} to {costs[-1]:.4f}")
    before_and_after = [work for options in (start, best) for work in _works(search, options, search.judged_on, UNSEEN)]
    flown = run(before_and_after, store, ray_address, progress)
    after = numbers(best)
    gains = {name: (value, after[name]) for name, value in before.items()}
    return Tuned(best, gains, costs, flown[: search.judged_on], flown[search.judged_on :])


def _check_search(search: Search) -> dict[str, Any]:
    """Return the options that the search starts from."""
    for name in ("seeds", "judged_on", "generations", "population"):
        if not 2 <= getattr(search, name) <= UNSEEN:
            raise ValueError(f"{name} is {getattr(search, name)}, expected 2 to {UNSEEN}")
    if search.figure not in FIGURES:
        raise ValueError(f"unknown figure {search.figure!r}, expected one of {', '.join(FIGURES)}")
    # one tick is enough for all that is wrong with a scenario, a controller or its options to be said
    fly(Work.of(replace(search.scenario, ticks=1), search.controller, 0, 1, **search.options))
    return merged(_defaults(search.controller), search.options)


def _defaults(controller: AnyController) -> dict[str, Any]:
    """Return a controller's options as they are unless given."""
    if not isinstance(controller, str):
        return {}
    name = controller.partition(":")[0].rpartition("+")[2]
    start: dict[str, Any] = json.loads(next(e for e in controllers() if name in (e["name"], e["also"]))["defaults"])
    path = file_of(controller)
    return merged(start, json.loads(Path(path).read_bytes())) if start and path else start


def merged(base: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with what is given in its place, group by group, as controllers merge their options."""
    result = dict(base)
    for name, value in given.items():
        old = result.get(name)
        result[name] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def _gains(search: Search, start: Mapping[str, Any]) -> dict[str, float]:
    every = numbers(start)
    for name in search.names:
        if not any(_within(gain, name) for gain in every):
            there = ", ".join(every) or "none"
            raise ValueError(f"{_label(search)} has no gain {name!r} that is not 0; those that it has: {there}")
    chosen = {g: v for g, v in every.items() if not search.names or any(_within(g, name) for name in search.names)}
    if not chosen:
        raise ValueError(f"{_label(search)} has no gains to tune")
    return chosen


def _label(search: Search) -> str:
    return search.controller if isinstance(search.controller, str) else label(search.controller)


def _within(gain: str, name: str) -> bool:
    return f"{gain}.".startswith(f"{name}.")


def numbers(options: Mapping[str, Any], above: str = "") -> dict[str, float]:
    """Return the numbers among options that are not 0, by their place; limits, which are lists, are not among them."""
    found: dict[str, float] = {}
    for name, value in options.items():
        if isinstance(value, Mapping):
            found |= numbers(value, f"{above}{name}.")
        elif isinstance(value, (int, float)) and value != 0:
            found[above + name] = float(value)
    return found


def replaced(options: Mapping[str, Any], new: Mapping[str, float], above: str = "") -> dict[str, Any]:
    """Return options with other numbers, which are given by their place."""
    return {
        name: replaced(value, new, f"{above}{name}.") if isinstance(value, Mapping) else new.get(above + name, value)
        for name, value in options.items()
    }


def _plain(values: Sequence[float]) -> list[float]:
    # four digits are more than flights can tell apart; the last bits of another machine's exp are not among them
    return [float(f"{value:.4g}") for value in values]


def _works(search: Search, options: Mapping[str, Any], seeds: int, first_seed: int = 0) -> list[Work]:
    return split(search.scenario, search.controller, seeds, first_seed, **options)


def _costs(
    search: Search, tried: Sequence[Mapping[str, Any]], store: Store, ray_address: str | None, progress: bool
) -> list[float]:
    works = [work for options in tried for work in _works(search, options, search.seeds)]
    flights = iter(run(works, store, ray_address, progress))
    return [cost(list(islice(flights, search.seeds)), search.figure) for _ in tried]


def cost(flights: Sequence[Flight], figure: str) -> float:
    """Return what flights cost: the mean of a figure with its sign, and 1 for each flight that failed."""
    plain: Any = flights
    return float(np.mean([FIGURES[figure] * flight[figure] + flight["failed"] for flight in plain]))
