"""The derivative of rotorpy's multirotor in compiled form: `Multirotor._s_dot_fn`, term by term.

A flight asks for 32000 of them. Each flight compares them with rotorpy's own as it goes (`Vehicle.check`).
"""

import math

import numpy as np
from numba import njit


class Constants:
    """What the derivative needs of a `Multirotor`, as arrays."""

    def __init__(self, body):
        if body.num_rotors != 4 or not body.aero or body._enable_ground:
            raise ValueError("expected four rotors with aerodynamics and no ground contact")
        self.rotors = np.ascontiguousarray(body.rotor_geometry, dtype=float)
        self.turns = np.asarray(body.rotor_dir, dtype=float)
        self.inertia, self.inverse = np.array(body.inertia, dtype=float), np.array(body.inv_inertia, dtype=float)
        self.drag = np.diag(body.drag_matrix).astype(float)
        self.rest = np.array(
            [body.mass, body.g, body.tau_m, body.k_m, body.k_d, body.k_z, body.k_h, body.k_flap], dtype=float
        )

    def slope(self, state, speeds, k_eta):
        """Derivative of a state (20) at asked rotor speeds [rad/s] and a thrust factor [N s^2]."""
        out = np.zeros(20)
        fill_slope(out, state, speeds, k_eta, self.rotors, self.turns, self.inertia, self.inverse, self.drag, self.rest)
        return out


@njit(cache=True)
def cross(a, b):
    """The cross product of two arrays of three."""
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


@njit(cache=True)
def matrix(x, y, z, w):
    """From the body's frame to the world's, of a quaternion of any length but zero."""
    size = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / size, y / size, z / size, w / size
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
    )


@njit(cache=True)
def wrench(air, rate, spin, k_eta, rotors, turns, drag, rest):
    """Force and moment in the body's frame: thrust, drag of rotors and body, flapping, translational lift."""
    _, _, _, k_m, k_d, k_z, k_h, k_flap = rest
    force = -math.sqrt(air @ air) * drag * air
    moment = np.zeros(3)
    for i in range(4):
        local = air + cross(rate, rotors[i])
        push = np.array(
            (
                -spin[i] * k_d * local[0],
                -spin[i] * k_d * local[1],
                k_eta * spin[i] ** 2 + k_h * (local[0] ** 2 + local[1] ** 2) - spin[i] * k_z * local[2],
            )
        )
        force += push
        moment += cross(rotors[i], push)
        moment[0] -= k_flap * spin[i] * local[1]
        moment[1] += k_flap * spin[i] * local[0]
        moment[2] += turns[i] * k_m * spin[i] ** 2
    return force, moment


@njit(cache=True)
def fill_slope(out, state, speeds, k_eta, rotors, turns, inertia, inverse, drag, rest):
    """Writes the derivative of a state into `out`."""
    mass, gravity, tau_m = rest[0], rest[1], rest[2]
    x, y, z, w = state[6], state[7], state[8], state[9]
    velocity, rate = state[3:6], state[10:13].copy()
    turn = matrix(x, y, z, w)
    force, moment = wrench(turn.T @ (velocity - state[13:16]), rate, state[16:], k_eta, rotors, turns, drag, rest)
    out[0:3] = velocity
    out[3:6] = turn @ force / mass
    out[5] -= gravity
    p, q, r = rate
    out[6] = 0.5 * (w * p - z * q + y * r)
    out[7] = 0.5 * (z * p + w * q - x * r)
    out[8] = 0.5 * (-y * p + x * q + w * r)
    out[9] = 0.5 * (-x * p - y * q - z * r)
    out[10:13] = inverse @ (moment - cross(rate, inertia @ rate))
    out[16:] = (speeds - state[16:]) / tau_m
