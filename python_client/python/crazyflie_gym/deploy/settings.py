"""Settings of a deployment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from crazyflie_gym._types import AnyController

POSITIONS = ("estimate", "mocap", "aruco")
"""Sources of positions."""


class DeployError(Exception):
    """A flight that did not take place, or ended otherwise than it should."""


@dataclass(frozen=True)
class Settings:
    """Flight, limits and files; the options of `crazyflie deploy`.

    Args:
        uri: address as cflib takes it: radio://..., udp://HOST:PORT or tcp://HOST:PORT; a list for several vehicles,
            whose positions are in one frame.
        controller: of `crazyflie_gym.controllers()`, or one of one's own (see `crazyflie_gym.custom`).
        controller_options: the controller's.
        model: path of the model file that controllers believe, None for the thesis's.
        vertical: vertical form of the model that is commanded.
        task: a task whose set-points are known beforehand: of one drone, or of as many drones as there are vehicles.
        task_options: the task's.
        duration_s: time of the controller, between take-off and landing.
        takeoff_height_m: where it takes over.
        position: "estimate", "mocap" or "aruco".
        poses: who sends the poses of mocap and aruco: udp://HOST:PORT[/BODY], python:FILE:NAME, or a function that
            yields them.
        room_m: farthest from the origin along x and y, and highest.
        tilt_max_deg: the tilt beyond which it lands.
        battery_min_v: the voltage below which it lands.
        stale_s: age of a position from which the vehicle is levelled.
        time_limit_s: longest flight, take-off included.
        collision_avoidance: whether several vehicles keep out of each other's way.
        lockstep: whether it drives the clock of a vehicle of `crazyflie cf2 --lockstep`.
        log: file of the log, None for one with the date in its name.
        seed: decides what a task draws.
        json: whether the summary is printed as JSON, and progress on standard error.
    """

    uri: str | Sequence[str]
    controller: AnyController = "thesis-pid"
    controller_options: Mapping[str, Any] | None = None
    model: str | None = None
    vertical: str = "thrust"
    task: str = "hover"
    task_options: Mapping[str, Any] = field(default_factory=dict)
    duration_s: float = 10.0
    takeoff_height_m: float = 0.5
    position: str = "estimate"
    poses: str | Callable[[], Iterable[Mapping[str, Any]]] = "udp://127.0.0.1:9870"
    room_m: tuple[float, float, float] = (1.5, 1.5, 2.0)
    tilt_max_deg: float = 35.0
    battery_min_v: float = 3.1
    stale_s: float = 0.25
    time_limit_s: float = 240.0
    collision_avoidance: bool = True
    lockstep: bool = False
    log: str | None = None
    seed: int = 0
    json: bool = False

    def __post_init__(self) -> None:
        """Check what could not fly.

        Raises:
            ValueError: naming what is wrong.
        """
        if self.position not in POSITIONS:
            raise ValueError(f"position is {self.position!r}, expected one of {', '.join(POSITIONS)}")
        for name in ("duration_s", "takeoff_height_m", "tilt_max_deg", "stale_s", "time_limit_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected a number above 0")
        if len(self.room_m) != 3 or not all(size > 0.0 for size in self.room_m):
            raise ValueError(f"room_m is {self.room_m}, expected three distances above 0")
        if len(self.uris) > 1 and self.position != "estimate":
            raise ValueError(f"position is {self.position!r}, expected 'estimate' for several vehicles")
        if not self.uris or len(set(self.uris)) < len(self.uris):
            raise ValueError(f"uri is {self.uri!r}, expected one address for each vehicle")
        if self.takeoff_height_m >= self.room_m[2]:
            raise ValueError(f"takeoff_height_m is {self.takeoff_height_m}, the room is {self.room_m[2]} m high")

    @property
    def uris(self) -> list[str]:
        """The addresses of all vehicles."""
        return [self.uri] if isinstance(self.uri, str) else list(self.uri)

    def plain(self) -> dict[str, Any]:
        """Return what was set, for a file."""
        plain = {key: value for key, value in asdict(self).items() if key != "json"}
        return plain | {key: str(plain[key]) for key in ("controller", "poses")}
