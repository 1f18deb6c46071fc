"""Thousands of flights, here or on the machines of a Ray cluster; every result is in the store once.

    from crazyflie_gym.evaluation import Scenario
    from crazyflie_gym.sweep import Store, run, split

    works = split(Scenario("Crazyflie-v0"), "thesis-pid", seeds=10_000)
    with Store("results.sqlite") as store:
        flights = run(works, store, ray_address="auto")  # or without: in this process

A run that was cut short goes on where it was: what is in the store is not flown again. Needs the extra `ray`, also for
its progress bar.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

from tqdm import tqdm

from crazyflie_gym._types import AnyController
from crazyflie_gym.evaluation import Flight, Scenario, Work, fly

W = TypeVar("W", bound="KeyedWork")
R = TypeVar("R")

BATCH = 256
"""Seeds per unit of work."""


class Store:
    """Results by the key of their work, in an SQLite file."""

    def __init__(self, path: str | Path) -> None:
        self._db = sqlite3.connect(path)
        self._db.execute("CREATE TABLE IF NOT EXISTS result (key TEXT PRIMARY KEY, flights TEXT NOT NULL) STRICT")

    def __enter__(self) -> Store:
        """Return the store, which is closed in the end."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._db.close()

    def __len__(self) -> int:
        """Return the number of results."""
        return int(self._db.execute("SELECT count(*) FROM result").fetchone()[0])

    def get(self, key: str) -> list[Any] | None:
        """Return a result, or None."""
        row = self._db.execute("SELECT flights FROM result WHERE key = ?", (key,)).fetchone()
        return None if row is None else cast("list[Any]", json.loads(row[0]))

    def add(self, key: str, flights: Sequence[Any]) -> bool:
        """Keep a result, and return whether it is new.

        Raises:
            RuntimeError: if another result of the same work is there: the work was not a pure function.
        """
        text = json.dumps(flights)
        with self._db:
            done = self._db.execute("INSERT INTO result VALUES (?, ?) ON CONFLICT DO NOTHING", (key, text))
        if done.rowcount == 1:
            return True
        if self._db.execute("SELECT flights FROM result WHERE key = ?", (key,)).fetchone()[0] != text:
            raise RuntimeError(f"work {key} gave two results: two simulators of one build disagree")
        return False


def split(scenario: Scenario, controller: AnyController, seeds: int, first_seed: int = 0, **options: Any) -> list[Work]:
    """Return the work of `seeds` flights in units of `BATCH`."""
    starts = range(first_seed, first_seed + seeds, BATCH)
    end = first_seed + seeds
    return [Work.of(scenario, controller, start, min(BATCH, end - start), **options) for start in starts]


def run(works: Sequence[Work], store: Store, ray_address: str | None = None, progress: bool = True) -> list[Flight]:
    """Do what is not in the store yet, and return the flights of all works in their order.

    Args:
        works: what to do; the same twice is done once.
        store: place of results, each added as it finishes.
        ray_address: of a Ray cluster ("auto", or "local" for one of this machine alone), or None for this process. Work
            of a machine that dies is done by another.
        progress: whether to show a bar, on a terminal.
    """
    return do_works(works, fly, store, ray_address, progress)


class KeyedWork(Protocol):
    """Work whose result depends on nothing but itself."""

    def key(self) -> str:
        """Return a name that no other work has."""


def do_works(
    works: Sequence[W], do: Callable[[W], list[R]], store: Store, ray_address: str | None, progress: bool
) -> list[R]:
    """Do what is not in the store yet by a pure function `do`, and return the results of all works in their order.

    `run` is this for flights.
    """
    keys = [work.key() for work in works]
    missing = {key: work for key, work in zip(keys, works, strict=True) if store.get(key) is None}
    results = _here(missing, do) if ray_address is None else _on_ray(missing, do, ray_address)
    # a bar below another's goes when it is done
    for key, found in tqdm(results, total=len(missing), unit="batch", leave=None, disable=not progress or None):
        store.add(key, found)
    return [result for key in keys for result in store.get(key) or []]


def _here(works: dict[str, W], do: Callable[[W], list[R]]) -> Iterator[tuple[str, list[R]]]:
    for key, work in works.items():
        yield key, do(work)


@cache
def _remote(do: Callable[[Any], list[Any]]) -> Any:
    import ray

    # without end: what fails is the machine, not the work, whose own mistakes are raised by `ray.get`
    return ray.remote(num_cpus=1, max_retries=-1)(do)


def _on_ray(works: dict[str, W], do: Callable[[W], list[R]], address: str) -> Iterator[tuple[str, list[R]]]:
    import ray

    if not ray.is_initialized():
        ray.init(address=address)
    remote = _remote(do)
    waiting = list(works.items())[::-1]
    # enough for no machine to wait, and few enough for a sweep of any size
    cpus = ray.cluster_resources().get("CPU", 1)  # type: ignore[no-untyped-call, unused-ignore]
    most = 4 * max(1, int(cpus))
    under_way: dict[Any, str] = {}
    while waiting or under_way:
        while waiting and len(under_way) < most:
            key, work = waiting.pop()
            under_way[remote.remote(work)] = key
        done, _ = ray.wait(list(under_way))
        for result in done:
            yield under_way.pop(result), ray.get(result)
