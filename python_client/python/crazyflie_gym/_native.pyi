"""The simulator in Rust. Use it through the package `crazyflie_gym`."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self, disjoint_base

from crazyflie_gym._types import (
    ActionLevelEntry,
    AnyController,
    BoolArray,
    ChoiceEntry,
    ControllerEntry,
    EffectEntry,
    FieldEntry,
    FloatArray,
    TaskEntry,
    VehicleEntry,
)

__all__ = [
    "PARTS",
    "Controller",
    "Crowd",
    "GainSearch",
    "Interface",
    "JaxCore",
    "Pid",
    "Sim",
    "action_levels",
    "ansi",
    "check_model",
    "cli",
    "controllers",
    "datasheet_model",
    "double_flight",
    "effects",
    "estimated_fields",
    "expression_fields",
    "expression_functions",
    "jax_module",
    "jax_step_target",
    "loop_plots",
    "loop_report",
    "metrics",
    "model_text",
    "neighbour_fields",
    "observable_fields",
    "observation_choices",
    "observation_fields",
    "path",
    "policy_c",
    "read_season",
    "read_task",
    "render",
    "robustness",
    "setpoints",
    "state_space",
    "submit",
    "tasks",
    "track_rows",
    "transfer_function",
    "vehicles",
    "verify_attempts",
]

PARTS: Final[list[tuple[str, bool]]]

@final
class Interface:
    """The meaning of an action: the ranges that -1..1 is mapped to."""

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
        set_point: dict[str, Any] | None = None,
    ) -> Interface: ...
    def command(self, action: Sequence[float]) -> tuple[float, float, float, float]: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def action(self) -> str: ...
    @property
    def action_ranges(self) -> list[tuple[float, float]]: ...
    @property
    def vertical(self) -> Literal["height", "pwm", "thrust", "motors"]: ...
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

@disjoint_base
class Sim:
    """A batch of `num_envs` environments. `options` is JSON, `models` the texts of model files."""

    def __new__(cls, num_envs: int, options: str = "{}", models: list[str] | None = None) -> Self: ...
    @property
    def num_envs(self) -> int: ...
    @property
    def num_drones(self) -> int: ...
    @property
    def width(self) -> int: ...
    @property
    def has_drone_axis(self) -> bool: ...
    @property
    def tick_s(self) -> float: ...
    @property
    def isa(self) -> Literal["baseline", "avx2", "avx512"]: ...
    @property
    def interface(self) -> Interface: ...
    @property
    def interfaces(self) -> list[Interface]: ...
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
    def rollout_into(
        self,
        actions: FloatArray,
        rows: FloatArray,
        returns: FloatArray,
        rewards: FloatArray | None,
        terminated: BoolArray | None,
        truncated: BoolArray | None,
        observations: FloatArray | None,
    ) -> None: ...
    def fly_into(
        self,
        controller: Controller | Crowd,
        steps: int,
        rows: FloatArray,
        returns: FloatArray,
        rewards: FloatArray | None,
        terminated: BoolArray | None,
        truncated: BoolArray | None,
        observations: FloatArray | None,
    ) -> FloatArray: ...
    def measured(self, observations: FloatArray) -> FloatArray: ...
    def act(self, controller: Controller | Crowd, observations: FloatArray) -> FloatArray: ...
    def watched(self) -> FloatArray: ...
    def end_flights(self, ends: BoolArray) -> None: ...
    def flying(self) -> BoolArray | None: ...
    def metrics(self) -> FloatArray | None: ...
    def get_state(self) -> bytes: ...
    def set_state(self, state: bytes) -> None: ...
    def set_copies(self, state: bytes, seeds: NDArray[np.uint64] | None = None) -> None: ...
    def set_force(self, force_n: FloatArray | None) -> None: ...
    def __setstate__(self, state: bytes) -> None: ...
    def states(self) -> FloatArray: ...
    def loads(self) -> FloatArray | None: ...
    def last_of_episode(self, env: int) -> tuple[FloatArray, FloatArray] | None: ...

@disjoint_base
class Controller:
    """The controller `name`, or one of one's own, for `num_envs` environments. It reads what an agent reads."""

    def __new__(
        cls,
        name: AnyController,
        num_envs: int,
        of: Sim | Interface,
        *,
        options: str = "null",
        model: str | None = None,
        mode: str = "automatic",
        file: bytes | None = None,
    ) -> Controller: ...
    @property
    def num_envs(self) -> int: ...
    def set_mode(self, mode: str) -> None: ...
    def check_measured(self, reason: str) -> None: ...
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

@final
class GainSearch:
    """A search of gains by CMA-ES, from `start`; the same costs lead to the same gains."""

    def __new__(cls, start: Sequence[float], step: float, population: int, seed: int) -> GainSearch: ...
    def ask(self) -> list[list[float]] | None: ...
    def tell(self, costs: Sequence[float]) -> None: ...

def controllers() -> list[ControllerEntry]: ...
def effects() -> list[EffectEntry]: ...
def tasks() -> list[TaskEntry]: ...
def track_rows(text: str, name: str) -> list[list[float]]: ...
def observation_fields(observation: str | list[str] = "measured") -> list[FieldEntry]: ...
def action_levels(model: str | None = None, vertical: str | None = None) -> list[ActionLevelEntry]: ...
def observable_fields() -> list[FieldEntry]: ...
def expression_fields() -> list[FieldEntry]: ...
def expression_functions() -> list[str]: ...
def read_task(text: str) -> tuple[str, str, str]: ...
def observation_choices() -> list[ChoiceEntry]: ...
def estimated_fields(observation: str | list[str]) -> list[str]: ...
def neighbour_fields() -> list[FieldEntry]: ...
def model_text(vehicle: str = "cf2-thesis", *, control_hz: float | None = None) -> str: ...
def vehicles() -> list[VehicleEntry]: ...
def check_model(text: str) -> str: ...
def datasheet_model(text: str) -> str: ...
def cli(argv: list[str]) -> int: ...
def double_flight(
    options: str, models: list[str], seed: int, actions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float64]]:
    """Fly the first episode of a seed in double precision, without a reset at its end.

    Returns:
        Observations from the first moment on, rewards, terminated, truncated, true states; flat, tick by tick and
        drone by drone.
    """

@final
class JaxCore:
    """A batch of environments that compiled JAX programs step; see `crazyflie_gym.jax.make_core`."""

    def __new__(cls, num_envs: int, options: str, models: list[str]) -> JaxCore: ...
    @property
    def handle(self) -> int:
        """The number by which compiled programs know it."""

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
        """True if the task has several drones, so that arrays have an axis of drones."""

    @property
    def tick_s(self) -> float:
        """Seconds per step."""

    def reset(self, seeds: list[int]) -> NDArray[np.float32]:
        """Begin an episode of each seed; the observations, flat."""

def jax_step_target() -> object:
    """Return the function of a step, for `jax.ffi.register_ffi_target`."""

def jax_module(
    options: str = "{}", models: list[str] | None = None, *, seed: int = 0, starts: int = 256
) -> tuple[str, list[tuple[list[int], NDArray[np.float64]]]]:
    """Return the text of a module of JAX functions, and the starts that it picks from.

    Each start has the words of each drone's noise and the numbers of the start.

    Raises:
        ValueError: naming the option that is wrong, or that cannot be recorded.
    """

def policy_c(policy: bytes, stem: str, *, model: str | None = None, vertical: str | None = None) -> tuple[str, str]: ...
def submit(
    controllers: list[AnyController],
    scenario: str,
    *,
    options: str = "null",
    collision_avoidance: bool = False,
    data: str | PathLike[str] | None = None,
) -> str: ...
def robustness(
    controllers: list[AnyController], scenarios: list[str], seeds: int, first_seed: int, *, options: str = "null"
) -> str: ...
def verify_attempts(archive: str) -> str: ...
def read_season(path: str | PathLike[str]) -> str: ...
def transfer_function(
    channel: str, model: str | None = None, vertical: str | None = None
) -> tuple[list[float], list[float]]: ...
def state_space(
    model: str | None = None, vertical: str | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def loop_report(
    axis: str | None = None,
    gains: str | None = None,
    model: str | None = None,
    vertical: str | None = None,
    sensors: str = "lab",
) -> str: ...
def loop_plots(
    file: str,
    axis: str | None = None,
    gains: str | None = None,
    model: str | None = None,
    vertical: str | None = None,
    sensors: str = "lab",
) -> bytes: ...
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
def setpoints(
    task: str, options: str, tick_s: float, ticks: int, seed: int = 0, drone: tuple[int, int] | None = None
) -> list[tuple[float, float, float, float]]: ...

@final
class Crowd:
    """Controllers for the drones of a `Sim` whose task has several: one for all of them, or one for each."""

    def __new__(
        cls,
        names: list[AnyController],
        of: Sim,
        *,
        options: str = "null",
        avoid: str | None = None,
        drone: int | None = None,
    ) -> Crowd: ...
    def check_measured(self, reason: str) -> None: ...
    def act(self, observations: FloatArray) -> FloatArray: ...
    def reset(self, mask: BoolArray | None = None) -> None: ...

def metrics() -> list[tuple[str, str, str]]: ...
