"""The simulator in Rust. Use it through the package `crazyflie_gym`."""

from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym._types import (
    BoolArray,
    ControllerEntry,
    EffectEntry,
    FieldEntry,
    FloatArray,
    MissionEntry,
    Steps,
    TaskEntry,
)

__all__ = [
    "Controller",
    "Crowd",
    "Interface",
    "Pid",
    "Remote",
    "Sim",
    "Swarm",
    "ansi",
    "check_model",
    "cli",
    "controllers",
    "effects",
    "metrics",
    "missions",
    "model_text",
    "observation_fields",
    "path",
    "render",
    "tasks",
]

@final
class Interface:
    """What an action means: the ranges that -1..1 is mapped to."""

    def __new__(
        cls,
        *,
        tick_s: float,
        vertical: str,
        tilt_max_rad: float,
        yaw_rate_max_radps: float,
        lift_max: float,
        hover_lift: float,
        yaw_sign: float,
    ) -> Interface: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def vertical(self) -> Literal["height", "pwm", "thrust"]: ...
    @property
    def tilt_max_rad(self) -> float: ...
    @property
    def yaw_rate_max_radps(self) -> float: ...
    @property
    def lift_max(self) -> float: ...
    @property
    def hover_lift(self) -> float: ...
    @property
    def yaw_sign(self) -> float: ...

@final
class Sim:
    """A batch of `num_envs` environments. `options` is JSON, `model` the text of a model file."""

    def __new__(cls, num_envs: int, options: str = "{}", model: str | None = None) -> Sim: ...
    @property
    def num_envs(self) -> int: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def isa(self) -> Literal["baseline", "avx2"]: ...
    @property
    def interface(self) -> Interface: ...
    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray: ...
    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]: ...
    def step_into(
        self,
        actions: FloatArray,
        observations: FloatArray,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> int: ...
    def step_one(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]: ...
    def states(self) -> FloatArray: ...
    def last_of_episode(self, env: int) -> tuple[FloatArray, FloatArray] | None: ...

@final
class Remote:
    """A connection to a server; once begun, a batch of environments there."""

    resume_s: float

    def __new__(cls, url: str, token: str | None = None, num_envs: int = 1) -> Remote: ...
    def ask(self, kind: str, fields: str = "{}") -> str: ...
    def begin(self, kind: str, fields: str, states: bool = False) -> str: ...
    @property
    def num_envs(self) -> int: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def interface(self) -> Interface: ...
    @property
    def max_steps(self) -> int: ...
    @property
    def resumed(self) -> int: ...
    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray: ...
    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]: ...
    def step_into(
        self,
        actions: FloatArray,
        observations: FloatArray,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> int: ...
    def step_one(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]: ...
    def step_many(self, actions: FloatArray) -> Steps: ...
    def states(self) -> FloatArray: ...
    def last_of_episode(self, env: int) -> tuple[FloatArray, FloatArray | None] | None: ...
    def close(self) -> None: ...

class Controller:
    """The controller `name`, or `name:file`, for `num_envs` environments. It reads what an agent reads."""

    def __new__(
        cls,
        name: str,
        num_envs: int,
        of: Sim | Interface,
        *,
        options: str = "null",
        model: str | None = None,
        mode: str = "automatic",
    ) -> Controller: ...
    @property
    def num_envs(self) -> int: ...
    def set_mode(self, mode: str) -> None: ...
    def act(self, observations: FloatArray) -> FloatArray: ...
    def reset(self, mask: BoolArray | None = None) -> None: ...

@final
class Pid(Controller):
    """The PID of the thesis for `num_envs` environments."""

    def __new__(
        cls,
        num_envs: int,
        of: Sim | Interface,
        gains: str = "thesis",
        mode: str = "automatic",
    ) -> Pid: ...

def controllers() -> list[ControllerEntry]: ...
def effects() -> list[EffectEntry]: ...
def tasks() -> list[TaskEntry]: ...
def observation_fields() -> list[FieldEntry]: ...
def model_text() -> str: ...
def check_model(text: str) -> str: ...
def cli(argv: list[str]) -> int: ...
def render(
    width: int,
    height: int,
    *,
    drones: FloatArray | None = None,
    trail: FloatArray | None = None,
    setpoint: FloatArray | None = None,
    path: FloatArray | None = None,
    markers: FloatArray | None = None,
    marker_side_m: float = 0.197,
    fix: FloatArray | None = None,
    camera_fov_rad: float | None = None,
) -> NDArray[np.uint8]: ...
def ansi(picture: NDArray[np.uint8], columns: int = 80) -> str: ...
def path(task: str, options: str, tick_s: float, ticks: int) -> FloatArray: ...

@final
class Swarm:
    """A batch of `num_worlds` worlds of several drones."""

    def __new__(cls, num_worlds: int, options: str = "{}", models: list[str] | None = None) -> Swarm: ...
    @property
    def num_worlds(self) -> int: ...
    @property
    def num_drones(self) -> int: ...
    @property
    def width(self) -> int: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def isa(self) -> Literal["baseline", "avx2", "avx512"]: ...
    def interface(self, drone: int) -> Interface: ...
    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray: ...
    def step(
        self, actions: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, BoolArray, FloatArray]: ...
    def states(self) -> FloatArray: ...
    def loads(self) -> FloatArray | None: ...
    def last_of_episode(self, world: int) -> FloatArray | None: ...

@final
class Crowd:
    """A controller for every drone of a `Swarm`."""

    def __new__(cls, name: str, of: Swarm, *, options: str = "null", avoid: str | None = None) -> Crowd: ...
    def act(self, observations: FloatArray) -> FloatArray: ...
    def reset(self, mask: BoolArray | None = None) -> None: ...

def missions() -> list[MissionEntry]: ...
def metrics() -> list[tuple[str, str, str]]: ...
