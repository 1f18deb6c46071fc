"""Reads the vehicle during a flight: every sample goes to the log with a fix and the command in force."""

from __future__ import annotations

import time
from collections import deque

from crazyflie_gym.deploy.poses import PoseFeed
from crazyflie_gym.deploy.record import Recorder, Sent
from crazyflie_gym.deploy.settings import DeployError
from crazyflie_gym.deploy.state import Command, Fix, Sample, Setpoint
from crazyflie_gym.deploy.vehicle import Vehicle

LAST, LEAST_PWM, LEAST_M = 10, 1000.0, 0.05
"""So many commands in a row that ask for more than nothing; the firmware takes fewer counts for none."""
KEPT = 50
"""Commands of the last second, of which the vehicle may still obey one."""
SAME_RAD, SAME_PWM, SAME_M = 1e-4, 1.0, 1e-3
"""Roundings of the numbers that the vehicle tells back."""


class Positions:
    """The vehicle's position: by its own estimate, or by poses from outside."""

    def __init__(self, vehicle: Vehicle, feed: PoseFeed | None) -> None:
        self._vehicle, self._feed = vehicle, feed
        self._count, self._captured_s = 0, 0.0

    def fix(self, sample: Sample, late_s: float = 0.0) -> Fix:
        """Return the newest position, `late_s` after a sample that is still the newest.

        Raises:
            DeployError: if no pose has come yet.
        """
        speed, now_s, feed = self._vehicle.speed, time.monotonic(), self._feed
        if feed is None:
            silence_s = (now_s - sample.received_s) * speed
            return Fix(sample.pos_m, sample.att_rad[2], late_s, True, silence_s)
        pose, count = feed.newest, feed.count
        if pose is None:
            raise DeployError("no pose has come")
        silence_s = max(0.0, now_s - pose.captured_s) * speed
        clock_s = sample.vehicle_ms / 1000 + late_s
        is_new = count > self._count
        if is_new:
            # from here on it ages by the vehicle's clock, on which controllers tell a new one by its age
            self._count, self._captured_s = count, clock_s - silence_s
        yaw_rad = sample.att_rad[2] if pose.yaw_rad is None else pose.yaw_rad
        return Fix(pose.pos_m, yaw_rad, max(0.0, clock_s - self._captured_s), is_new, silence_s)


class Logbook:
    """Reads the vehicle, and writes each of its samples."""

    def __init__(self, vehicle: Vehicle, positions: Positions, recorder: Recorder, is_height: bool) -> None:
        self._vehicle, self._positions, self._recorder, self._is_height = vehicle, positions, recorder, is_height
        self._commands: deque[Command] = deque(maxlen=KEPT)
        self._sent: Sent | None = None
        self.setpoint: Setpoint = (0.0, 0.0, 0.0, 0.0)

    def begin(self) -> None:
        """Forget what came before the flight."""
        self._vehicle.next_samples(0.0)

    def send(self, command: Command) -> None:
        """Send a command, and remember it as it was sent."""
        sent = (self._vehicle.command_height if self._is_height else self._vehicle.command_thrust)(command)
        self._commands.append(sent)
        self._sent = Sent(sent, time.time())

    @property
    def has_lift(self) -> bool:
        """Return whether the last commands all have some lift."""
        least = LEAST_M if self._is_height else LEAST_PWM
        last = list(self._commands)[-LAST:]
        return len(last) == LAST and all(command.lift > least for command in last)

    def read(self, timeout_s: float) -> Sample | None:
        """Return the newest sample, if one comes in time. All that came are written."""
        samples = self._vehicle.next_samples(timeout_s)
        unix_s = time.time() - time.monotonic()
        for sample in samples:
            fix = self._positions.fix(sample)
            command = self._in_force(sample)
            self._recorder.add(sample, command, self.setpoint, fix, unix_s + sample.received_s, self._sent)
            self._sent = None
        return samples[-1] if samples else None

    def _in_force(self, sample: Sample) -> Command:
        """Return the command that the vehicle obeys: of those that were sent the one that it tells back."""
        asked = sample.asked
        if self._is_height:
            asked = Command(asked.roll_rad, asked.pitch_rad, asked.yaw_rate_radps, sample.asked_height_m)
        for sent in reversed(self._commands):
            if (
                abs(sent.roll_rad - asked.roll_rad) < SAME_RAD
                and abs(sent.pitch_rad - asked.pitch_rad) < SAME_RAD
                and abs(sent.lift - asked.lift) < (SAME_M if self._is_height else SAME_PWM)
            ):
                return sent
        return asked
