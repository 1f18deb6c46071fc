"""Fits motor lag, inertia, flapping and drag of the motor-level form to flights of `motor_flights.py`.

    python examples/simulators/identify_motors.py ../shared/data/crazyswarm2

- Lag and inertia are found from fast turns alone, less their mean over FAST_S: what pushes slowly is answered by the
  controller, and would make the torque look weak.
- Flapping, a turn in proportion to the speed, and drag are found from what is left.
- Roll and pitch share all numbers; every flight has levels of its own.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from motor_flights import FIT, SIGNS, read_motor_flight
from real_flights import ATT, DT_S, GRAVITY_MPS2, RATE, VEL, Flight, check_recordings, hover_thrust, mean_over, rotation

LAGS_S = np.arange(0.02, 0.2, 0.002)
# chosen on the flights of the fit among 0.15, 0.25, 0.35, 0.5 and 1 s: longer ones let slow pushes in
FAST_S = 0.25


def identify(flights: list[Flight]) -> dict[str, float]:
    """Return the numbers of the vehicle that flew, in the units of their names.

    `turn_radps2` is the angular acceleration by a torque of one weight on the lever between two motors; `explained` is
    the share of the fast turns' variance.
    """
    rows = round(FAST_S / DT_S) | 1
    fits = []
    for lag_s in LAGS_S:
        torque, speed, turned = _all([[part - mean_over(part, rows) for part in _turns(f, lag_s)] for f in flights])
        known = np.stack([torque, speed], -1)
        slopes, *_ = np.linalg.lstsq(known, turned, rcond=None)
        fits.append((np.mean((turned - known @ slopes) ** 2) / np.mean(turned**2), lag_s, slopes[0]))
    left, lag_s, turn_radps2 = min(fits)
    torque, speed_mps, turned = _all([[part - part.mean(0) for part in _turns(f, lag_s)] for f in flights])
    over_ground_mps, lost_mps2 = _all([[part - part.mean(0) for part in _slowed(f)] for f in flights])
    found = {
        "lag_s": lag_s,
        "turn_radps2": turn_radps2,
        "flap_radpms": speed_mps @ (turned - turn_radps2 * torque) / (speed_mps @ speed_mps),
        "drag_ps": over_ground_mps @ lost_mps2 / (over_ground_mps @ over_ground_mps),
        "explained": 1.0 - left,
    }
    return {name: round(float(value), 4) for name, value in found.items()}


def _all(flights: list[list[np.ndarray]]) -> list[np.ndarray]:
    """Return each part (n, 2) of all flights in one row, without the ends, which means over rows spoil."""
    ends = round(FAST_S / DT_S)
    return [np.concatenate([part[ends:-ends].ravel() for part in parts]) for parts in zip(*flights, strict=True)]


def _weights(flight: Flight) -> np.ndarray:
    """Return the forces (n, 4) of motors in weights."""
    return flight.command / hover_thrust(flight, np.arange(len(flight.state))[np.newaxis])


def _turns(flight: Flight, lag_s: float) -> list[np.ndarray]:
    """Return, about roll and pitch (n, 2), lagged torque, the speed that flapping turns by, angular acceleration."""
    share = 1.0 - np.exp(-DT_S / lag_s)
    torque = _weights(flight) @ SIGNS[:, :2]
    for row in range(1, len(torque)):
        torque[row] = torque[row - 1] + share * (torque[row] - torque[row - 1])
    # a command holds for the step after its row
    torque[1:] = torque[:-1]
    front, left, _ = np.einsum("nji,nj->in", rotation(flight.state[:, ATT]), flight.state[:, VEL])
    turned = np.gradient(flight.state[:, RATE][:, :2], DT_S, axis=0)
    return [mean_over(part, 3) for part in (torque, np.stack([left, -front], -1), turned)]


def _slowed(flight: Flight) -> list[np.ndarray]:
    """Return horizontal velocity (n, 2), and what it takes from the acceleration that the tilted thrust gives."""
    thrust_mps2 = GRAVITY_MPS2 * _weights(flight).sum(-1, keepdims=True) * rotation(flight.state[:, ATT])[..., 2]
    lost_mps2 = thrust_mps2 - np.gradient(flight.state[:, VEL], DT_S, axis=0)
    return [flight.state[:, VEL][:, :2], lost_mps2[:, :2]]


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("data", type=Path, help="folder of the recordings")
    data = arguments.parse_args().data
    for vehicle, names in FIT.items():
        check_recordings(arguments, data, names)
        print(vehicle, identify([read_motor_flight(data / name) for name in names]))
