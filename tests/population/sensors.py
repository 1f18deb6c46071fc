"""Camera (30 Hz, 50 ms late, stamped) and angles (100 Hz), with the noise levels of the shared generator."""

import math

import numpy as np

from .vehicle import POSITION, STEP_S, VELOCITY, rotation

FRAME_HZ = 30.0
DECLARED_LATENCY_S = 0.05

# position sideways and up [m], angles [deg], wandering error [m] and its time [s], shares of outliers and drop-outs
NOISE = {
    "mocap": (0.001, 0.001, 0.08, 0.0, 1.0, 0.0, 0.0),
    "low": (0.002, 0.003, 0.10, 0.0, 1.0, 0.0, 0.0),
    "mid": (0.004, 0.008, 0.20, 0.0, 1.0, 0.0, 0.0),
    "high": (0.010, 0.020, 0.40, 0.0, 1.0, 0.0, 0.0),
    "aruco": (0.004, 0.008, 0.20, 0.012, 1.5, 0.01, 0.03),
}


def wander(count, step_s, sigma, time_s, width, rng):
    """First-order coloured noise in its steady state."""
    keep = math.exp(-step_s / time_s)
    out = np.empty((count, width))
    value = rng.standard_normal(width) * sigma
    for row in out:
        row[:] = value
        value = keep * value + math.sqrt(1 - keep * keep) * sigma * rng.standard_normal(width)
    return out


def frame_errors(count, noise, rng):
    """Errors of the frames, and which of them never arrive."""
    side_m, up_m, _, wander_m, wander_s, outliers, dropouts = NOISE[noise]
    errors = rng.standard_normal((count, 3)) * [side_m, side_m, up_m]
    if wander_m > 0:
        errors += wander(count, 1 / FRAME_HZ, wander_m, wander_s, 3, rng) * [1.0, 1.0, 1.5]
    far = rng.random(count) < outliers
    errors[far] += rng.choice([-1, 1], (far.sum(), 3)) * rng.uniform(0.05, 0.12, (far.sum(), 3))
    lost = np.zeros(count, dtype=bool)
    # drop-outs last one to seven frames, four in the mean
    for begin in np.flatnonzero(rng.random(count) < dropouts / 4):
        lost[begin : begin + rng.integers(1, 8)] = True
    lost[0] = False
    return errors, lost


class Camera:
    """Frames under way to the ground."""

    def __init__(self, hidden, seconds, noise, rng):
        self.hidden = hidden
        self.errors, self.lost = frame_errors(int(seconds * FRAME_HZ) + 3, noise, rng)
        self.lever_m = np.array([hidden.get(key, 0.0) for key in ("cam_x", "cam_y", "cam_z")])
        self.moved_s = hidden.get("moved_at", 0.0) * seconds
        self.extra_s = hidden.get("cam_latency", 0.0)
        self.taken, self.underway = 0, []

    def shoot(self, t_s, state, angles_rad):
        """Takes the frame that is due in this step: its place is that of the capture, between steps."""
        capture_s = self.taken / FRAME_HZ
        if capture_s > t_s + 1e-9:
            return
        if not self.lost[self.taken]:
            moved_m = self.hidden.get("moved_x", 0.0) if capture_s > self.moved_s else 0.0
            lever_m = self.lever_m + np.array([moved_m, 0.0, 0.0])
            place = state[POSITION] - (t_s - capture_s) * state[VELOCITY] + rotation(*angles_rad) @ lever_m
            angle = math.radians(self.hidden.get("frame_yaw", 0.0))
            sin, cos = math.sin(angle), math.cos(angle)
            place[:2] = cos * place[0] + sin * place[1], cos * place[1] - sin * place[0]
            place[:2] *= 1 + self.hidden.get("lens_pm2", 0.0) * (place[0] ** 2 + place[1] ** 2)
            place = place * self.hidden.get("cam_scale", 1.0) + self.errors[self.taken]
            # the ground stamps arrival less the latency that it knows of
            self.underway.append((capture_s + DECLARED_LATENCY_S + self.extra_s, place, capture_s + self.extra_s))
        self.taken += 1

    def arrived(self, t_s):
        """The frames that arrive in this step: place and capture time as stamped."""
        while self.underway and self.underway[0][0] <= t_s + STEP_S / 2:
            _, place, stamp_s = self.underway.pop(0)
            yield place, stamp_s
