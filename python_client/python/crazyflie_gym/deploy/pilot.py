"""The controller of a deployment: rows as in the simulator, commands out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from crazyflie_gym._native import Controller, Crowd, Interface, Sim, check_model, model_text, setpoints
from crazyflie_gym._types import FloatArray
from crazyflie_gym.deploy.settings import Settings
from crazyflie_gym.deploy.state import Command, Fix, Sample, Setpoint
from crazyflie_gym.deploy.team import Team
from crazyflie_gym.options import model_sources, to_json
from crazyflie_gym.spaces import MEASURED


class Pilot:
    """A controller of the registry, or one of one's own, in front of a vehicle.

    Raises:
        ValueError: for a controller, model, task or option that is wrong, with a proposal where a name is unknown.
        Exception: what a controller of one's own raises.
    """

    def __init__(self, settings: Settings, team: Team | None = None, vehicle: int = 0) -> None:
        text = model_sources(settings.model)[0][0]
        known = model_text() if text is None else text
        self.model_name = check_model(known)
        self._team, self._vehicle = team, vehicle
        others = (
            {"task": settings.task, "task_options": dict(settings.task_options), "drones": len(team)} if team else {}
        )
        sim = Sim(1, to_json(vertical=settings.vertical, **others), [known])
        self.interface: Interface = sim.interface
        self.tick_s = self.interface.tick_s
        ticks = max(1, round(settings.duration_s / self.tick_s))
        options = to_json(**settings.task_options)
        rows = setpoints(
            settings.task, options, self.tick_s, ticks, settings.seed, (vehicle, len(team)) if team else None
        )
        self._setpoints: list[Setpoint] = [(x, y, z, yaw) for x, y, z, yaw in rows]
        given = settings.controller_options
        given_json = to_json(**given) if given else "null"
        self._controller: Controller | Crowd
        if team:
            layer = "{}" if settings.collision_avoidance else None
            self._controller = Crowd([settings.controller], sim, options=given_json, avoid=layer, drone=vehicle)
        else:
            self._controller = Controller(settings.controller, 1, self.interface, options=given_json, model=text)
        self._controller.check_measured("no vehicle measures it")
        self.is_height = settings.vertical == "height"
        self._row = np.zeros(MEASURED.width + 8 * (len(team) - 1 if team else 0), np.float32)
        self._fields = MEASURED.split(self._row[: MEASURED.width])
        self._last = np.zeros(4, np.float32)

    @property
    def ticks(self) -> int:
        """Length of the task in ticks."""
        return len(self._setpoints)

    def setpoint(self, tick: int) -> Setpoint:
        """Return where to be at a tick."""
        return self._setpoints[min(tick, len(self._setpoints) - 1)]

    def level(self, height_m: float) -> Command:
        """Return what holds a level vehicle up."""
        return Command(0.0, 0.0, 0.0, height_m if self.is_height else self.interface.hover_lift)

    def begin(self, height_m: float) -> None:
        """Begin a flight: the controller forgets what was."""
        self._controller.reset()
        lift = self.level(height_m).lift
        self._last = np.array([0.0, 0.0, 0.0, 2.0 * lift / self.interface.lift_max - 1.0], np.float32)

    def command(self, sample: Sample, fix: Fix, setpoint: Setpoint, speed: float = 1.0) -> Command:
        """Return what the controller answers to what is measured; `speed` is that of the vehicle's clock.

        Raises:
            ArithmeticError: for an answer that is not finite.
            Exception: what the controller raises.
        """
        row = self._observation(sample, fix, setpoint)
        if self._team:
            self._team.place(self._vehicle, fix, speed)
            self._team.write_neighbours(self._vehicle, row[MEASURED.width :], speed)
            row = row[np.newaxis, np.newaxis]
        action = self._controller.act(row).reshape(-1)
        if not np.isfinite(action).all():
            raise ArithmeticError(f"the controller answered {action.tolist()}, expected finite numbers")
        self._last = np.asarray(action, np.float32)
        return Command(*self.interface.command([float(number) for number in action]))

    def _observation(self, sample: Sample, fix: Fix, setpoint: Setpoint) -> FloatArray:
        values: dict[str, Any] = {
            "marker_pos_m": fix.pos_m,
            "marker_yaw_rad": math.remainder(fix.yaw_rad, math.tau),
            "marker_age_s": min(fix.age_s, 60.0),
            "marker_valid": 1.0,
            "attitude_rad": sample.att_rad,
            "gyro_radps": sample.gyro_radps,
            "acc_mps2": sample.acc_mps2,
            "vbat_v": sample.vbat_v,
            "setpoint": setpoint,
            "last_action": self._last,
        }
        for name, value in values.items():
            self._fields[name][...] = value
        return self._row.copy()
