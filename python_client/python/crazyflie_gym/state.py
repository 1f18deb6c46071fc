"""What an environment goes on from: taken, and given to another one."""

from __future__ import annotations

from typing import Any

from crazyflie_gym._native import Sim
from crazyflie_gym.backend import Backend

EnvState = dict[str, Any]
"""Of `get_state`, for `set_state` of an environment that was made alike. It can be pickled; its content may change."""


def simulation(sim: Backend) -> Sim:
    """Return the simulation, if it is in this process.

    Raises:
        RuntimeError: for one on a server.
    """
    if not isinstance(sim, Sim):
        raise RuntimeError("an environment on a server stays there: its state cannot be taken or set")
    return sim
