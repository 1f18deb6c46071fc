"""Flights of a controller, counted: a unit of work is a pure function of scenario, controller and seeds.

from crazyflie_gym.evaluation import Scenario, Work, fly, median

flights = fly(Work(Scenario("Crazyflie-v0"), "thesis-pid", first_seed=0, count=128))
print(median(flights, "rmse_m"))
"""

from __future__ import annotations

import hashlib
import inspect
import json
import pickle
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, TypedDict, cast

import gymnasium as gym
import numpy as np

from crazyflie_gym import _native
from crazyflie_gym._native import controllers
from crazyflie_gym._types import AnyController
from crazyflie_gym.make_backend import make_controller
from crazyflie_gym.notebook import table
from crazyflie_gym.spaces import STATE_FIELDS, split
from crazyflie_gym.vector import CrazyflieVectorEnv


@dataclass(frozen=True)
class Scenario:
    """Environment and number of ticks of a flight: arguments of `gymnasium.make_vec`."""

    id: str = "Crazyflie-v0"
    ticks: int = 500
    vertical: str = "pwm"
    effects: Mapping[str, Any] = field(default_factory=dict)
    task_options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Work:
    """Flights of the seeds `first_seed`, `first_seed + 1`, ... by a controller.

    Args:
        controller: of `crazyflie_gym.controllers()`, or one of one's own (see `crazyflie_gym.custom`).
        file: the content of the file of a controller that has one, so that work can be done where the file is not.
        options: the controller's.
    """

    scenario: Scenario
    controller: AnyController
    first_seed: int
    count: int
    file: bytes | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @staticmethod
    def of(scenario: Scenario, controller: AnyController, first_seed: int, count: int, **options: Any) -> Work:
        """Return the work for a controller; where its name has a file, `NAME:FILE`, that is read."""
        path = file_of(controller)
        return Work(scenario, controller, first_seed, count, Path(path).read_bytes() if path else None, options)

    def key(self) -> str:
        """Return what is the same for the same work and differs for any other, and for another simulator.

        Raises:
            TypeError: for a controller of one's own that cannot be identified: whose source is not in a file, or
                that cannot be pickled.
        """
        plain = asdict(replace(self, controller="")) | {"simulator": _simulator()}
        plain |= {"controller": _identity(self.controller), "file": self.file and _sha256(self.file)}
        return _sha256(json.dumps(plain, sort_keys=True).encode())


def file_of(controller: AnyController) -> str | None:
    """Return the path of the file that a controller is named with, if it is named with one."""
    if not isinstance(controller, str):
        return None
    name, _, path = controller.partition(":")
    entry = next((e for e in controllers() if name.rpartition("+")[2] in (e["name"], e["also"])), None)
    return path.rpartition(":")[0] if entry and entry["member"] else path or None


def _identity(controller: AnyController) -> list[str]:
    """Return the identity of a controller, besides its file and its options."""
    if isinstance(controller, str):
        name, _, path = controller.partition(":")
        # the file's folder makes no difference; its content and the class do
        return [name, path.removeprefix(file_of(controller) or "")]
    named = controller if hasattr(controller, "__qualname__") else type(controller)
    try:
        source = Path(inspect.getfile(cast("Any", named))).read_bytes()
        state = b"" if named is controller else pickle.dumps(controller)
    except Exception as error:
        raise TypeError(
            f"the controller {named.__qualname__} cannot be told from others ({error}): name it as python:FILE.py:NAME"
        ) from None
    return [named.__qualname__, _sha256(source), _sha256(state)]


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


class Flight(TypedDict):
    """One flight: mean reward per tick (0 after an early end); errors until the end; travel of the tilt commands."""

    seed: int
    reward: float
    rmse_m: float
    yaw_rmse_deg: float
    travel_degps: float
    failed: bool


class Flights(list[Flight]):
    """Flights, as a list, which a notebook shows as a table of medians."""

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the spread of every figure."""
        units = {"rmse_m": "m", "yaw_rmse_deg": "deg", "travel_degps": "deg/s", "reward": "per tick"}
        rows = [["failed", f"{sum(flight['failed'] for flight in self)} of {len(self)}", "", ""]]
        for figure, unit in units.items() if self else ():
            values = [cast("dict[str, float]", flight)[figure] for flight in self]
            cells = [f"{value:.4g}" for value in np.quantile(values, [0.25, 0.5, 0.75])]
            rows.append([f"{figure} ({unit})", *cells])
        return table(f"{len(self)} flights", ["", "25 %", "median", "75 %"], rows)


@cache
def _simulator() -> str:
    return _sha256(Path(_native.__file__).read_bytes())


def fly(work: Work) -> Flights:
    """Fly. The same work gives the same flights, to the bit, whoever does it and however seeds are split.

    Raises:
        ValueError: for what `gymnasium.make_vec` and `CrazyflieVectorEnv.controller` refuse.
        Exception: what a controller of one's own raises.
    """
    s = work.scenario
    made = gym.make_vec(
        s.id,
        num_envs=work.count,
        vertical=s.vertical,
        effects=s.effects,
        task_options=s.task_options,
        observation="measured",
        true_state=True,
        max_episode_steps=-1,
        autoreset_mode="same_step",
    )
    envs = cast("CrazyflieVectorEnv", made)
    name = work.controller
    if work.file is not None and isinstance(name, str) and ":" not in name:
        name = f"{name}:file"
    pilot = make_controller(name, envs.sim, None, "automatic", False, work.options, work.file)
    return _count(envs, pilot, work)


def _count(envs: CrazyflieVectorEnv, pilot: Any, work: Work) -> Flights:
    observations, info = envs.reset(seed=work.first_seed)
    states, rows = info["true_state"], cast("Any", observations)
    reward, square, turned, travel, ticks = np.zeros((5, work.count))
    flying = np.ones(work.count, np.bool_)
    for _ in range(work.scenario.ticks):
        fields = split(rows)
        setpoint = fields["setpoint"]
        off = states[:, STATE_FIELDS["pos_m"]] - setpoint[:, :3]
        turn = states[:, STATE_FIELDS["att_rad"]][:, 2] - setpoint[:, 3]
        square += flying * (off.astype(np.float64) ** 2).sum(1)
        turned += flying * np.arctan2(np.sin(turn), np.cos(turn)) ** 2
        ticks += flying
        actions = envs.act(pilot)
        travel += flying * np.abs(actions[:, 0:2] - fields["last_action"][:, 0:2]).sum(1)
        step = envs.step(actions)
        rows, states = cast("Any", step[0]), step[4]["true_state"]
        reward += flying * step[1]
        flying &= ~step[2]
        pilot.reset(step[2])
    tilt_deg = np.degrees(envs.interface.tilt_max_rad)
    columns = {
        "reward": reward / work.scenario.ticks,
        "rmse_m": np.sqrt(square / ticks),
        "yaw_rmse_deg": np.degrees(np.sqrt(turned / ticks)),
        "travel_degps": tilt_deg * travel / (ticks * envs.interface.tick_s),
        "failed": ~flying,
    }
    plain = {name: column.tolist() for name, column in columns.items()}
    seeds = range(work.first_seed, work.first_seed + work.count)
    return Flights(
        cast("Flight", dict(zip(("seed", *plain), row, strict=True)))
        for row in zip(seeds, *plain.values(), strict=True)
    )


def median(flights: Iterable[Flight], figure: str) -> float:
    """Return the median of a figure over flights."""
    return float(np.median([cast("dict[str, float]", flight)[figure] for flight in flights]))
