"""Observations and actions as Gymnasium spaces, and the two forms of an observation."""

from __future__ import annotations

from collections.abc import Mapping

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


def action_space() -> spaces.Box:
    """Return the space of roll, pitch, yaw rate and height (or PWM), each from -1 to 1."""
    return spaces.Box(-1.0, 1.0, (4,), np.float32)


def observation_space(form: str) -> spaces.Space[Observation]:
    """Return the space of observations: "flat" is a Box of 24 numbers, "dict" a Dict by field.

    Raises:
        ValueError: for another form.
    """
    boxes = {}
    for field in FIELDS:
        boxes[field["name"]] = spaces.Box(
            np.float32(field["low"]), np.float32(field["high"]), (field["length"],), np.float32
        )
    if form == "dict":
        return spaces.Dict(boxes)  # type: ignore[return-value]
    if form == "flat":
        low = np.concatenate([box.low for box in boxes.values()])
        high = np.concatenate([box.high for box in boxes.values()])
        return spaces.Box(low, high, dtype=np.float32)  # type: ignore[return-value]
    raise ValueError(f'observation is {form!r}, expected "flat" or "dict"')


def split(rows: FloatArray) -> dict[str, FloatArray]:
    """Return the fields of an observation row, or of many, as views: (..., 24) to (..., length) each."""
    return {name: rows[..., at] for name, at in _SLICES.items()}


def flatten(observation: Mapping[str, FloatArray]) -> FloatArray:
    """Return the row of an observation by fields, or the rows of many, as the PID reads it: the inverse of `split`."""
    return np.concatenate([observation[name] for name in _SLICES], axis=-1)
