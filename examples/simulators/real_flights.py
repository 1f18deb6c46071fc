"""Real flights as every simulator sees them: measured states, commands, and windows to predict.

NanoBench (Ullah and Baca 2026, arXiv 2603.09908): a Crazyflie 2.1 under motion capture, 100 rows a second. All that is
done to a flight is done here, without any simulator, so that it is the same for all of them:

- States are motion capture's alone: position, velocity, roll, pitch, yaw, body rates (a mean over 70 ms).
- The marker is tilted against the vehicle: one turn per flight makes the mean thrust point along the body's z axis.
- Onboard data are moved in time, once per flight, to where gyro and motion capture agree best.
- Commanded roll and pitch get one trim per flight: their means are those of the measured angles.
- Thrust is (mean motor PWM times battery voltage) to the power THRUST_POWER, as a multiple of the vehicle's weight:
  over the HOVER_S before a prediction the mean thrust gave the mean measured acceleration.
- Rows are left out near the floor, near the ends, and after the last radio packet, where the files are extrapolated.
"""

from __future__ import annotations

import argparse
import gzip
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# the split of the recordings; B9_trefoil_slow_rep12 (fit) and B9_trefoil_medium_rep10 (test) hold no roll and pitch
# commands, so there is nothing to drive a simulator with
FIT = [
    "B2_circle_fast_rep2",
    "B2_circle_medium_rep2",
    "B3_figure8_fast_rep1",
    "B3_figure8_medium_rep2",
    "B5_helix_medium_rep1",
    "B6_linear_ramp_rep2",
    "B7_oval_fast_rep2",
    "B8_star_fast_rep1",
    "B8_star_slow_rep1",
    "B9_trefoil_fast_rep14",
    "B10_lissajous_fast_rep1",
]
TEST = [
    "B2_circle_slow_rep2",
    "B3_figure8_slow_rep1",
    "B7_oval_fast_rep3",
    "B8_star_medium_rep1",
    "B9_trefoil_slow_rep15",
]

DT_S = 0.01
GRAVITY_MPS2 = 9.81
# both chosen on the flights of FIT: `python examples/simulators/choose.py`
THRUST_POWER = 1.5
HOVER_S = 3.0
FLOOR_M, ENDS_S = 0.4, 2.0
POS, VEL, ATT, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


def check_recordings(parser: argparse.ArgumentParser, folder: Path, files: Iterable[str]) -> None:
    """End a script, exit status 2, whose folder lacks recordings."""
    if missing := [name for name in files if not (folder / name).exists()]:
        parser.error(f"{folder}: expected recordings there, but it lacks {', '.join(missing)}")


@dataclass(frozen=True)
class Flight:
    """One flight on a clock of DT_S.

    Attributes:
        name: of the recording.
        state: (n, 12): position m, velocity m/s, roll, pitch, yaw rad, body rates rad/s.
        command: (n, 4): roll, pitch, yaw in rad, and thrust in any unit that is proportional to force; or the forces
            of motors 1 to 4 of the firmware in such a unit.
        forces: how many of the last columns of `command` are forces; their sum lifts.
        hover_s: how long before a prediction the weight is found.
    """

    name: str
    state: np.ndarray
    command: np.ndarray
    forces: int = 1
    hover_s: float = HOVER_S


@dataclass(frozen=True)
class Start:
    """What is known when a prediction begins, of W windows.

    Attributes:
        state: (W, 12), measured, as in `Flight`.
        past_state: (W, P, 12), the P rows before it.
        past_command: (W, P, 4), commands of these rows, forces as multiples of the weight.
    """

    state: np.ndarray
    past_state: np.ndarray
    past_command: np.ndarray


def rotation(att_rad: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) from body to world for roll, pitch, yaw (..., 3) in rad, turned as z, y, x."""
    (cr, cp, cy), (sr, sp, sy) = (np.moveaxis(f(att_rad), -1, 0) for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def angles(matrix: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw (..., 3) in rad of matrices (..., 3, 3): the inverse of `rotation`."""
    return np.stack(
        [
            np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2]),
            np.arcsin(np.clip(-matrix[..., 2, 0], -1.0, 1.0)),
            np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]),
        ],
        -1,
    )


def euler_rates(att_rad: np.ndarray, rate_radps: np.ndarray) -> np.ndarray:
    """Return the derivatives of roll, pitch, yaw, rad/s, for body rates; both (..., 3)."""
    roll, pitch, _ = np.moveaxis(att_rad, -1, 0)
    p, q, r = np.moveaxis(rate_radps, -1, 0)
    turn = np.sin(roll) * q + np.cos(roll) * r
    return np.stack([p + np.tan(pitch) * turn, np.cos(roll) * q - np.sin(roll) * r, turn / np.cos(pitch)], -1)


def body_rates(att_rad: np.ndarray, euler_radps: np.ndarray) -> np.ndarray:
    """Return body rates, rad/s, for the derivatives of roll, pitch, yaw: the inverse of `euler_rates`."""
    roll, pitch, _ = np.moveaxis(att_rad, -1, 0)
    dr, dp, dy = np.moveaxis(euler_radps, -1, 0)
    sideways = np.cos(pitch) * dy
    return np.stack(
        [
            dr - np.sin(pitch) * dy,
            np.cos(roll) * dp + np.sin(roll) * sideways,
            np.cos(roll) * sideways - np.sin(roll) * dp,
        ],
        -1,
    )


def read_flight(path: Path) -> Flight:
    """Return a NanoBench recording as the head of this module says.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it lacks a column, holds no commands of roll and pitch, or too little flight.
    """
    with gzip.open(path, "rt") as file:
        names = file.readline().strip().split(",")
        table = np.loadtxt(file, delimiter=",")
    column = dict(zip(names, table.T, strict=True))
    name = path.name.removesuffix(".csv.gz")
    wanted = {"t", "px", "vx", "roll", "wx_vicon", "imu_gyro_x", "motor_motor_m1", "pid_controller_roll", "pwr_pm_vbat"}
    if wanted - column.keys():
        raise ValueError(f"{path}: no column {', '.join(sorted(wanted - column.keys()))}")
    time_s = column["t"] - column["t"][0]
    onboard = {
        "gyro": np.stack([column[f"imu_gyro_{axis}"] for axis in "xyz"], -1),
        "pwm": np.stack([column[f"motor_motor_m{motor}"] for motor in (1, 2, 3, 4)], -1),
        # degrees; pitch is inverted in the firmware
        "tilt": np.radians(
            [1.0, -1.0, 1.0] * np.stack([column[f"pid_controller_{a}"] for a in ("roll", "pitch", "yaw")], -1)
        ),
        "volt": column["pwr_pm_vbat"][:, np.newaxis],
    }
    if np.ptp(onboard["tilt"][:, :2]) == 0.0:
        raise ValueError(f"{path}: no commands of roll and pitch")
    # between packets the files are linear: after the last kink nothing is real
    last_s = min(time_s[np.flatnonzero(np.abs(np.diff(rows[:, 0], 2)) > 1e-6)[-1] + 1] for rows in onboard.values())
    grid_s = np.arange(0.0, min(last_s, time_s[-1]) - 0.1, DT_S)
    every = {key: resample(grid_s, time_s, rows) for key, rows in onboard.items()}
    pos_m, vel_mps, rate_radps = (
        resample(grid_s, time_s, np.stack([column[key] for key in keys.split()], -1))
        for keys in ("px py pz", "vx vy vz", "wx_vicon wy_vicon wz_vicon")
    )
    att_rad = resample(grid_s, time_s, np.unwrap([column[key] for key in ("roll", "pitch", "yaw")]).T)
    rate_radps = mean_over(rate_radps, 7)
    late_s = _lateness(rate_radps, every["gyro"])
    moved = {key: resample(grid_s + late_s, time_s, rows) for key, rows in onboard.items()}

    flies = np.flatnonzero(pos_m[:, 2] > FLOOR_M)
    ends = round(ENDS_S / DT_S)
    part = slice(flies[0] + ends, flies[-1] - ends)
    if part.stop - part.start < (HOVER_S + 3.0) / DT_S:
        raise ValueError(f"{path}: flies for {max(0, part.stop - part.start) * DT_S:.1f} s, too short")
    body = rotation(att_rad)
    force = np.gradient(vel_mps, DT_S, axis=0) + np.array([0.0, 0.0, GRAVITY_MPS2])
    mean = np.einsum("nji,nj->i", body[part], force[part])
    tilt = _turn_to(mean / np.linalg.norm(mean))
    state = np.concatenate([pos_m, vel_mps, angles(body @ tilt), rate_radps @ tilt], -1)[part]
    commanded = moved["tilt"][part]
    commanded = commanded - (commanded - state[:, ATT]).mean(0) * [1.0, 1.0, 0.0]
    thrust = (moved["pwm"].mean(-1, keepdims=True) / 65535.0 * moved["volt"] / 4.0)[part] ** THRUST_POWER
    return Flight(name, state, np.concatenate([commanded, thrust], -1))


def cut_windows(flight: Flight, ahead_s: float, every_s: float) -> tuple[Start, np.ndarray, np.ndarray]:
    """Return starts, commands (W, K, 4) and measured states (W, K + 1, 12): `ahead_s` of flight, every `every_s`.

    Raises:
        ValueError: if the flight is shorter than its `hover_s` and `ahead_s`.
    """
    past, ahead = round(flight.hover_s / DT_S), round(ahead_s / DT_S)
    begin = np.arange(past, len(flight.state) - ahead, round(every_s / DT_S))
    if not len(begin):
        raise ValueError(f"{flight.name}: shorter than {flight.hover_s + ahead_s:g} s")
    before, after = begin[:, np.newaxis] + np.arange(-past, 0), begin[:, np.newaxis] + np.arange(ahead + 1)
    weights = np.ones((len(begin), 1, 4))
    weights[..., -flight.forces :] /= hover_thrust(flight, before)[:, np.newaxis, np.newaxis]
    start = Start(flight.state[begin], flight.state[before], flight.command[before] * weights)
    return start, flight.command[after[:, :-1]] * weights, flight.state[after]


def hover_thrust(flight: Flight, rows: np.ndarray) -> np.ndarray:
    """Return the thrust (W,), in the flight's unit, that carries the weight, from rows (W, P) before each window."""
    lift = flight.command[:, -flight.forces :].sum(-1) * np.cos(flight.state[:, 6]) * np.cos(flight.state[:, 7])
    climb_mps = flight.state[:, 5]
    gained = (climb_mps[rows[:, -1]] - climb_mps[rows[:, 0]]) / (GRAVITY_MPS2 * DT_S * (rows.shape[1] - 1))
    return lift[rows].mean(1) / (1.0 + gained)


def resample(at_s: np.ndarray, time_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return rows (n, k) at other instants, linearly between them."""
    return np.stack([np.interp(at_s, time_s, values) for values in rows.T], -1)


def mean_over(rows: np.ndarray, count: int) -> np.ndarray:
    """Return means of (n, k) over `count` rows, centred."""
    kernel = np.ones(count) / count
    return np.stack([np.convolve(values, kernel, mode="same") for values in rows.T], -1)


def _lateness(rate_radps: np.ndarray, gyro: np.ndarray) -> float:
    """Return by how many seconds the gyro appears later than motion capture, at most 60 ms."""
    n = np.arange(len(gyro))
    gyro = mean_over(gyro, 7)

    def agreement(late_s):
        moved = resample(n + late_s / DT_S, n, gyro)
        return sum(np.corrcoef(moved[:, i], rate_radps[:, i])[0, 1] for i in (0, 1))

    return max(np.arange(-0.06, 0.0605, 0.002), key=agreement)


def _turn_to(direction: np.ndarray) -> np.ndarray:
    """Return the smallest turn (3, 3) that takes the z axis to a unit vector near it."""
    x, y, z = direction
    k = 1.0 / (1.0 + z)
    return np.array([[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, z]])
