"""Several vehicles of one deployment: their stages and their places."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence

from crazyflie_gym._types import FloatArray
from crazyflie_gym.deploy.state import Fix, Vector

SPAN_S = 0.095
"""Velocities are means over so long; no multiple of a tick, so that rounding changes no choice."""
GONE_S = 1.0
"""A position that is older is none."""
LATE_S = 0.005
"""News of others counts after so long: within a tick in lock-step the order of threads changes nothing."""


def now_s(speed: float) -> float:
    """Return the time of this machine's clock times `speed`, rounded: differences do not depend on when it began."""
    return round(speed * time.monotonic(), 4)


class Team:
    """Vehicles that fly in one frame, each in a thread of its own.

    Args:
        names: of the vehicles, for reports.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = names
        self._lock = threading.Lock()
        self._ready = [("", 0.0) for _ in names]
        self._places: list[deque[tuple[float, Vector]]] = [deque(maxlen=64) for _ in names]

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.names)

    def is_ready(self, vehicle: int, stage: str) -> bool:
        """Note that a vehicle has reached a stage; return whether all have."""
        time_s = now_s(1.0)
        with self._lock:
            if self._ready[vehicle][0] != stage:
                self._ready[vehicle] = stage, time_s
            return all(reached == stage and time_s - since_s > LATE_S for reached, since_s in self._ready)

    def place(self, vehicle: int, fix: Fix, speed: float) -> None:
        """Note where a vehicle is, on this machine's clock times `speed`."""
        with self._lock:
            self._places[vehicle].append((round(now_s(speed) - fix.silence_s, 4), fix.pos_m))

    def write_neighbours(self, vehicle: int, row: FloatArray, speed: float) -> None:
        """Write what a vehicle knows of the others: relative place and velocity, age, and whether it is valid."""
        time_s = now_s(speed)
        with self._lock:
            own = self._motion(vehicle, time_s, 0.0)
            others = [self._motion(other, time_s, LATE_S) for other in range(len(self)) if other != vehicle]
        for fields, other in zip(row.reshape(-1, 8), others, strict=True):
            fields[:] = 0.0
            if own is not None and other is not None:
                fields[:6] = [there - here for there, here in zip(other[0], own[0], strict=True)]
                fields[6:] = other[1], 1.0

    def _motion(self, vehicle: int, time_s: float, late_s: float) -> tuple[list[float], float] | None:
        """Return place and velocity of a vehicle, and their age, not younger than `late_s`; None where unknown."""
        places = [place for place in self._places[vehicle] if time_s - place[0] >= late_s]
        if not places or time_s - places[-1][0] > GONE_S:
            return None
        end_s, end_m = places[-1]
        begin_s, begin_m = next(place for place in places if end_s - place[0] <= SPAN_S)
        span_s = max(round(end_s - begin_s, 4), 1e-3)
        velocity = [(b - a) / span_s for a, b in zip(begin_m, end_m, strict=True)]
        return [*end_m, *velocity], max(0.0, round(time_s - end_s, 4))
