"""The declared model: what a laboratory would fit, once, to flights of this vehicle with nothing hidden."""

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from .flight import ROW_S, fly
from .vehicle import GRAVITY_MPS2, HOVER_PWM

KINDS = ["mix", "doublets"]
WINDOW_ROWS = 200
# flights of the fit have a seed of their own, far from those of any population
SEED = 990_001


def held_response(numerator, denominator, command):
    """Response of a transfer function to a command that is held over each row."""
    b, a, _ = cont2discrete((numerator, denominator), ROW_S)
    return lfilter(np.ravel(b), a, command)


def fit_attitude(logs):
    """n0, d1, d0 of n0 / (s^2 + d1 s + d0) from commands to true angles, both axes together."""
    pairs = [(np.radians(log.rows[:, 5 + axis]), log.truth[:, 3 + axis]) for log in logs for axis in (0, 1)]

    def errors(params):
        n0, d1, d0 = np.exp(params)
        # the first second forgets the start
        return np.concatenate([(held_response([n0], [1.0, d1, d0], u) - angle)[100:] for u, angle in pairs])

    return [float(v) for v in np.exp(least_squares(errors, np.log([60.0, 15.0, 60.0])).x)]


def fit_yaw(logs):
    """The bandwidth k of the yaw rate behind its command."""
    pairs = [(-np.radians(log.rows[:, 7]), log.truth[:, 8]) for log in logs]

    def errors(params):
        return np.concatenate([(held_response([params[0]], [1.0, params[0]], u) - rate)[100:] for u, rate in pairs])

    return float(least_squares(errors, [10.0], bounds=(1.0, 100.0)).x[0])


def fit_height(logs):
    """Hover PWM and damping of climb: the vertical speed in windows of 2 s with starts of their own.

    The thrust's lag is fitted beside them, though the declared form has no place for it. Without it the damping would
    be below zero.
    """
    starts = [
        (at, begin)
        for at, log in enumerate(logs)
        for begin in range(WINDOW_ROWS, len(log.rows) - WINDOW_ROWS, WINDOW_ROWS)
    ]
    decay_s = np.arange(WINDOW_ROWS) * ROW_S

    def errors(params):
        hover, heave, lag_s = params[0] * HOVER_PWM, params[1], params[2]
        lagged = [held_response([1.0], [lag_s, 1.0], log.rows[:, 8] - HOVER_PWM) + HOVER_PWM for log in logs]
        out = []
        for at, begin in starts:
            rows = slice(begin, begin + WINDOW_ROWS)
            push = GRAVITY_MPS2 * (lagged[at][rows] / hover - 1.0)
            rest = logs[at].truth[rows, 2] - held_response([1.0], [1.0, heave], push)
            fade = np.exp(-heave * decay_s)
            out.append(rest - fade * (rest @ fade) / (fade @ fade))
        return np.concatenate(out)

    hover, heave, _ = least_squares(errors, [1.0, 0.3, 0.05], bounds=([0.5, 0.0, 0.001], [2.0, 5.0, 0.3])).x
    return float(hover * HOVER_PWM), float(heave)


def declare(inner, seconds=60.0):
    """The declared numbers of a vehicle with this inner loop."""
    rng = np.random.default_rng(SEED)
    logs = [fly({}, inner, kind, seconds, "mocap", rng, 0.0015) for kind in KINDS]
    n0, d1, d0 = fit_attitude(logs)
    hover_pwm, heave = fit_height(logs)
    numbers = {"n0": n0, "d1": d1, "d0": d0, "hover_pwm": hover_pwm, "heave": heave, "k": fit_yaw(logs)}
    return {name: float(f"{value:.5g}") for name, value in numbers.items()}
