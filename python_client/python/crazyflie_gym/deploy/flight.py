"""A flight: check, take-off, the controller's task, landing. Every state ends in a landing or a reason."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable
from typing import Any

from crazyflie_gym.deploy.keys import Keys
from crazyflie_gym.deploy.limits import Ending, Limits
from crazyflie_gym.deploy.logbook import Logbook, Positions
from crazyflie_gym.deploy.pilot import Pilot
from crazyflie_gym.deploy.poses import PoseFeed
from crazyflie_gym.deploy.record import Recorder
from crazyflie_gym.deploy.settings import DeployError, Settings
from crazyflie_gym.deploy.state import Command, Fix, Sample
from crazyflie_gym.deploy.vehicle import CAN_FLY, IS_ARMED, Vehicle

LATE = 1.5
"""Ticks after which a sample counts as lost."""
SETTLE_S = 15.0
LEVEL_S = 0.5
"""Time that a vehicle with a stale position is kept level before it goes down."""
TAKEOFF_MPS = 0.4
REACHED_M, STILL_S, PATIENCE_S = 0.05, 0.5, 4.0
"""A take-off is over this near to its height, for so long; and longer than planned by the last, it has failed."""
LAND_MPS = 0.25
FALL_S = 1.0
BLIND_MPS = 0.3
GROUND_M = 0.08
HOLD_S, DEAF_S = 0.1, 0.2
"""Time of constant height before the controller begins, and longest time without an answer to a thrust."""
LEAST_POSES = 10

Report = Callable[[str], None]


class Flight:
    """One flight of a controller on a vehicle, from the check to the landing.

    Args:
        settings: what is flown.
        pilot: the controller.
        vehicle: connected.
        keys: who may want to land.
        report: told of every state; it never raises.
        recorder: writes the log.
        is_ready: told of a stage that is reached, until it answers that all vehicles have reached it.
    """

    def __init__(
        self,
        settings: Settings,
        pilot: Pilot,
        vehicle: Vehicle,
        keys: Keys,
        report: Report,
        recorder: Recorder,
        is_ready: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self._is_ready = is_ready
        self._settings, self._pilot, self._vehicle, self._keys = settings, pilot, vehicle, keys
        self._report, self._recorder = report, recorder
        self._feed: PoseFeed | None = None
        self._positions = Positions(vehicle, None)
        self._log = Logbook(vehicle, self._positions, recorder, pilot.is_height)
        self.summary: dict[str, Any] = {"states": {}, "missed": 0, "levelled": 0}
        self._square_m2, self._worst_m, self._flown, self._ticks = 0.0, 0.0, 0, 0
        self._heard_ms = 0

    def fly(self) -> Ending:
        """Fly, and return why it ended.

        Raises:
            DeployError: if the vehicle is not fit to fly: nothing has left the ground then.
        """
        try:
            first = self._check()
            self._wait(lambda: self._is_ready("check"), lambda: "another vehicle is not fit to fly")
            ending = self._fly_task(first)
            self._report(f"landing: {ending.reason}: {ending.detail}")
            self.summary["landed"] = self._land(ending, first.pos_m[2])
            return ending
        finally:
            if self._feed is not None:
                self._feed.close()
            self.summary |= self._figures()

    def _fly_task(self, first: Sample) -> Ending:
        """Take off and let the controller fly. A landing follows every error in here."""
        try:
            return self._take_off(first) or self._hand_over()
        except Exception as error:
            self._report(traceback.format_exc().rstrip())
            return Ending("error", f"{type(error).__name__}: {error}")

    def _figures(self) -> dict[str, Any]:
        flown = max(self._flown, 1)
        return {
            "flown_s": self._ticks * self._pilot.tick_s,
            "rmse_m": math.sqrt(self._square_m2 / flown),
            "worst_m": self._worst_m,
            "rows": self._recorder.rows,
            "speed": self._vehicle.speed,
        }

    def _report_state(self, name: str, sample: Sample) -> None:
        self.summary["states"][name] = sample.vehicle_ms / 1000
        x, y, z = sample.pos_m
        self._report(f"{name}: at {x:.2f} {y:.2f} {z:.2f} m, battery {sample.vbat_v:.2f} V")

    def _check(self) -> Sample:
        vehicle, settings = self._vehicle, self._settings
        vehicle.measure_speed()
        if settings.position != "estimate":
            self._feed = PoseFeed(settings.poses, vehicle.send_pose)
            self._positions = Positions(vehicle, self._feed)
            self._log = Logbook(vehicle, self._positions, self._recorder, self._pilot.is_height)
            if self._feed.address:
                self._report(f"poses: waiting at {self._feed.address}")
            self._wait(lambda: self._feed is not None and self._feed.count >= LEAST_POSES, self._no_poses)
        vehicle.reset_estimator()
        self._wait(vehicle.is_settled, lambda: "the vehicle's filter does not settle: has it a position?")
        sample = self._newest()
        if sample.vbat_v < settings.battery_min_v:
            raise DeployError(f"check: the battery is at {sample.vbat_v:.2f} V, the limit {settings.battery_min_v:g} V")
        seen = self._positions.fix(sample).pos_m
        ending = Limits(settings, sample.vehicle_ms).ending(sample, seen)
        if ending is not None:
            raise DeployError(f"check: {ending.reason}: {ending.detail}")
        if not sample.info & IS_ARMED:
            vehicle.arm(True)
        self._wait(lambda: bool(self._newest().info & CAN_FLY), lambda: "the vehicle does not let itself be armed")
        self._report_state("check", self._newest())
        return self._newest()

    def _no_poses(self) -> str:
        feed = self._feed
        told = f" ({feed.refused} messages refused, {feed.problem})" if feed is not None and feed.problem else ""
        return f"no poses come from {self._settings.poses}{told}"

    def _newest(self) -> Sample:
        sample = self._vehicle.newest
        if sample is None:
            raise DeployError("the vehicle sends no logs")
        return sample

    def _wait(self, condition: Callable[[], bool], problem: Callable[[], str]) -> None:
        end = time.monotonic() + max(SETTLE_S / self._vehicle.speed, 2.0)
        while not condition():
            if self._vehicle.problem:
                raise DeployError(f"check: {self._vehicle.problem}")
            if self._keys.presses:
                raise DeployError(f"check: ended by {self._keys.name}, nothing has left the ground")
            if time.monotonic() > end:
                raise DeployError(f"check: {problem()}")
            time.sleep(0.01)

    def _take_off(self, first: Sample) -> Ending | None:
        settings, vehicle = self._settings, self._vehicle
        limits = Limits(settings, first.vehicle_ms)
        self._limits = limits
        ground_m, height_m = first.pos_m[2], settings.takeoff_height_m
        seconds = max(1.5, height_m / TAKEOFF_MPS)
        vehicle.unlock_thrust()
        vehicle.take_off(ground_m + height_m, seconds)
        self._report_state("take-off", first)
        goal = self._log.setpoint = (first.pos_m[0], first.pos_m[1], ground_m + height_m, first.att_rad[2])
        self._log.begin()
        reached_s = math.inf
        while True:
            sample = self._log.read(settings.stale_s)
            if sample is None:
                return Ending("stale", self._silence(), is_blind=True)
            time_s = (sample.vehicle_ms - first.vehicle_ms) / 1000
            fix = self._positions.fix(sample)
            if self._keys.presses:
                return Ending("key", f"ended by {self._keys.name} in the take-off", is_fine=True)
            if fix.silence_s > settings.stale_s + LEVEL_S:
                return Ending("stale", f"the position is {fix.silence_s:.2f} s old", is_blind=True)
            ending = limits.ending(sample, fix.pos_m)
            if ending is not None:
                return ending
            reached_s = min(reached_s, time_s) if abs(fix.pos_m[2] - goal[2]) < REACHED_M else math.inf
            if time_s > max(seconds, reached_s + STILL_S):
                return None
            if time_s > seconds + PATIENCE_S:
                return Ending("takeoff", f"at {fix.pos_m[2]:.2f} m after {time_s:.1f} s, expected {goal[2]:.2f} m")

    def _silence(self) -> str:
        return self._vehicle.problem or "no logs come from the vehicle"

    def _hand_over(self) -> Ending:
        """Let the controller fly its task, and return why it does no longer."""
        pilot, tick_ms = self._pilot, round(1000 * self._pilot.tick_s)
        while not self._is_ready("take-off") and not self._keys.presses:
            self._log.read(self._settings.stale_s)
        sample = self._hold(self._newest())
        pilot.begin(sample.pos_m[2])
        self._heard_ms = sample.vehicle_ms
        self._report_state("controller", sample)
        start_ms, tick, told_s = sample.vehicle_ms, -1, 0.0
        fresh: Sample | None = sample
        while True:
            late_s = 0.0
            if fresh is None:
                # the controller goes on with what it knows; what comes late belongs to this tick
                tick += 1
                late_s = tick * pilot.tick_s - (sample.vehicle_ms - start_ms) / 1000
                self.summary["missed"] += 1
            else:
                sample = fresh
                now = (sample.vehicle_ms - start_ms) // tick_ms
                self.summary["missed"] += max(0, now - tick - 1)
            if fresh is None or now > tick:
                tick = tick if fresh is None else now
                ending = self._tick(sample, tick, late_s)
                if ending is not None:
                    return ending
            if tick * pilot.tick_s >= told_s + 5.0:
                told_s = tick * pilot.tick_s
                self._report(f"controller: {told_s:.0f} s, {self._settings.duration_s - told_s:.0f} s to go")
            fresh = self._log.read(LATE * pilot.tick_s)

    def _hold(self, sample: Sample) -> Sample:
        """Hold the height for a moment: a thrust is obeyed only where another set-point is in force before."""
        held = Command(0.0, 0.0, 0.0, sample.pos_m[2])
        end_ms = sample.vehicle_ms + 1000 * HOLD_S
        while sample.vehicle_ms < end_ms:
            self._vehicle.command_height(held)
            fresh = self._log.read(self._settings.stale_s)
            if fresh is None:
                # the ticks that follow react to a missing sample
                break
            sample = fresh
        return sample

    def _tick(self, sample: Sample, tick: int, late_s: float) -> Ending | None:
        pilot, settings = self._pilot, self._settings
        if tick >= pilot.ticks:
            return Ending("done", f"the task is over after {settings.duration_s:g} s", is_fine=True)
        if self._keys.presses:
            return Ending("key", f"ended by {self._keys.name}", is_fine=True)
        fix = self._positions.fix(sample, late_s)
        ending = self._limits.ending(sample, fix.pos_m)
        if ending is not None:
            return ending
        if self._is_deaf(sample):
            return Ending("thrust", f"no thrust is obeyed for {DEAF_S:g} s: is the vehicle's commander locked?")
        setpoint = self._log.setpoint = pilot.setpoint(tick)
        if fix.silence_s > settings.stale_s:
            return self._wait_level(sample, fix)
        try:
            command = pilot.command(sample, fix, setpoint, self._vehicle.speed)
        except ArithmeticError as error:
            return Ending("controller", str(error))
        except Exception as error:
            self._report(traceback.format_exc().rstrip())
            return Ending("controller", f"it raised {type(error).__name__}: {error}")
        self._log.send(command)
        self._ticks = tick + 1
        off_m = math.dist(fix.pos_m, setpoint[:3])
        self._square_m2 += off_m**2
        self._worst_m = max(self._worst_m, off_m)
        self._flown += 1
        return None

    def _is_deaf(self, sample: Sample) -> bool:
        """Return whether the motors are off although a thrust has been commanded for a while."""
        if sample.asked.lift > 0.0 or not self._log.has_lift:
            self._heard_ms = sample.vehicle_ms
        return sample.vehicle_ms - self._heard_ms > 1000 * DEAF_S

    def _wait_level(self, sample: Sample, fix: Fix) -> Ending | None:
        """Hold the vehicle level while its position is stale, but not for long."""
        limit_s = self._settings.stale_s
        self.summary["levelled"] += 1
        if fix.silence_s > limit_s + LEVEL_S:
            detail = self._vehicle.problem or f"the position is {fix.silence_s:.2f} s old"
            return Ending("stale", f"{detail}, the limit is {limit_s:g} s", is_blind=True)
        self._log.send(self._pilot.level(sample.pos_m[2]))
        return None

    def _land(self, ending: Ending, ground_m: float) -> bool:
        """Come down, and return whether the vehicle is on the ground as it should be."""
        vehicle, presses = self._vehicle, self._keys.presses
        sample = self._newest()
        self._report_state("landing", sample)
        try:
            if ending.is_blind:
                self._sink(sample, ground_m, presses)
            elif not ending.stops:
                self._descend(sample, ground_m, presses)
        except Exception:
            self._report(traceback.format_exc().rstrip())
            # the vehicle's own commander needs nobody here
            seconds = max(1.5, (sample.pos_m[2] - ground_m) / LAND_MPS)
            vehicle.land(ground_m, seconds)
            time.sleep(seconds / vehicle.speed)
        vehicle.stop()
        vehicle.arm(False)
        sample = self._touch_down(ground_m)
        self._report_state("end", sample)
        is_down = sample.pos_m[2] - ground_m < GROUND_M
        return is_down and not vehicle.problem and not ending.stops and "stopped" not in self.summary

    def _touch_down(self, ground_m: float) -> Sample:
        """Return the sample in which the vehicle is on the ground, or the last one before patience ends."""
        end_s = time.monotonic() + FALL_S / self._vehicle.speed
        while (sample := self._newest()).pos_m[2] - ground_m > 0.5 * GROUND_M and time.monotonic() < end_s:
            self._vehicle.next_sample(sample.vehicle_ms, 0.1)
        return sample

    def _descend(self, sample: Sample, ground_m: float, presses: int) -> None:
        """Let the vehicle's own commander land."""
        seconds = max(1.5, (sample.pos_m[2] - ground_m) / LAND_MPS)
        self._vehicle.land(ground_m, seconds)
        start = sample
        self._log.setpoint = (sample.pos_m[0], sample.pos_m[1], ground_m, sample.att_rad[2])
        while (sample.vehicle_ms - start.vehicle_ms) / 1000 < seconds + 2.0:
            fresh = self._log.read(self._settings.stale_s)
            if self._keys.presses > presses:
                self._report("motors off: a second key")
                self.summary["stopped"] = True
                return
            if fresh is None:
                self._report(f"landing blindly: {self._silence()}")
                self._sink(sample, ground_m, presses)
                return
            sample = fresh
            time_s = (sample.vehicle_ms - start.vehicle_ms) / 1000
            if time_s > seconds and (sample.asked.lift == 0.0 or sample.pos_m[2] - ground_m < 0.5 * GROUND_M):
                return

    def _sink(self, sample: Sample, ground_m: float, presses: int) -> None:
        """Go down level, by the vehicle's own height, until the place is known again. Nothing may answer."""
        speed, start_s = self._vehicle.speed, time.monotonic()
        while self._keys.presses <= presses:
            height_m = sample.pos_m[2] - BLIND_MPS * (time.monotonic() - start_s) * speed
            if height_m < ground_m - GROUND_M:
                return
            self._vehicle.command_height(Command(0.0, 0.0, 0.0, height_m))
            time.sleep(self._pilot.tick_s / speed)
            fresh = self._log.read(0.0)
            if fresh is not None and self._positions.fix(fresh).silence_s < self._settings.stale_s:
                self._report("the position is known again")
                self._descend(fresh, ground_m, presses)
                return
