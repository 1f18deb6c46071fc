"""Controllers of one's own, which the simulator calls like its own.

A controller is an object with `act(rows) -> actions`: rows are float32 (n, 24), laid out as `observation_fields()`
says, actions (n, 4) from -1 to 1. If it has `reset(mask)`, that is called when episodes begin, with bool (n,); if it
has `set_mode(mode)`, that is called with "automatic", "takeoff" or "landing" when the mode of a flight changes.

Its attribute `observation`, as of `EnvOptions`, chooses other rows, `history` several ticks, and `others` the rows of
so many other drones behind its own. The program computes them from what is measured, with a Kalman filter for
estimates. It shows the true state in simulation only, and not in ranked attempts.

Instead of an object, a class or a function can create one, called as `make(num_envs, interface, **options)`. The name
`python:FILE.py:NAME` names a class or function of a file.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from crazyflie_gym._types import BoolArray, FloatArray
from crazyflie_gym.actions import as_array, clip_actions
from crazyflie_gym.options import to_json


class CustomController:
    """A controller of one's own for `num_envs` environments, whose answers are checked.

    Raises:
        TypeError: for what has no method `act`.
    """

    def __init__(self, inner: Any, num_envs: int, name: str) -> None:
        if not callable(getattr(inner, "act", None)):
            raise TypeError(f"{name}: expected an object with a method act(rows) -> actions, got {_kind(inner)}")
        self._inner, self._num_envs, self._name = inner, num_envs, name
        self._mode = "automatic"

    def act(self, rows: FloatArray) -> FloatArray:
        """Return actions, float32 (n, 4), for rows of observations, float32 (n, width).

        Raises:
            ValueError: for an answer of another shape, and for numbers that are not from -1 to 1.
            TypeError: for an answer that is not numbers.
        """
        answer = self._inner.act(rows)
        if answer is None:
            raise TypeError(f"{self._name}: act returned None, expected actions with shape ({self._num_envs}, 4)")
        actions = clip_actions(as_array(answer), clip=False)
        if actions.shape != (self._num_envs, 4):
            raise ValueError(f"{self._name}: act returned shape {actions.shape}, expected ({self._num_envs}, 4)")
        bad = ~(np.abs(actions) <= 1.0)
        if bad.any():
            row, axis = (int(i) for i in np.argwhere(bad)[0])
            value = actions[row, axis]
            raise ValueError(f"{self._name}: act returned {value} at [{row}][{axis}], expected a number from -1 to 1")
        return actions

    def observation_json(self) -> str | None:
        """Return the contents of the rows as JSON, or None for a controller that does not choose.

        Raises:
            ValueError: for attributes that JSON has no word for.
        """
        chosen = {name: getattr(self._inner, name, None) for name in ("observation", "history", "others")}
        chosen = {name: value for name, value in chosen.items() if value is not None}
        return to_json(**chosen) if chosen else None

    def reset(self, mask: BoolArray) -> None:
        """Notify the controller that the environments of the mask begin an episode."""
        if callable(getattr(self._inner, "reset", None)):
            self._inner.reset(mask)

    def set_mode(self, mode: str) -> None:
        """Notify the controller of another mode of the flights."""
        if mode != self._mode and callable(getattr(self._inner, "set_mode", None)):
            self._inner.set_mode(mode)
        self._mode = mode


def load(code: bytes, path: str, name: str) -> Any:
    """Return the class, function or object `name` of a file with this code. Its imports may be beside it.

    Raises:
        AttributeError: with a proposal, if there is no such name.
        Exception: what the code raises.
    """
    module = ModuleType(Path(path).stem)
    module.__file__ = path
    # pickle, dataclasses and tracebacks look the module up here
    sys.modules.setdefault(module.__name__, module)
    folder = str(Path(path).resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
    exec(compile(code, path, "exec"), module.__dict__)
    if not hasattr(module, name):
        known = sorted(key for key, value in vars(module).items() if callable(value) and not key.startswith("_"))
        near = difflib.get_close_matches(name, known, 1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise AttributeError(f"{path} has no {name!r}{hint}; it has: {', '.join(known) or 'no class or function'}")
    return getattr(module, name)


def make(source: Any, num_envs: int, interface: Any, options: Mapping[str, Any], name: str) -> CustomController:
    """Return the controller that a source is, or makes.

    Raises:
        TypeError: for a source that is neither an object with `act` nor callable, and options for an object.
        Exception: what the source raises.
    """
    if not isinstance(source, type) and hasattr(source, "act"):
        if options:
            raise TypeError(f"{name}: options are for a class or function, which makes the controller with them")
        return CustomController(source, num_envs, name)
    if not callable(source):
        raise TypeError(
            f"{name}: expected an object with act(rows) -> actions, or a class or function that makes one, "
            f"got {_kind(source)}"
        )
    return CustomController(source(num_envs, interface, **options), num_envs, name)


def label(source: Any) -> str:
    """Return what a controller is called in tables."""
    named = source if hasattr(source, "__qualname__") else type(source)
    return f"python:{named.__qualname__.replace('<locals>.', '')}"


def _kind(value: Any) -> str:
    return "None" if value is None else f"an object of type {type(value).__name__}"
