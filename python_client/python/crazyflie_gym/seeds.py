"""Seeds: episode k of seed s is the same in every batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Seeds = NDArray[np.uint64]
_MOST = 2**64


def seeds(given: Sequence[int]) -> Seeds:
    """Return seeds as the simulator takes them.

    Raises:
        ValueError: for a seed that is not from 0 to 2**64 - 1.
    """
    for seed in given:
        if not 0 <= seed < _MOST:
            raise ValueError(f"seed is {seed}, expected 0 to {_MOST - 1}")
    return np.array(given, np.uint64)


def consecutive(seed: int, count: int) -> Seeds:
    """Return seed, seed + 1, and so on.

    Raises:
        ValueError: if one is not from 0 to 2**64 - 1.
    """
    first = np.uint64(seeds([seed, seed + count - 1])[0])
    return np.arange(count, dtype=np.uint64) + first


def draw(generator: np.random.Generator, count: int) -> Seeds:
    """Return seeds for environments that were never given any."""
    return generator.integers(0, _MOST, size=count, dtype=np.uint64)
