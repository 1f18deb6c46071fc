"""Actions as users have them, made into what the simulation reads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from crazyflie_gym._types import FloatArray

ROUND_OFF = 1e-5
"""An action may be so much beyond -1 or 1: arithmetic in float32 leaves it there, no controller means it."""

_Result = TypeVar("_Result")


def as_array(actions: Any) -> FloatArray:
    """Return actions as an aligned float32 array in C order: from lists, other dtypes, arrays of torch and jax.

    An array that is one already is returned as it is.

    Raises:
        TypeError: for values that are not numbers.
    """
    if hasattr(actions, "detach"):
        # a tensor of torch; NumPy reads neither those of an accelerator nor those that gradients are kept of
        actions = actions.detach().cpu()
    try:
        array = np.asarray(actions)
    except ValueError as error:
        raise ValueError(f"actions: {error}") from None
    if array.dtype.kind not in "fiu":
        raise TypeError(f"actions: expected numbers, such as a float32 array, got dtype {array.dtype}")
    with np.errstate(over="ignore"):
        return np.require(array, np.float32, ["C", "A"])


def clip_actions(actions: FloatArray, clip: bool) -> FloatArray:
    """Return actions cut off at -1 and 1: only excess of round-off, or with `clip` any; NaN stays."""
    size = np.abs(actions)
    beyond = size > 1.0 if clip else (size > 1.0) & (size <= 1.0 + ROUND_OFF)
    return np.where(beyond, np.clip(actions, -1.0, 1.0), actions) if beyond.any() else actions


def fly_with(fly: Callable[[Any], _Result], actions: Any, clip: bool) -> _Result:
    """Return what `fly` makes of the actions: as they are, which costs nothing, or if it refuses them mended.

    Raises:
        ValueError, TypeError: of `fly`, for actions that mending does not help.
    """
    try:
        return fly(actions)
    except (TypeError, ValueError):
        mended = clip_actions(as_array(actions), clip)
        if mended is actions:
            raise
    return fly(mended)
