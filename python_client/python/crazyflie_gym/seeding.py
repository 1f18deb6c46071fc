"""Seeds and masks of a reset. Episode k of seed s is the same in every batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym._types import BoolArray

Seeds = NDArray[np.uint64]
_MOST = 2**64


def as_seeds(given: Sequence[int]) -> Seeds:
    """Return seeds as the simulator takes them.

    Raises:
        ValueError: for a seed that is not from 0 to 2**64 - 1.
    """
    for seed in given:
        if not 0 <= seed < _MOST:
            raise ValueError(f"seed is {seed}, expected 0 to {_MOST - 1}")
    return np.array(given, np.uint64)


def consecutive_seeds(seed: int, count: int) -> Seeds:
    """Return seed, seed + 1, and so on.

    Raises:
        ValueError: if one is not from 0 to 2**64 - 1.
    """
    first = np.uint64(as_seeds([seed, seed + count - 1])[0])
    return np.arange(count, dtype=np.uint64) + first


def draw_seeds(generator: np.random.Generator, count: int) -> Seeds:
    """Return seeds for environments that were never given any."""
    return generator.integers(0, _MOST, size=count, dtype=np.uint64)


def refuse_options(options: dict[str, Any] | None, *known: str) -> None:
    """Refuse options of a reset that nothing would obey.

    Raises:
        ValueError: naming the option.
    """
    for name in options or {}:
        if name not in known:
            has = f"a reset has {', '.join(known)}" if known else "a reset has none"
            raise ValueError(f"options[{name!r}]: {has}; starts are options of the task, see task_options")


def reset_mask(options: dict[str, Any] | None, envs: int) -> BoolArray | None:
    """Return the mask of a reset's options, if one is given.

    Raises:
        ValueError: for another shape, without any True, and for an option that a reset does not have.
        TypeError: for another type.
    """
    refuse_options(options, "reset_mask")
    mask = None if options is None else options.get("reset_mask")
    if mask is None:
        return None
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        got = f"dtype {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"options['reset_mask']: expected a numpy array of bool, got {got}")
    if mask.shape != (envs,):
        raise ValueError(f"options['reset_mask']: expected shape ({envs},), got {mask.shape}")
    if not mask.any():
        raise ValueError("options['reset_mask']: expected at least one True")
    return np.ascontiguousarray(mask)
