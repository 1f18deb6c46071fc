"""Wind that differs from place to place."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_KEYS = ("origin_m", "spacing_m", "velocity_mps")


class WindField(Mapping[str, Any]):
    """Velocities of the air on a regular grid, steady in time; between its points they are interpolated trilinearly.

    Beyond the grid the air moves as at its nearest face. Drag acts on the motion through the air: what the model has
    (`lateral.drag`, and `heave` of the form "thrust"), and the effects drag_linear, drag_quadratic, heave_damping and
    flap. At least one of them must be there: the built-in model has no drag.

        wind = crazyflie_gym.WindField.sample(lambda pos_m: 0.5 * pos_m[..., ::-1], [-2, -2, 0], [2, 2, 2], 0.25)
        env = gymnasium.make("Crazyflie-v0", effects={"drag_linear": 0.3}, wind_field=wind)

    Args:
        origin_m: of the grid's first point, in the world frame.
        spacing_m: from point to point: a number, or one for each axis.
        velocity_mps: (nx, ny, nz, 3), along the axes of the world.

    Raises:
        ValueError: for another shape, and for what is not finite.
    """

    def __init__(self, origin_m: ArrayLike, spacing_m: ArrayLike, velocity_mps: ArrayLike) -> None:
        self.origin_m = _triple("origin_m", origin_m)
        self.spacing_m = _triple("spacing_m", spacing_m)
        self.velocity_mps: NDArray[np.float32] = np.array(velocity_mps, np.float32)
        shape = self.velocity_mps.shape
        if len(shape) != 4 or shape[3] != 3 or 0 in shape:
            raise ValueError(f"velocity_mps: expected shape (nx, ny, nz, 3), got {shape}")
        bad = ~np.isfinite(self.velocity_mps)
        if bad.any():
            place = "".join(f"[{i}]" for i in np.argwhere(bad)[0])
            raise ValueError(f"velocity_mps{place} is {self.velocity_mps[bad][0]}, expected a finite number")

    @classmethod
    def sample(
        cls,
        function: Callable[[NDArray[np.float64]], ArrayLike],
        low_m: ArrayLike,
        high_m: ArrayLike,
        spacing_m: ArrayLike,
    ) -> WindField:
        """Return the field of a function, which is called once, with all points of a grid.

        Args:
            function: from positions, float64 (nx, ny, nz, 3), to velocities of that shape.
            low_m: the grid's first point, in the world frame.
            high_m: the grid's last point; where the spacing does not divide the way, the grid ends beyond it.
            spacing_m: from point to point: a number, or one for each axis.

        Raises:
            ValueError: for a spacing that is not positive, for ends the wrong way round, and where the function
                returns another shape or what is not finite.
        """
        low, high, spacing = _triple("low_m", low_m), _triple("high_m", high_m), _triple("spacing_m", spacing_m)
        if not (spacing > 0.0).all():
            raise ValueError(f"spacing_m is {spacing.tolist()}, expected positive numbers")
        if not (low <= high).all():
            raise ValueError(f"low_m is {low.tolist()}, expected no more than high_m, {high.tolist()}")
        counts = np.ceil((high - low) / spacing - 1e-9).astype(int) + 1
        axes = [first + step * np.arange(count) for first, step, count in zip(low, spacing, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        velocity = np.asarray(function(points))
        if velocity.shape != points.shape:
            raise ValueError(f"function: expected velocities of shape {points.shape}, got {velocity.shape}")
        return cls(low, spacing, velocity)

    def __getitem__(self, key: str) -> Any:
        """Return a part of the field by its name, as a task file would have it."""
        if key not in _KEYS:
            raise KeyError(key)
        return getattr(self, key).tolist()

    def __iter__(self) -> Iterator[str]:
        """Go through the names of the parts."""
        return iter(_KEYS)

    def __len__(self) -> int:
        """Return the number of parts."""
        return len(_KEYS)


def _triple(name: str, given: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(given, np.float64)
    if values.shape not in ((), (3,)):
        raise ValueError(f"{name}: expected a number, or three, got shape {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"{name} is {values.tolist()}, expected finite numbers")
    return np.broadcast_to(values, (3,)).copy()
