"""Parts of a tick of a deployment, in the project's units and signs."""

from __future__ import annotations

import math
from dataclasses import dataclass

Vector = tuple[float, float, float]
Setpoint = tuple[float, float, float, float]
"""Desired position x, y, z in metres, and heading in rad."""


@dataclass(frozen=True)
class Command:
    """An attitude and a lift: a thrust in PWM counts, or a height in metres.

    The yaw rate has the vehicle's own sign, as the model's command.
    """

    roll_rad: float
    pitch_rad: float
    yaw_rate_radps: float
    lift: float


@dataclass(frozen=True)
class Sample:
    """State that the vehicle reported, at a moment of its own clock."""

    vehicle_ms: int
    received_s: float
    pos_m: Vector
    att_rad: Vector
    gyro_radps: Vector
    acc_mps2: Vector
    vbat_v: float
    info: int
    asked: Command
    asked_height_m: float

    @property
    def tilt_rad(self) -> float:
        """The angle between the vehicle's axis and the vertical."""
        return math.acos(max(-1.0, min(1.0, math.cos(self.att_rad[0]) * math.cos(self.att_rad[1]))))


@dataclass(frozen=True)
class Fix:
    """A position as the controller sees it: with its age on the vehicle's clock, and whether it is a new one.

    `silence_s` is the time since the last one came, on this machine's clock: nothing else ages when nothing comes.
    """

    pos_m: Vector
    yaw_rad: float
    age_s: float
    is_new: bool
    silence_s: float
