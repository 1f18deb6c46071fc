"""Backend of an environment: a simulation in this process, or one on a server."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym._native import Interface
from crazyflie_gym._types import BoolArray, FloatArray, Steps


class Backend(Protocol):
    """A batch of environments, here or elsewhere; `_native.Sim` says what the methods do."""

    @property
    def num_envs(self) -> int:
        """Environments in the batch."""

    @property
    def num_drones(self) -> int:
        """Drones in each environment."""

    @property
    def width(self) -> int:
        """Numbers in a drone's observation."""

    @property
    def has_drone_axis(self) -> bool:
        """Whether the task has several drones, so that arrays have an axis of drones."""

    @property
    def tick_s(self) -> float:
        """Seconds per step."""

    @property
    def interface(self) -> Interface:
        """What an action means."""

    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray:
        """Begin episodes."""

    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]:
        """Fly one tick."""

    def step_into(
        self,
        actions: FloatArray,
        observations: FloatArray,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> int:
        """Fly one tick, into arrays of the caller."""

    def step_one(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Fly one tick of a batch of one."""

    def measured(self, observations: FloatArray) -> FloatArray:
        """Return what was measured in the step or reset whose result was `observations`."""

    def flying(self) -> BoolArray | None:
        """Return which of several drones fly on after the last step."""

    def metrics(self) -> FloatArray | None:
        """Return what is measured of the episodes of several drones."""

    def states(self) -> FloatArray:
        """Return the true states."""

    def last_of_episode(self, env: int) -> tuple[FloatArray, FloatArray | None] | None:
        """Return the last observation and true state of an episode that the last step ended."""


class RemoteBackend(Backend, Protocol):
    """A connection to a server, and the batch that was begun over it; `_native.Remote` says what the methods do."""

    resume_s: float

    @property
    def resumed(self) -> int:
        """How many lost connections were mended."""

    @property
    def max_steps(self) -> int:
        """The most steps of one `step_many`."""

    def ask(self, kind: str, fields: str = "{}") -> str:
        """Send a request in JSON and return its reply, JSON."""

    def begin(self, kind: str, fields: str, states: bool = False) -> str:
        """Send the request that begins a session and return its reply, JSON."""

    def step_many(self, actions: FloatArray) -> Steps:
        """Fly several ticks in one request."""

    def close(self) -> None:
        """End the session and the connection."""
