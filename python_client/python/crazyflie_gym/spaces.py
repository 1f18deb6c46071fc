"""Observations and actions as Gymnasium spaces, and the two forms of an observation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
from gymnasium import spaces

from crazyflie_gym._native import observation_fields
from crazyflie_gym._types import FloatArray, Observation

FIELDS = observation_fields()
WIDTH = sum(field["length"] for field in FIELDS)
_SLICES = {field["name"]: slice(field["first"], field["first"] + field["length"]) for field in FIELDS}

STATE_FIELDS = {
    "pos_m": slice(0, 3),
    "vel_mps": slice(3, 6),
    "att_rad": slice(6, 9),
    "rate_radps": slice(9, 12),
}
"""The layout of a true state: position and velocity in the room; roll, pitch, yaw and their rates."""


def _box(low: FloatArray, high: FloatArray) -> spaces.Space[FloatArray]:
    return cast("spaces.Space[FloatArray]", spaces.Box(low, high, dtype=np.float32))


def action_space() -> spaces.Space[FloatArray]:
    """Return the space of roll, pitch, yaw rate and height (or PWM), each from -1 to 1."""
    return _box(np.full(4, -1.0, np.float32), np.full(4, 1.0, np.float32))


def observation_space(form: str) -> spaces.Space[Observation]:
    """Return the space of observations: "flat" is a Box of 24 numbers, "dict" a Dict by field.

    Raises:
        ValueError: for another form.
    """
    boxes: dict[str, spaces.Space[FloatArray]] = {}
    lows, highs = [], []
    for field in FIELDS:
        low = np.full(field["length"], field["low"], np.float32)
        high = np.full(field["length"], field["high"], np.float32)
        boxes[field["name"]] = _box(low, high)
        lows.append(low)
        highs.append(high)
    if form == "dict":
        return cast("spaces.Space[Observation]", spaces.Dict(boxes))
    if form == "flat":
        return cast("spaces.Space[Observation]", _box(np.concatenate(lows), np.concatenate(highs)))
    raise ValueError(f'observation is {form!r}, expected "flat" or "dict"')


def split(rows: FloatArray) -> dict[str, FloatArray]:
    """Return the fields of an observation row, or of many, as views: (..., 24) to (..., length) each."""
    return {name: rows[..., at] for name, at in _SLICES.items()}


def flatten(observation: Mapping[str, FloatArray]) -> FloatArray:
    """Return the row of an observation by fields, or the rows of many, as the PID reads it: the inverse of `split`."""
    return np.concatenate([observation[name] for name in _SLICES], axis=-1)
