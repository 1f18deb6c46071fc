"""Observations and actions as Gymnasium spaces, and the two forms of an observation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
from gymnasium import spaces

from crazyflie_gym._native import neighbour_fields, observation_fields
from crazyflie_gym._types import FieldEntry, FloatArray, Observation

FIELDS = observation_fields()
WIDTH = sum(field["length"] for field in FIELDS)
NEIGHBOUR_FIELDS = neighbour_fields()
NEIGHBOUR_WIDTH = sum(field["length"] for field in NEIGHBOUR_FIELDS)


def _slices(fields: list[FieldEntry], prefix: str = "") -> dict[str, slice]:
    return {prefix + field["name"]: slice(field["first"], field["first"] + field["length"]) for field in fields}


_SLICES = _slices(FIELDS)
_NEIGHBOUR_SLICES = _slices(NEIGHBOUR_FIELDS, "neighbour_")

STATE_FIELDS = {
    "pos_m": slice(0, 3),
    "vel_mps": slice(3, 6),
    "att_rad": slice(6, 9),
    "rate_radps": slice(9, 12),
}
"""The layout of a true state: position and velocity in the room; roll, pitch, yaw and their rates."""


def _box(low: FloatArray, high: FloatArray) -> spaces.Space[FloatArray]:
    return cast("spaces.Space[FloatArray]", spaces.Box(low, high, dtype=np.float32))


def action_space(drones: int | None = None) -> spaces.Space[FloatArray]:
    """Return the space of roll, pitch, yaw rate and height (or PWM), from -1 to 1; rows of it for several drones."""
    shape = (4,) if drones is None else (drones, 4)
    return _box(np.full(shape, -1.0, np.float32), np.full(shape, 1.0, np.float32))


def check_form(form: str) -> str:
    """Return the form of observations.

    Raises:
        ValueError: unless it is "flat" or "dict".
    """
    if form not in ("flat", "dict"):
        raise ValueError(f'observation is {form!r}, expected "flat" or "dict"')
    return form


def _bounds(fields: list[FieldEntry]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest numbers of a row of these fields."""
    low = [np.full(field["length"], field["low"], np.float32) for field in fields]
    high = [np.full(field["length"], field["high"], np.float32) for field in fields]
    return np.concatenate(low), np.concatenate(high)


def observation_space(form: str, drones: int | None = None) -> spaces.Space[Observation]:
    """Return the space of observations: "flat" is a Box of rows, "dict" a Dict by field.

    For one drone (None) rows are 24 numbers. For several, each drone has such a row, and 8 numbers more for each of the
    others: float32 (drones, width).

    Raises:
        ValueError: for another form.
    """
    low, high = _bounds(FIELDS)
    if drones is not None:
        near = _bounds(NEIGHBOUR_FIELDS)
        low, high = (
            np.concatenate([own, *[other] * (drones - 1)]) for own, other in zip((low, high), near, strict=True)
        )
        low, high = (np.tile(row, (drones, 1)) for row in (low, high))
    if check_form(form) == "flat":
        return cast("spaces.Space[Observation]", _box(low, high))
    lows, highs = split(low), split(high)
    return cast("spaces.Space[Observation]", spaces.Dict({name: _box(lows[name], highs[name]) for name in lows}))


def split(rows: FloatArray) -> dict[str, FloatArray]:
    """Return the fields of an observation row, or of many, as views: (..., width) to (..., length) each.

    Where rows hold other drones, these are the fields "neighbour_...": (..., others, length).
    """
    fields = {name: rows[..., at] for name, at in _SLICES.items()}
    others = (rows.shape[-1] - WIDTH) // NEIGHBOUR_WIDTH
    if others:
        near = rows[..., WIDTH:].reshape(*rows.shape[:-1], others, NEIGHBOUR_WIDTH)
        fields |= {name: near[..., at] for name, at in _NEIGHBOUR_SLICES.items()}
    return fields


def flatten(observation: Mapping[str, FloatArray]) -> FloatArray:
    """Return the row of an observation by fields, or the rows of many, for controllers: the inverse of `split`."""
    own = np.concatenate([observation[name] for name in _SLICES], axis=-1)
    if any(name not in observation for name in _NEIGHBOUR_SLICES):
        return own
    near = np.concatenate([observation[name] for name in _NEIGHBOUR_SLICES], axis=-1)
    return np.concatenate([own, near.reshape(*own.shape[:-1], -1)], axis=-1)
