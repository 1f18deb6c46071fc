"""Why a flight ends: soft limits, and what is wrong with the vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from crazyflie_gym.deploy.settings import Settings
from crazyflie_gym.deploy.state import Sample, Vector
from crazyflie_gym.deploy.vehicle import IS_CRASHED, IS_LOCKED, IS_TUMBLED

LOW_S = 0.5
"""Longest time of the battery below its limit: a climb lowers the voltage for a moment."""


@dataclass(frozen=True)
class Ending:
    """A reason to end a flight. `is_fine`: it was meant to; `stops`: motors are of no use any more."""

    reason: str
    detail: str
    is_fine: bool = False
    stops: bool = False
    is_blind: bool = False


@dataclass
class Limits:
    """The soft limits of a flight that began at `began_ms` of the vehicle's clock."""

    settings: Settings
    began_ms: int
    _low_since_ms: int | None = field(default=None, init=False)

    def ending(self, sample: Sample, pos_m: Vector) -> Ending | None:
        """Return what a vehicle that is there has come up against."""
        s = self.settings
        for bit, word in ((IS_LOCKED, "locked"), (IS_CRASHED, "crashed"), (IS_TUMBLED, "tumbled")):
            if sample.info & bit:
                return Ending("supervisor", f"the vehicle says that it is {word}", stops=True)
        if not all(math.isfinite(number) for number in (*pos_m, *sample.att_rad)):
            return Ending("position", f"the position is {pos_m}", is_blind=True)
        for axis, value, limit in zip("xy", pos_m, s.room_m, strict=False):
            if abs(value) > limit:
                return Ending("room", f"{axis} is {value:.2f} m, the limit {limit:g} m")
        if pos_m[2] > s.room_m[2]:
            return Ending("room", f"z is {pos_m[2]:.2f} m, the limit {s.room_m[2]:g} m")
        tilt_deg = math.degrees(sample.tilt_rad)
        if tilt_deg > s.tilt_max_deg:
            return Ending("tilt", f"the tilt is {tilt_deg:.0f} deg, the limit {s.tilt_max_deg:g} deg")
        time_s = (sample.vehicle_ms - self.began_ms) / 1000
        if time_s > s.time_limit_s:
            return Ending("time", f"it flies for {time_s:.1f} s, the limit is {s.time_limit_s:g} s")
        return self._battery(sample)

    def _battery(self, sample: Sample) -> Ending | None:
        if sample.vbat_v >= self.settings.battery_min_v:
            self._low_since_ms = None
            return None
        if self._low_since_ms is None:
            self._low_since_ms = sample.vehicle_ms
        if sample.vehicle_ms - self._low_since_ms < 1000 * LOW_S:
            return None
        volts, limit = sample.vbat_v, self.settings.battery_min_v
        return Ending("battery", f"the battery is at {volts:.2f} V, the limit {limit:g} V")
