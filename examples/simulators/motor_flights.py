"""Real flights whose motors are known, from crazyswarm2-tools (IMRCLab, MIT): a Crazyflie 2.1 with two sets of motors.

- Logs hold the force and the torques that a Lee controller commanded, 250 times a second. The firmware's mixer makes
  four motor forces of them; nothing tells what the motors gave.
- States are the vehicle's own estimate, which motion capture corrects; body rates are the gyro's.
- Torques get one trim per flight and simulator: its body rates 0.1 s ahead are right on average (`trimmed`).
- Forces are multiples of the weight: over the second before a prediction they gave the mean measured acceleration.
- A flight begins after the last gap in its log, and 2 s after it has left the floor.

The logs with a hung load are left out, and 28, which crashes.
"""

from __future__ import annotations

import dataclasses
import struct
import zlib
from pathlib import Path

import numpy as np
from adapters import Simulator
from real_flights import ATT, DT_S, ENDS_S, FLOOR_M, RATE, Flight, Start, mean_over, resample

FLIGHTS = {
    "stock": [f"log{number}" for number in range(146, 181, 2)],
    "upgraded": [f"log{number}" for number in (20, 24, 40, 44, 60, 76, 80, 88, 96, 100, 120)],
}
# every other flight is fitted
FIT = {motors: names[::2] for motors, names in FLIGHTS.items()}
TEST = {motors: names[1::2] for motors, names in FLIGHTS.items()}
# the flights last five seconds: three of them for the weight would leave no window
HOVER_S = 1.0
GAP_S = 0.03
# the firmware's: from the centre to the line between two motors, and torque over thrust (platform_defaults_cf2.h)
SIDE_M, YAW_LEVER_M = 0.046 * 0.5**0.5, 0.005964552
# roll, pitch and yaw that the thrusts of motors 1 to 4 give
SIGNS = np.array([[-1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])


def read_micro_sd(path: Path) -> np.ndarray:
    """Return the rows of a micro-SD log of one event as a structured array, `t` in microseconds.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is another file, or damaged.
    """
    data = path.read_bytes()
    if zlib.crc32(data[:-4]).to_bytes(4, "little") != data[-4:]:
        raise ValueError(f"{path}: the checksum is wrong: damaged, or no micro-SD log")
    if data[:1] != b"\xbc" or struct.unpack_from("<HHH", data, 1) != (2, 1, 0xFFFF):
        raise ValueError(f"{path}: no micro-SD log of one event")
    rest = data[7:].partition(b"\0")[2]
    (count,) = struct.unpack_from("<H", rest)
    *names, rows = rest[2:].split(b"\0", count)
    kinds = {"h": "<i2", "f": "<f4"}
    fields = [(text[:-3], kinds[text[-2]]) for text in (name.decode() for name in names)]
    # an event's number before each row, and a checksum after all
    return np.frombuffer(rows[:-4], np.dtype([("event", "<u2"), ("t", "<u8"), *fields]))


def columns(rows: np.ndarray, *names: str) -> np.ndarray:
    """Return columns (n, k) of a log; those in mm and mm/s become m and m/s."""
    return np.stack([rows[name] * (1e-3 if rows[name].dtype.kind == "i" else 1.0) for name in names], -1)


def read_motor_flight(path: Path) -> Flight:
    """Return a recording as the head of this module says: commands are the forces of the four motors.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is no such log, or damaged.
    """
    rows = read_micro_sd(path)
    time_s = rows["t"] * 1e-6
    thrust = [name for name in rows.dtype.names if name.lower() == "ctrllee.thrustsi"]
    sources = ("stateEstimateZ.", "stateEstimateZ.v", "ctrlLee.rpy", "ctrlLee.omega")
    state = columns(rows, *(source + axis for source in sources for axis in "xyz"))
    state[:, ATT] = np.unwrap(state[:, ATT], axis=0)
    wrench = columns(rows, *thrust, *(f"ctrlLee.torque{axis}" for axis in "xyz"))

    gaps = np.flatnonzero(np.diff(time_s) > GAP_S)
    flies = np.flatnonzero(state[:, 2] > FLOOR_M)
    begin_s = np.append(time_s[gaps + 1], time_s[flies[0]] + ENDS_S * (flies[0] > 0)).max()
    grid_s = np.arange(begin_s, time_s[flies[-1]] - DT_S, DT_S)
    # a command holds for a step
    held = resample(grid_s + 0.5 * DT_S, time_s, mean_over(wrench, 3))
    forces = 0.25 * held @ np.concatenate([np.ones((4, 1)), SIGNS / [SIDE_M, SIDE_M, YAW_LEVER_M]], 1).T
    return Flight(path.name, resample(grid_s, time_s, state), forces, 4, HOVER_S)


def trimmed(simulator: Simulator, start: Start, command: np.ndarray, measured: np.ndarray) -> tuple[Start, np.ndarray]:
    """Return start and commands with the constant torque that a simulator's body rates lack 0.1 s ahead, on average.

    Neither log nor vehicle tells what unequal motors and an offset centre of mass add; the controller has found it.
    """
    rows, step = round(0.1 / DT_S), 1e-3

    def moved(torque: np.ndarray) -> tuple[Start, np.ndarray]:
        forces = SIGNS @ torque
        return dataclasses.replace(start, past_command=start.past_command + forces), command + forces

    def turned_radps(torque: np.ndarray) -> np.ndarray:
        first, forces = moved(torque)
        return simulator.predict(first, forces[:, :rows], DT_S)[:, rows, RATE].mean(0)

    level = turned_radps(np.zeros(3))
    slope = (turned_radps(np.full(3, step)) - level) / step
    lacking = measured[:, rows, RATE].mean(0) - level
    return moved(np.divide(lacking, slope, out=np.zeros(3), where=slope != 0.0))
