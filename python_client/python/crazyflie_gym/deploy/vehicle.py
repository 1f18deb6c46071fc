"""The vehicle at the other end of cflib: samples in, set-points out. Here, and only here, signs and units turn.

The firmware's pitch is positive nose up in logs and in `send_zdistance_setpoint`; the project's is positive nose down,
which is the direction of `send_setpoint`. Yaw rates of `send_setpoint` have the vehicle's own sign, as the model's
command; all others are right-handed.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from crazyflie_gym.deploy.poses import Pose
from crazyflie_gym.deploy.settings import DeployError
from crazyflie_gym.deploy.state import Command, Sample

INSTALL = 'deploy needs cflib: pip install "crazyflie-gym[cflib]"'
STANDARD_GRAVITY_MPS2 = 9.81
"""The firmware's g (`GRAVITY_MAGNITUDE`)."""
CONNECT_S = 15.0
KIND_S, VERSION_CHANNEL, GET_KIND = 1.0, 1, 2
"""Patience for the platform's name, and its channel and request in the firmware (platformservice.c)."""
CLOCK_MS = 1 << 24
"""Stamps of log blocks have 24 bits."""
MAX_THRUST_PWM = 65535
IS_ARMED, CAN_FLY, IS_TUMBLED, IS_LOCKED, IS_CRASHED = 1 << 1, 1 << 3, 1 << 5, 1 << 6, 1 << 7
"""Bits of `supervisor.info`."""
REPEATS, REPEAT_S = 4, 0.005
"""Times that an important packet is sent: with one of ten packets lost, one of ten thousand is lost then."""
SETTLED_M2PS2 = 1e-3
"""A filter's velocity variances that change by less over a second have settled, as scripts of cflib ask."""

# the block that makes a sample comes last
BLOCKS = {
    "asked": ("controller.roll", "controller.pitch", "controller.yawRate", "controller.cmd_thrust", "ctrltarget.z"),
    "motion": ("gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z"),
    "pose": tuple(f"stateEstimate.{name}" for name in ("x", "y", "z", "roll", "pitch", "yaw")),
}
FIRMWARE = "firmware.revision0"
"""Parameter with the first part of the revision: 0 of a vehicle of `crazyflie cf2`."""
SAMPLE_MS = 10
"""Period of log blocks, short enough to show when a command takes effect."""
SLOW_MS = 100
SLOW_BLOCKS = {
    "health": ("pm.vbat", "supervisor.info"),
    "spread": ("kalman.varPX", "kalman.varPY", "kalman.varPZ"),
}


class Vehicle:
    """A connected Crazyflie.

    Args:
        uri: address as cflib takes it.
        yaw_sign: direction in which a positive yaw-rate command turns, right-handed: +1 or -1.

    Raises:
        DeployError: if cflib is missing, nothing answers, or a log variable is unknown to the vehicle.
    """

    def __init__(self, uri: str, yaw_sign: float) -> None:
        self._yaw_sign = yaw_sign
        self._arrived = threading.Condition()
        self._values: dict[str, dict[str, float]] = {}
        self._spreads: deque[tuple[float, ...]] = deque(maxlen=10)
        self.newest: Sample | None = None
        self._samples: deque[Sample] = deque(maxlen=1000)
        self.speed = 1.0
        self.problem = ""
        self._cf = _connected(uri, self._lost)
        self.kind = _kind(self._cf)
        self.firmware_revision = int(self._cf.param.get_value(FIRMWARE))
        try:
            self._start_logs()
        except KeyError as error:
            self.close()
            raise DeployError(f"{uri}: the vehicle has no such log variable: {error.args[0]}") from None

    def _lost(self, uri: str, message: str) -> None:
        self.problem = self.problem or f"the link to {uri} was lost: {message}"
        with self._arrived:
            self._arrived.notify_all()

    def _start_logs(self) -> None:
        from cflib.crazyflie.log import LogConfig

        blocks = [*((b, SLOW_MS) for b in SLOW_BLOCKS.items()), *((b, SAMPLE_MS) for b in BLOCKS.items())]
        for (name, variables), every_ms in blocks:
            config = LogConfig(name, every_ms)
            for variable in variables:
                config.add_variable(variable)
            self._cf.log.add_config(config)
            config.data_received_cb.add_callback(self._take)
            config.start()

    def _take(self, stamp_ms: int, values: dict[str, float], config: Any) -> None:
        self._values[config.name] = values
        if config.name == "spread":
            self._spreads.append(tuple(values.values()))
        if config.name == "pose" and {"asked", "motion", "health"} <= self._values.keys():
            with self._arrived:
                self.newest = self._sample(stamp_ms)
                self._samples.append(self.newest)
                self._arrived.notify_all()

    def _sample(self, stamp_ms: int) -> Sample:
        before_ms = self.newest.vehicle_ms if self.newest else stamp_ms
        vehicle_ms = before_ms + (stamp_ms - before_ms) % CLOCK_MS
        pose, motion, asked = (self._values[name] for name in ("pose", "motion", "asked"))
        x, y, z, roll, pitch, yaw = (pose[name] for name in BLOCKS["pose"])
        gyro = [math.radians(motion[name]) for name in BLOCKS["motion"][:3]]
        acc = [STANDARD_GRAVITY_MPS2 * motion[name] for name in BLOCKS["motion"][3:]]
        a_roll, a_pitch, a_yaw_rate, thrust, height = (asked[name] for name in BLOCKS["asked"])
        command = Command(
            math.radians(a_roll), -math.radians(a_pitch), self._yaw_sign * math.radians(a_yaw_rate), thrust
        )
        health = self._values["health"]
        return Sample(
            vehicle_ms=vehicle_ms,
            received_s=time.monotonic(),
            pos_m=(x, y, z),
            att_rad=(math.radians(roll), -math.radians(pitch), math.radians(yaw)),
            gyro_radps=(gyro[0], gyro[1], gyro[2]),
            acc_mps2=(acc[0], acc[1], acc[2]),
            vbat_v=health["pm.vbat"],
            info=int(health["supervisor.info"]),
            asked=command,
            asked_height_m=height,
        )

    def next_sample(self, after_ms: int, timeout_s: float) -> Sample | None:
        """Return the newest sample once there is one after that moment; None if none comes in time."""

        def is_newer() -> bool:
            return self.newest is not None and self.newest.vehicle_ms > after_ms

        with self._arrived:
            self._arrived.wait_for(is_newer, timeout_s / self.speed)
        return self.newest if is_newer() else None

    def next_samples(self, timeout_s: float) -> list[Sample]:
        """Return the samples since the last call, once there is one; none if none comes in time."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._samples), timeout_s / self.speed)
            samples = list(self._samples)
            self._samples.clear()
        return samples

    def measure_speed(self, samples: int = 100) -> None:
        """Find how fast the vehicle's clock runs on this machine's: 1, or as a simulation was told."""
        first = self.next_sample(-1, 5.0)
        if first is None:
            raise DeployError(f"the vehicle sends no logs (lock-step needs lockstep=True) {self.problem}".rstrip())
        last = first
        for _ in range(samples):
            sample = self.next_sample(last.vehicle_ms, 1.0)
            if sample is None:
                raise DeployError(f"the vehicle's logs stop {self.problem}".rstrip())
            last = sample
        speed = (last.vehicle_ms - first.vehicle_ms) / 1000 / max(last.received_s - first.received_s, 1e-6)
        self.speed = speed if abs(speed - 1.0) > 0.1 else 1.0

    def is_settled(self) -> bool:
        """Return whether the variances of the vehicle's filter have settled."""
        spreads = list(self._spreads)
        return len(spreads) == self._spreads.maxlen and all(
            max(axis) - min(axis) < SETTLED_M2PS2 for axis in zip(*spreads, strict=True)
        )

    def reset_estimator(self) -> None:
        """Let the vehicle's filter begin anew."""
        self._cf.param.set_value("kalman.resetEstimation", "1")
        time.sleep(0.1)
        self._cf.param.set_value("kalman.resetEstimation", "0")
        self._spreads.clear()

    def arm(self, on: bool) -> None:
        """Ask for motors that may turn, or may not."""
        # older releases of cflib have no supervisor
        service = getattr(self._cf, "supervisor", None) or self._cf.platform
        self._send(service.send_arming_request, on)

    def unlock_thrust(self) -> None:
        """Send the thrust of nothing without which no thrust is obeyed, and give the high-level commander way."""
        for _ in range(REPEATS):
            self._send(self._cf.commander.send_setpoint, 0.0, 0.0, 0.0, 0)
            time.sleep(REPEAT_S)
        self.give_way()

    def give_way(self) -> None:
        """Let the vehicle's own commander follow on set-points."""
        for _ in range(REPEATS):
            self._send(self._cf.commander.send_notify_setpoint_stop)
            time.sleep(REPEAT_S)

    def take_off(self, height_m: float, seconds: float) -> None:
        """Let the vehicle's own commander take off."""
        self._send(self._cf.high_level_commander.takeoff, height_m, seconds)

    def land(self, height_m: float, seconds: float) -> None:
        """Let the vehicle's own commander land."""
        self.give_way()
        self._send(self._cf.high_level_commander.land, height_m, seconds)

    def stop(self) -> None:
        """Stop the motors."""
        self._send(self._cf.commander.send_stop_setpoint)

    def command_thrust(self, command: Command) -> Command:
        """Send roll, pitch, yaw rate and a thrust; return them as they were sent."""
        thrust = min(max(round(command.lift), 0), MAX_THRUST_PWM)
        degrees = (math.degrees(a) for a in (command.roll_rad, command.pitch_rad, command.yaw_rate_radps))
        self._send(self._cf.commander.send_setpoint, *degrees, thrust)
        return Command(command.roll_rad, command.pitch_rad, command.yaw_rate_radps, float(thrust))

    def command_height(self, command: Command) -> Command:
        """Send roll, pitch, yaw rate and a height, which the vehicle holds itself; return them."""
        roll, pitch, turn = command.roll_rad, -command.pitch_rad, self._yaw_sign * command.yaw_rate_radps
        degrees = (math.degrees(a) for a in (roll, pitch, turn))
        self._send(self._cf.commander.send_zdistance_setpoint, *degrees, command.lift)
        return command

    def send_pose(self, pose: Pose) -> None:
        """Tell the vehicle's filter where it is."""
        if pose.quat_xyzw is None:
            self._send(self._cf.extpos.send_extpos, *pose.pos_m)
        else:
            self._send(self._cf.extpos.send_extpose, *pose.pos_m, *pose.quat_xyzw)

    def _send(self, send: Callable[..., None], *values: Any) -> None:
        try:
            send(*values)
        except Exception as error:
            # a link that is gone: the flight ends by what it no longer hears
            self.problem = self.problem or f"nothing can be sent: {error}"

    def close(self) -> None:
        """Say goodbye: cflib stops the motors with it."""
        with contextlib.suppress(Exception):
            self._cf.close_link()


def _kind(cf: Any) -> str:
    """Return what a vehicle calls itself: its platform, or a simulated one its model; "" if it does not answer."""
    from cflib.crtp.crtpstack import CRTPPacket, CRTPPort

    kinds: list[str] = []
    answered = threading.Event()

    def take(packet: Any) -> None:
        if packet.channel == VERSION_CHANNEL and packet.data[:1] == bytes([GET_KIND]):
            kinds.append(bytes(packet.data[1:]).rstrip(b"\0").decode(errors="replace"))
            answered.set()

    cf.add_port_callback(CRTPPort.PLATFORM, take)
    packet = CRTPPacket()
    packet.set_header(CRTPPort.PLATFORM, VERSION_CHANNEL)
    packet.data = (GET_KIND,)
    cf.send_packet(packet)
    answered.wait(KIND_S)
    cf.remove_port_callback(CRTPPort.PLATFORM, take)
    return kinds[0] if kinds else ""


def _connected(uri: str, lost: Callable[[str, str], None]) -> Any:
    """Return a Crazyflie whose tables and parameters are known."""
    try:
        import cflib.crtp
        from cflib.crazyflie import Crazyflie
    except ModuleNotFoundError as error:
        raise DeployError(f"{INSTALL} ({error})") from None
    # cflib reports its errors by callbacks, so its log is not needed
    logging.getLogger("cflib").addHandler(logging.NullHandler())
    cflib.crtp.init_drivers()
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    cf = Crazyflie(rw_cache=str(caches / "crazyflie-gym" / "cflib"))
    ready, failed = threading.Event(), []

    def fail(_uri: str, message: str) -> None:
        failed.append(message)
        ready.set()

    cf.fully_connected.add_callback(lambda _uri: ready.set())
    cf.connection_failed.add_callback(fail)
    cf.connection_lost.add_callback(fail)
    cf.connection_lost.add_callback(lost)
    cf.open_link(uri)
    answered = ready.wait(CONNECT_S)
    if failed or not answered:
        with contextlib.suppress(Exception):
            cf.close_link()
        # the driver's own traceback comes behind an empty line
        reason = (
            failed[0].strip().split("\n\n")[0].replace("\n", ": ")
            if failed
            else f"nothing answers within {CONNECT_S:.0f} s"
        )
        raise DeployError(f"{uri}: {reason}")
    return cf
