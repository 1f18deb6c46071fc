"""Observations and actions as Gymnasium spaces, and the two forms of an observation."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
from gymnasium import spaces

from crazyflie_gym._native import neighbour_fields, observation_fields
from crazyflie_gym._types import FieldEntry, FloatArray, Observation

NEIGHBOUR_FIELDS = neighbour_fields()

STATE_FIELDS = {
    "pos_m": slice(0, 3),
    "vel_mps": slice(3, 6),
    "att_rad": slice(6, 9),
    "rate_radps": slice(9, 12),
}
"""The layout of a true state: position and velocity in the room; roll, pitch, yaw and their rates."""

Choice = str | Sequence[str]
"""Content of an observation: "measured", "estimate", "state", or names of `crazyflie_gym.observable_fields()`."""

DEFAULT_OBSERVATION = "state"
"""Default observation of agents: with velocities, so that common learners learn from it."""

_FORMS = ("flat", "dict")


def _box(low: FloatArray, high: FloatArray) -> spaces.Space[FloatArray]:
    return cast("spaces.Space[FloatArray]", spaces.Box(low, high, dtype=np.float32))


def action_space(drones: int | None = None) -> spaces.Space[FloatArray]:
    """Return the space of roll, pitch, yaw rate and height (or PWM), from -1 to 1; rows of it for several drones."""
    shape = (4,) if drones is None else (drones, 4)
    return _box(np.full(shape, -1.0, np.float32), np.full(shape, 1.0, np.float32))


def choice_and_form(observation: Choice | None, form: str) -> tuple[Choice, str]:
    """Return the contents of an observation, and its form. "flat" and "dict" as `observation` were the forms up to 0.1.

    Raises:
        ValueError: unless the form is "flat" or "dict".
    """
    if observation is None:
        observation = DEFAULT_OBSERVATION
    if observation in _FORMS:
        warnings.warn(
            f'observation="{observation}" says the form: write form="{observation}"', DeprecationWarning, stacklevel=4
        )
        return "measured", str(observation)
    if form not in _FORMS:
        raise ValueError(f'form is {form!r}, expected "flat" or "dict"')
    return observation if isinstance(observation, str) else list(observation), form


class RowLayout:
    """The layout of a row of observations.

    A row contains `history` ticks, the newest last. A tick contains the fields of the drone itself and, with several
    drones, those of each of the others.

    Args:
        observation: contents of an observation.
        history: how many ticks.
        drones: how many an environment has; None for a task of one drone.

    Raises:
        ValueError: for names that are unknown, with a proposal.
    """

    def __init__(self, observation: Choice = "measured", history: int = 1, drones: int | None = None) -> None:
        self.fields = observation_fields(observation if isinstance(observation, str) else list(observation))
        self.history, self.drones = history, drones
        self.own = sum(field["length"] for field in self.fields)
        self._slices = {field["name"]: _range(field) for field in self.fields}
        self._near = {"neighbour_" + field["name"]: _range(field) for field in NEIGHBOUR_FIELDS}

    @property
    def width(self) -> int:
        """Numbers in a row."""
        others = 0 if self.drones is None else self.drones - 1
        return self.history * (self.own + others * NEIGHBOUR_WIDTH)

    def split(self, rows: FloatArray) -> dict[str, FloatArray]:
        """Return the fields of a row, or of many, as views: (..., width) to (..., length) each.

        Rows with other drones have them as the fields "neighbour_...": (..., others, length). A history of more
        than one tick is an axis before these.
        """
        if self.history > 1:
            rows = rows.reshape(*rows.shape[:-1], self.history, -1)
        fields = {name: rows[..., at] for name, at in self._slices.items()}
        others = (rows.shape[-1] - self.own) // NEIGHBOUR_WIDTH
        if others:
            near = rows[..., self.own :].reshape(*rows.shape[:-1], others, NEIGHBOUR_WIDTH)
            fields |= {name: near[..., at] for name, at in self._near.items()}
        return fields

    def space(self, form: str) -> spaces.Space[Observation]:
        """Return the space of observations: "flat" is a Box of rows, "dict" a Dict by field.

        For one drone a row is (width,), for several they are (drones, width), float32.
        """
        return self._space(form, [] if self.drones is None else [self.drones])

    def drone_space(self, form: str) -> spaces.Space[Observation]:
        """Return the space of one of several drones' observations."""
        return self._space(form, [])

    def _space(self, form: str, rows: list[int]) -> spaces.Space[Observation]:
        low, high = (np.tile(self._bound(side), (*rows, 1) if rows else 1) for side in ("low", "high"))
        if form == "flat":
            return cast("spaces.Space[Observation]", _box(low, high))
        lows, highs = self.split(low), self.split(high)
        return cast("spaces.Space[Observation]", spaces.Dict({name: _box(lows[name], highs[name]) for name in lows}))

    def _bound(self, side: str) -> FloatArray:
        """Return the least or the greatest numbers of a row."""
        others = 0 if self.drones is None else self.drones - 1
        tick = np.concatenate([_bounds(self.fields, side), *[_bounds(NEIGHBOUR_FIELDS, side)] * others])
        return np.tile(tick, self.history)


def _range(field: FieldEntry) -> slice:
    return slice(field["first"], field["first"] + field["length"])


def _bounds(fields: list[FieldEntry], side: str) -> FloatArray:
    bound = {"low": [field["low"] for field in fields], "high": [field["high"] for field in fields]}[side]
    return np.repeat(np.array(bound, np.float32), [field["length"] for field in fields])


NEIGHBOUR_WIDTH = sum(field["length"] for field in NEIGHBOUR_FIELDS)
MEASURED = RowLayout()
"""Measurements of the rig in one tick."""


def split(rows: FloatArray) -> dict[str, FloatArray]:
    """Return the fields of measured rows; see `RowLayout.split`."""
    return MEASURED.split(rows)


def flatten(observation: Mapping[str, FloatArray]) -> FloatArray:
    """Return the row of an observation by fields, or the rows of many, for controllers: the inverse of `split`."""
    own = np.concatenate([observation[field["name"]] for field in MEASURED.fields], axis=-1)
    others = ["neighbour_" + field["name"] for field in NEIGHBOUR_FIELDS]
    if any(name not in observation for name in others):
        return own
    near = np.concatenate([observation[name] for name in others], axis=-1)
    return np.concatenate([own, near.reshape(*own.shape[:-1], -1)], axis=-1)
