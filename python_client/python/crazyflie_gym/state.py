"""The state of an environment: saved, and restored in another one."""

from __future__ import annotations

from typing import Any

import numpy as np

from crazyflie_gym._native import Sim
from crazyflie_gym._types import Backend, FloatArray

EnvState = dict[str, Any]
"""State from `get_state`, for `set_state` of an environment made alike. It can be pickled; its content may change."""


def simulation(sim: Backend) -> Sim:
    """Return the simulation, if it is in this process.

    Raises:
        RuntimeError: for one on a server.
    """
    if not isinstance(sim, Sim):
        raise RuntimeError("an environment on a server stays there: its state cannot be taken or set")
    return sim


def set_force(sim: Backend, force_n: Any, lead: tuple[int, ...]) -> None:
    """Let forces act on the drones of a simulation; `lead` is the shape of its rows. None ends them.

    Raises:
        ValueError: for another shape than (3,) or (*lead, 3), and for what is not finite, with its place.
        RuntimeError: for a simulation on a server.
    """
    if force_n is None:
        simulation(sim).set_force(None)
        return
    rows = np.asarray(force_n, np.float32)
    if rows.shape not in ((3,), (*lead, 3)):
        raise ValueError(f"force_n: expected shape (3,) or {(*lead, 3)}, got {rows.shape}")
    simulation(sim).set_force(np.ascontiguousarray(np.broadcast_to(rows, (*lead, 3))))


def step_costs(sim: Backend) -> FloatArray:
    """Return the costs of the last step by the option `cost`; 0 where a step only resets.

    Raises:
        RuntimeError: for a simulation on a server.
    """
    return np.ascontiguousarray(simulation(sim).watched()[..., -1])
