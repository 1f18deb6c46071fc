"""Several steps of a batch at once: their results, and the arrays of these."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from crazyflie_gym._native import Controller, Crowd, Sim
from crazyflie_gym._types import BoolArray, FloatArray, Observation
from crazyflie_gym.notebook import table

KEPT = ("rewards", "terminated", "truncated")
"""Values that a rollout keeps of every step by default; it can also keep "observations"."""


@dataclass
class Rollout:
    """Results of K steps of N environments; for a task with several drones, (N,) is (N, drones).

    Attributes:
        returns: float32 (N,), the sum of the rewards until the first flight ends.
        rewards: float32 (K, N), or None where they were not kept.
        terminated: bool (K, N), or None.
        truncated: bool (K, N), or None.
        observations: float32 (K, N, width), or None.
        last_observation: what was observed in the last step, as `step` returns it.
        last_actions: float32 (N, 4), the last actions where a controller flew, else None.
    """

    returns: FloatArray
    rewards: FloatArray | None = None
    terminated: BoolArray | None = None
    truncated: BoolArray | None = None
    observations: FloatArray | None = None
    last_observation: Observation | None = None
    last_actions: FloatArray | None = None

    def _repr_html_(self) -> str:
        """Return what a notebook shows: steps, and the spread of the returns."""
        quartiles = np.quantile(self.returns, [0.0, 0.25, 0.5, 0.75, 1.0])
        steps = "" if self.rewards is None else f"{len(self.rewards)} steps of "
        header = ["", "least", "25 %", "median", "75 %", "greatest"]
        rows = [["returns", *(f"{value:.4g}" for value in quartiles)]]
        if self.terminated is not None:
            rows.append(["flights that ended early", f"{int(self.terminated.any(axis=0).sum())}", "", "", "", ""])
        return table(f"Rollout: {steps}{self.returns.size} flights", header, rows)


def make_rollout(sim: Sim, steps: int, lead: tuple[int, ...], keep: Collection[str]) -> Rollout:
    """Return room for a rollout.

    Raises:
        ValueError: for a name in `keep` that is none of what can be kept.
    """
    known = (*KEPT, "observations")
    unknown = [name for name in keep if name not in known]
    if unknown:
        raise ValueError(f"keep: {unknown[0]!r} is unknown, expected some of {', '.join(known)}")
    shape = (steps, *lead)
    return Rollout(
        np.empty(lead, np.float32),
        np.empty(shape, np.float32) if "rewards" in keep else None,
        np.empty(shape, np.bool_) if "terminated" in keep else None,
        np.empty(shape, np.bool_) if "truncated" in keep else None,
        np.empty((*shape, sim.width), np.float32) if "observations" in keep else None,
    )


def fly_rollout(
    sim: Sim, pilot: FloatArray | Controller | Crowd, steps: int, rows: FloatArray, out: Rollout
) -> FloatArray | None:
    """Fly `steps` steps from `rows`, the last observations, which become those of the new last step.

    Returns the last actions of a controller.
    """
    kept = (out.rewards, out.terminated, out.truncated, out.observations)
    if isinstance(pilot, np.ndarray):
        sim.rollout_into(pilot, rows, out.returns, *kept)
        return None
    return sim.fly_into(pilot, steps, rows, out.returns, *kept)
