"""Tracks of one's own for the task "track"."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazyflie_gym import _native

Track = str | os.PathLike[str] | ArrayLike | Callable[[float], Sequence[float]]
"""A CSV file, rows of t_s, x_m, y_m, z_m and, if wanted, yaw_rad, or a function of the time in seconds that returns
x_m, y_m, z_m and, if wanted, yaw_rad."""


def track(source: Track, *, seconds: float = 20.0, rate_hz: float = 50.0) -> dict[str, Any]:
    """Return task options that fly a track: `CrazyflieEnv(task="track", task_options=track("my.csv"))`.

    Args:
        source: a CSV file with columns t_s, x_m, y_m, z_m and, if wanted, yaw_rad or yaw_deg; an array (n, 4) or (n, 5)
            of the same; or a function of the time that returns 3 or 4 numbers. It is called here, once for each sample.
        seconds: how long a function is sampled.
        rate_hz: how often a function is sampled. Between samples the track is straight.

    Raises:
        FileNotFoundError, ValueError: for files that cannot be read, with file, line and column.
        ValueError: for arrays and functions of another shape, and for numbers that are not finite.
    """
    if isinstance(source, str | os.PathLike):
        path = Path(source)
        return {"points": _native.track_rows(path.read_text(encoding="utf-8"), str(path))}
    if callable(source):
        if not (0.0 < seconds <= 3600.0 and 0.0 < rate_hz <= 1000.0):
            raise ValueError(f"seconds is {seconds}, rate_hz is {rate_hz}, expected up to 3600 and up to 1000, above 0")
        times = np.arange(int(np.floor(seconds * rate_hz + 1e-9)) + 1) / rate_hz
        source = [[float(t), *(float(value) for value in source(float(t)))] for t in times]
    try:
        rows = np.asarray(source, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"track: {error}") from None
    if rows.ndim != 2 or rows.shape[1] not in (4, 5) or len(rows) == 0:
        raise ValueError(f"track: expected shape (n, 4) or (n, 5), t_s, x_m, y_m, z_m and yaw_rad, got {rows.shape}")
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = bad[0]
        raise ValueError(f"track: row {row}, column {column} is {rows[row, column]}, expected a finite number")
    return {"points": rows.tolist()}
