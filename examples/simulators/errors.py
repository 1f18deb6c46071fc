"""Errors of predictions, and differences of simulators over the same flights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from real_flights import ATT, POS, RATE, VEL, rotation

HORIZONS_S = (0.1, 0.5, 2.0)
QUANTITIES = {"position": "m", "velocity": "m/s", "attitude": "deg", "body rate": "deg/s"}
# two-sided 95 % quantiles of Student's t for 1 to 30 degrees of freedom
T_95 = """12.706 4.303 3.182 2.776 2.571 2.447 2.365 2.306 2.262 2.228 2.201 2.179 2.160 2.145 2.131 2.120 2.110 2.101
2.093 2.086 2.080 2.074 2.069 2.064 2.060 2.056 2.052 2.048 2.045 2.042"""


class Difference(NamedTuple):
    """Mean over flights of one error less another, with its 95 % interval; NaN where there is a single flight."""

    mean: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """Return "worse" or "better" where the interval excludes zero, else ""."""
        return "worse" if self.low > 0.0 else "better" if self.high < 0.0 else ""


def distances(predicted: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return how far states (..., 12) are from measured ones: (..., 4), as QUANTITIES, in its units.

    Position, velocity and body rates by the length of the difference, attitudes by the angle of the turn between them.
    """
    length = [np.linalg.norm(predicted[..., part] - measured[..., part], axis=-1) for part in (POS, VEL, RATE)]
    turn = np.swapaxes(rotation(measured[..., ATT]), -1, -2) @ rotation(predicted[..., ATT])
    # a turn by an angle differs from none by 2 sqrt(2) sin(angle / 2), which is exact for small angles too
    chord = np.linalg.norm(turn - np.eye(3), axis=(-2, -1)) / (2.0 * np.sqrt(2.0))
    angle = 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))
    return np.stack([length[0], length[1], np.degrees(angle), np.degrees(length[2])], -1)


def flight_errors(predicted: np.ndarray, measured: np.ndarray, dt_s: float) -> np.ndarray:
    """Return root mean squares over windows of states (W, K + 1, 12): (4, 3), by quantity and horizon.

    Raises:
        ValueError: for another shape than that of the measurement, and for predictions that are no numbers.
    """
    if predicted.shape != measured.shape:
        raise ValueError(f"predicted: expected shape {measured.shape}, got {predicted.shape}")
    if not np.isfinite(predicted).all():
        raise ValueError("predicted: expected finite numbers")
    rows = [round(horizon_s / dt_s) for horizon_s in HORIZONS_S]
    return np.sqrt((distances(predicted[:, rows], measured[:, rows]) ** 2).mean(0)).T


def difference(theirs: np.ndarray, ours: np.ndarray) -> Difference:
    """Return the paired difference of errors (flights,), positive where theirs is larger.

    Raises:
        ValueError: for more flights than quantiles are known for, or not the same number of both.
    """
    quantiles = [float(text) for text in T_95.split()]
    if theirs.shape != ours.shape or not 0 < len(ours) <= len(quantiles) + 1:
        raise ValueError(
            f"expected errors of the same 1 to {len(quantiles) + 1} flights, got {theirs.shape} and {ours.shape}"
        )
    gaps = theirs - ours
    if len(gaps) == 1:
        return Difference(float(gaps[0]), np.nan, np.nan)
    half = quantiles[len(gaps) - 2] * gaps.std(ddof=1) / np.sqrt(len(gaps))
    return Difference(float(gaps.mean()), float(gaps.mean() - half), float(gaps.mean() + half))
