"""Flights of a controller, counted: a unit of work is a pure function of scenario, controller and seeds.

from crazyflie_gym.evaluation import Scenario, Work, fly, median

flights = fly(Work(Scenario("Crazyflie-v0"), "thesis-pid", first_seed=0, count=128))
print(median(flights, "rmse_m"))
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypedDict, cast

import gymnasium as gym
import numpy as np

from crazyflie_gym import _native
from crazyflie_gym.spaces import STATE_FIELDS, split
from crazyflie_gym.vector import CrazyflieVectorEnv


@dataclass(frozen=True)
class Scenario:
    """What is flown, and for how many ticks: arguments of `gymnasium.make_vec`."""

    id: str = "Crazyflie-v0"
    ticks: int = 500
    vertical: str = "pwm"
    effects: Mapping[str, Any] = field(default_factory=dict)
    task_options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Work:
    """Flights of the seeds `first_seed`, `first_seed + 1`, ... by a controller of `crazyflie_gym.controllers()`.

    `file` is the content of the file of a controller that has one, so that work can be done where the file is not.
    """

    scenario: Scenario
    controller: str
    first_seed: int
    count: int
    file: bytes | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @staticmethod
    def of(scenario: Scenario, controller: str, first_seed: int, count: int, **options: Any) -> Work:
        """Return the work for a controller as it is named elsewhere, `NAME` or `NAME:FILE`; the file is read."""
        name, _, path = controller.partition(":")
        return Work(scenario, name, first_seed, count, Path(path).read_bytes() if path else None, options)

    def key(self) -> str:
        """Return what is the same for the same work and differs for any other, and for another simulator."""
        plain = asdict(self) | {"file": self.file and hashlib.sha256(self.file).hexdigest(), "simulator": _simulator()}
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


class Flight(TypedDict):
    """One flight: mean reward per tick (0 after an early end); errors until the end; travel of the tilt commands."""

    seed: int
    reward: float
    rmse_m: float
    yaw_rmse_deg: float
    travel_degps: float
    failed: bool


@cache
def _simulator() -> str:
    return hashlib.sha256(Path(_native.__file__).read_bytes()).hexdigest()


def fly(work: Work) -> list[Flight]:
    """Fly. The same work gives the same flights, to the bit, whoever does it and however seeds are split.

    Raises:
        ValueError: for what `gymnasium.make_vec` and `CrazyflieVectorEnv.controller` refuse.
    """
    s = work.scenario
    made = gym.make_vec(
        s.id,
        num_envs=work.count,
        vertical=s.vertical,
        effects=s.effects,
        task_options=s.task_options,
        true_state=True,
        max_episode_steps=-1,
        autoreset_mode="same_step",
    )
    envs = cast("CrazyflieVectorEnv", made)
    if work.file is None:
        pilot = envs.controller(work.controller, **work.options)
    else:
        # an open temporary file cannot be opened again on every system
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "controller")
            file.write_bytes(work.file)
            pilot = envs.controller(f"{work.controller}:{file}", **work.options)
    return _count(envs, pilot, work)


def _count(envs: CrazyflieVectorEnv, pilot: Any, work: Work) -> list[Flight]:
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
        actions = pilot.act(rows)
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
    return [
        cast("Flight", dict(zip(("seed", *plain), row, strict=True)))
        for row in zip(seeds, *plain.values(), strict=True)
    ]


def median(flights: Iterable[Flight], figure: str) -> float:
    """Return the median of a figure over flights."""
    return float(np.median([cast("dict[str, float]", flight)[figure] for flight in flights]))
