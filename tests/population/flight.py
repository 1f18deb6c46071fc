"""One flight: vehicle, firmware, link and sensors in time."""

import math
from dataclasses import dataclass

import numpy as np

from .excitation import Excitation
from .firmware import ATTITUDE_S, CONTROL_S, TILT_LIMIT_DEG, Inner, Link, Position, thrust_n
from .sensors import NOISE, Camera, wander
from .vehicle import HOVER_PWM, POSITION, RATE, STEP_S, VELOCITY, Vehicle, drag_rate_ps, euler_rad

# integrators and motors settle before the log begins
PREROLL_S = 4.0
ROW_S = 0.01
STEPS_PER_ROW, STEPS_PER_TICK = round(ROW_S / STEP_S), round(CONTROL_S / STEP_S)

COLUMNS = ["t", "ref_x", "ref_y", "ref_z", "ref_yaw", "cmd_roll", "cmd_pitch", "cmd_yawrate", "cmd_thrust_pwm"]
COLUMNS += ["x", "y", "z", "roll", "pitch", "yaw", "t_cam", "vbat"]
FORMATS = ["%.3f"] + ["%.4f"] * 7 + ["%d"] + ["%.5f"] * 3 + ["%.4f"] * 3 + ["%.5f", "%.3f"]


class LostControl(Exception):
    """The vehicle left the room."""


@dataclass
class Log:
    """Rows as logged, and the truth: velocity [m/s], angles [rad], body rates [rad/s]."""

    rows: np.ndarray
    truth: np.ndarray


def winds_mps(hidden, steps, rng):
    """Wind a step. Hidden strengths are accelerations: the rotors' drag makes them of a wind."""
    per_mps = hidden.get("drag_linear", drag_rate_ps())
    wind = np.zeros((steps, 3))
    wind[:, :2] += [hidden.get("wind_x", 0.0) / per_mps, hidden.get("wind_y", 0.0) / per_mps]
    if "step_at" in hidden:
        begin = round((PREROLL_S / STEP_S) + hidden["step_at"] * (steps - PREROLL_S / STEP_S))
        wind[begin:, :2] += [hidden["wind_step_x"] / per_mps, hidden["wind_step_y"] / per_mps]
    if hidden.get("gust_sigma", 0.0) > 0:
        wind += wander(steps, STEP_S, hidden["gust_sigma"] / per_mps, hidden["gust_tau"], 3, rng) * [1.0, 1.0, 0.5]
    return wind


def fly(hidden, inner, kind, seconds, noise, rng, drain_vps):
    """A flight of a kind of excitation with what is hidden."""
    steps = round((PREROLL_S + seconds) / STEP_S)
    excitation = Excitation(kind, seconds, rng)
    vehicle, position, loop, link = (
        Vehicle(hidden, excitation.reference[0, :3]),
        Position(),
        Inner(inner),
        Link(hidden, rng),
    )
    camera = Camera(hidden, PREROLL_S + seconds, noise, rng)
    wind = winds_mps(hidden, steps, rng)
    angle_noise_deg = rng.standard_normal((round(seconds / ROW_S), 3)) * NOISE[noise][2]
    voltage_noise_v = rng.standard_normal(round(seconds / ROW_S)) * 0.008
    full_v = rng.uniform(4.02, 4.12)
    tilt = [math.radians(hidden.get(key, 0.0)) for key in ("imu_tilt_roll", "imu_tilt_pitch")]
    rows = np.full((len(angle_noise_deg), len(COLUMNS)), np.nan)
    truth = np.zeros((len(rows), 9))
    given = applied = link.held
    frame, turned_rad = None, 0.0
    for i in range(steps):
        t_s = i * STEP_S - PREROLL_S
        tick = max(i - round(PREROLL_S / STEP_S), 0) // STEPS_PER_TICK
        angles = euler_rad(vehicle.state)
        seen = [
            angles[0] + tilt[0],
            angles[1] + tilt[1],
            angles[2] + math.radians(hidden.get("yaw_drift", 0.0)) * max(t_s, 0.0) + turned_rad,
        ]
        # small angles: the yaw turns as the body does about z
        turned_rad += hidden.get("gyro_scale", 0.0) * vehicle.state[RATE][2] * STEP_S if t_s > 0 else 0.0
        camera.shoot(i * STEP_S, vehicle.state, angles)
        for place, stamp_s in camera.arrived(i * STEP_S):
            position.frame(place, stamp_s)
            frame = (place, stamp_s - PREROLL_S)
        if i % STEPS_PER_TICK == 0:
            given = command(position, excitation, tick, seen[2], settled=t_s >= 0)
            link.receive(given)
        vbat_v = full_v - drain_vps * max(t_s, 0.0) - 0.15 * (applied[3] / HOVER_PWM - 1.0)
        applied = link.deliver()
        if t_s > -STEP_S / 2 and i % STEPS_PER_ROW == 0:
            row = round(t_s / ROW_S)
            reference = excitation.reference[tick]
            rows[row, :9] = [row * ROW_S, *reference[:3], math.degrees(reference[3]), *given]
            rows[row, 12:15] = np.degrees(seen) + angle_noise_deg[row]
            rows[row, 14] = (rows[row, 14] + 180) % 360 - 180
            rows[row, 16] = vbat_v + voltage_noise_v[row]
            if frame and frame[1] >= 0:
                rows[row, 9:12], rows[row, 15] = frame
            frame = None
            truth[row] = [*vehicle.state[VELOCITY], *angles, *vehicle.state[RATE]]
        if i % round(ATTITUDE_S / STEP_S) == 0:
            loop.aim(np.radians(link.tilt_deg(applied)).tolist(), seen)
        moment = loop.moment(vehicle.state[RATE].tolist(), -math.radians(applied[2]), hidden.get("alloc_cross", 0.0))
        vehicle.step(t_s, thrust_n(applied[3], hidden.get("thrust_slope", 1.0)), moment, vbat_v, wind[i])
        if vehicle.has_left():
            raise LostControl(f"at {t_s:.1f} s the vehicle is at {vehicle.state[POSITION]}")
    return Log(rows, truth)


def command(position, excitation, tick, yaw_rad, settled):
    """The position controller's command with what the excitation adds, within the limits of the interface."""
    out = position.command(excitation.reference[tick], yaw_rad)
    if settled:
        if excitation.yaw_is_free[tick]:
            out[2] = 0.0
        out += excitation.addition[tick]
    out[:2] = np.clip(out[:2], -TILT_LIMIT_DEG, TILT_LIMIT_DEG)
    out[3] = math.floor(np.clip(out[3], 15000, 60000))
    return out
