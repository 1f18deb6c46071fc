"""Types shared by the package and the stubs of the native module."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from crazyflie_gym._native import Sim
    from crazyflie_gym.remote import RemoteSim

Backend: TypeAlias = "Sim | RemoteSim"
"""Simulation of environments: in this process, or on a server."""

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
Observation = FloatArray | Any
"""A row of 24 numbers (or rows of them); with form="dict" a dict of them by field, which is the `Any` here: callers of
flat environments, the usual case, need no cast."""
Steps = tuple[
    tuple[FloatArray, FloatArray, BoolArray, BoolArray, int], FloatArray | None, FloatArray, FloatArray | None
]
"""Results of steps, with an axis of steps in front; true states; last observations and true states of episodes."""


class ParamEntry(TypedDict):
    """A parameter of an effect."""

    name: str
    unit: str
    about: str
    off: float
    low: float
    high: float


class EffectEntry(TypedDict):
    """An effect."""

    name: str
    about: str
    source: str
    hooks: list[str]
    params: list[ParamEntry]


class OptionEntry(TypedDict):
    """An option of a task; `drawn` ones may be a distribution."""

    name: str
    unit: str
    default: Any
    low: list[float]
    high: list[float]
    range: str
    drawn: bool
    about: str


class TaskEntry(TypedDict):
    """A task, for one drone or for several."""

    name: str
    id: str
    about: str
    reward: str
    max_episode_steps: int
    drones: int
    options: list[OptionEntry]


class FieldEntry(TypedDict):
    """A block of an observation row."""

    name: str
    unit: str
    about: str
    first: int
    length: int
    low: float
    high: float


class ActionChannelEntry(TypedDict):
    """One of the four numbers of an action."""

    name: str
    unit: str
    low: float
    high: float
    about: str
    bandwidth_radps: float


class ActionLevelEntry(TypedDict):
    """A level of actions, with its channels."""

    name: str
    about: str
    channels: list[ActionChannelEntry]
    validity: str
    source: str


class VehicleEntry(TypedDict):
    """A vehicle that has a name."""

    name: str
    platform: str
    about: str
    mass_kg: float
    arm_m: float
    vertical: str
    verticals: list[str]
    identified: list[str]
    stated: list[str]


class ChoiceEntry(TypedDict):
    """A choice of fields of an observation that has a name."""

    name: str
    about: str
    fields: list[str]


class ControllerEntry(TypedDict):
    """A controller; `file` describes the file that is named with it, `member` the part of it; `defaults` is JSON."""

    name: str
    also: str | None
    about: str
    source: str
    file: str | None
    member: str | None
    options: dict[str, str]
    defaults: str


class OwnController(Protocol):
    """A controller of one's own; see `crazyflie_gym.custom`."""

    def act(self, rows: FloatArray, /) -> Any:
        """Return actions (n, 4), from -1 to 1, for rows of observations, float32 (n, 24)."""


AnyController = str | OwnController | Callable[..., OwnController]
"""A name of `crazyflie_gym.controllers()`, an object with `act`, or a class or function that makes one."""
