"""Simulators of others, run as they are installed, each with its own attitude controller.

All numbers are theirs. One thing is set: one weight of thrust is what hovers in each of them. Rotors start at the speed
that the past commands have brought them to.

- crazyflow (MIT): Schuck and Rath, arXiv 2606.01478; its numbers for `cf2x_L250`.
- rotorpy (MIT): Folk, Paulos, Kumar 2023, arXiv 2306.04485; `crazyflie_params`.
- gym-pybullet-drones (MIT): Panerati et al. 2021, arXiv 2103.02142. PyPI does not have it, so its published numbers for
  CF2X (`assets/cf2x.urdf`), its drag and its gains (`control/DSLPIDControl.py`) fly in a rigid body of our own.
"""

from __future__ import annotations

import os

import numpy as np
from adapters import register
from real_flights import ATT, GRAVITY_MPS2, POS, RATE, VEL, Start, angles, euler_rates, rotation

# crazyflow refuses to be imported after SciPy without it
os.environ.setdefault("SCIPY_ARRAY_API", "1")
# crazyflow's and PyBullet's rigid bodies step as often, semi-implicitly, and the controllers with them
SUBSTEPS = 5
CONTROL_HZ = 500
DRONE = "cf2x_L250"


def _turned(matrix: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """Return attitudes (W, 3, 3) turned about body axes by small vectors (W, 3), to third order."""
    x, y, z = np.moveaxis(angle_rad, -1, 0)
    o = np.zeros_like(x)
    k = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    k2 = k @ k
    return matrix @ (np.eye(3) + k + k2 / 2.0 + k2 @ k / 6.0)


def fly(start: Start, command: np.ndarray, dt_s: float, accelerations, rotors: np.ndarray) -> np.ndarray:
    """Return states (W, K + 1, 12) of rigid bodies.

    `accelerations(matrix, vel, rate, rotors, command)` returns those of the velocity and of the body rates and the
    derivatives of the rotors; it is asked SUBSTEPS times a step.
    """
    h_s = dt_s / SUBSTEPS
    pos, vel, rate = (start.state[:, part].copy() for part in (POS, VEL, RATE))
    matrix = rotation(start.state[:, ATT])
    states = [start.state]
    for u in np.moveaxis(command, 1, 0):
        for _ in range(SUBSTEPS):
            dv, dw, dr = accelerations(matrix, vel, rate, rotors, u)
            vel, rate, rotors = vel + h_s * dv, rate + h_s * dw, rotors + h_s * dr
            pos, matrix = pos + h_s * vel, _turned(matrix, h_s * rate)
        states.append(np.concatenate([pos, vel, angles(matrix), rate], -1))
    return np.stack(states, 1)


@register("crazyflow first_principles", "rigid body, rotors, drag; its Mellinger attitude controller")
class FirstPrinciples:
    """crazyflow's `first_principles` behind its `attitude2force_torque`, 500 times a second."""

    def __init__(self):
        import crazyflow.control as control
        from crazyflow.control import mellinger
        from crazyflow.dynamics import load_params, parametrize
        from crazyflow.dynamics.first_principles import dynamics
        from scipy.spatial.transform import Rotation

        self.dynamics = parametrize(dynamics, DRONE)
        self.attitude = control.parametrize(mellinger.attitude2force_torque, DRONE)
        self.mixer = control.parametrize(mellinger.force_torque2rotor_vel, DRONE)
        self.weight_n = float(load_params("first_principles", DRONE)["mass"]) * GRAVITY_MPS2
        self.rotation = Rotation

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""
        memory = {"integral": None, "rate": start.state[:, RATE]}
        level = np.zeros((len(command), 3))

        def commanded(quat, rate, u):
            rpyt = np.concatenate([u[:, :3], u[:, 3:] * self.weight_n], -1)
            force, torque, memory["integral"] = self.attitude(
                quat, rate, rpyt, memory["rate"], memory["integral"], ctrl_freq=CONTROL_HZ
            )
            memory["rate"] = rate
            return self.mixer(force, torque)

        def accelerations(matrix, vel, rate, rotors, u):
            quat = self.rotation.from_matrix(matrix).as_quat()
            speeds = commanded(quat, rate, u)
            _, _, dv, dw, dr = self.dynamics(level, quat, vel, rate, speeds, rotors)
            return dv, dw, dr

        # rotors at rest under the mean command of the last 0.1 s
        lift = start.past_command[:, -10:, 3:].mean(1) * self.weight_n
        rotors = self.mixer(lift, np.zeros((len(lift), 3)))
        return fly(start, command, dt_s, accelerations, rotors)


@register("crazyflow so_rpy_rotor_drag", "fitted attitude, thrust lag and drag", kind="so_rpy_rotor_drag")
@register("crazyflow so_rpy_rotor", "fitted attitude and thrust lag", kind="so_rpy_rotor")
@register("crazyflow so_rpy", "fitted attitude", kind="so_rpy")
class FittedDynamics:
    """One of crazyflow's fitted models, by its `dynamics`."""

    def __init__(self, kind: str):
        import importlib

        from crazyflow.dynamics import load_params, parametrize
        from scipy.spatial.transform import Rotation

        self.dynamics = parametrize(importlib.import_module(f"crazyflow.dynamics.{kind}").dynamics, DRONE)
        params = load_params(kind, DRONE)
        # command that carries the weight, by its own scale of the thrust
        self.hover_n = float((params["mass"] * GRAVITY_MPS2 - params["acc_coef"]) / params["cmd_f_coef"])
        self.lag_ps = float(params.get("thrust_dyn_coef", 0.0))
        self.rotation = Rotation

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""
        level = np.zeros((len(command), 3))

        def accelerations(matrix, vel, rate, rotors, u):
            rpyt = np.concatenate([u[:, :3], u[:, 3:] * self.hover_n], -1)
            quat = self.rotation.from_matrix(matrix).as_quat()
            known = {"rotor_vel": rotors} if self.lag_ps else {}
            _, _, dv, dw, *dr = self.dynamics(level, quat, vel, rate, rpyt, **known)
            return dv, dw, dr[0] if dr else 0.0

        thrust = lagged(start.past_command[..., 3] * self.hover_n, self.lag_ps * dt_s) if self.lag_ps else level[:, 0]
        return fly(start, command, dt_s, accelerations, np.repeat(thrust[:, np.newaxis], 4, 1))


@register("rotorpy", "rigid body, rotors, rotor drag; its attitude controller (`cmd_ctatt`)")
class RotorPy:
    """rotorpy's `Multirotor` with `crazyflie_params`, one of its own steps a row."""

    def __init__(self, control: str = "cmd_ctatt"):
        from rotorpy.vehicles.crazyflie_params import quad_params
        from rotorpy.vehicles.multirotor import Multirotor
        from scipy.spatial.transform import Rotation

        self.vehicle = Multirotor(quad_params, control_abstraction=control)
        self.rotation = Rotation

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""
        past_radps = self.speeds_radps(self.forces(start.past_command))
        speeds_radps = lagged(past_radps, dt_s / self.vehicle.tau_m)
        return np.stack([self._one(*one, dt_s) for one in zip(start.state, speeds_radps, command, strict=True)])

    def forces(self, command: np.ndarray) -> np.ndarray:
        """Return the force of every motor, in weights: (..., 1)."""
        return command[..., 3:] / 4.0

    def speeds_radps(self, forces: np.ndarray) -> np.ndarray:
        """Return rotor speeds that give forces."""
        return np.sqrt(np.maximum(forces, 0.0) * self.vehicle.mass * self.vehicle.g / self.vehicle.k_eta)

    def controls(self, command: np.ndarray) -> list[dict]:
        """Return what `Multirotor.step` takes for commands (K, 4)."""
        attitudes = self.rotation.from_matrix(rotation(command[:, :3])).as_quat()
        thrusts_n = command[:, 3] * self.vehicle.mass * self.vehicle.g
        return [{"cmd_thrust": thrust, "cmd_q": quat} for thrust, quat in zip(thrusts_n, attitudes, strict=True)]

    def _one(self, first: np.ndarray, speeds_radps: np.ndarray, command: np.ndarray, dt_s: float) -> np.ndarray:
        state = {
            "x": first[POS],
            "v": first[VEL],
            "q": self.rotation.from_matrix(rotation(first[ATT])).as_quat(),
            "w": first[RATE],
            "wind": np.zeros(3),
            "rotor_speeds": speeds_radps * np.ones(4),
        }
        states = [first]
        for control in self.controls(command):
            state = self.vehicle.step(state, control, dt_s)
            att = angles(self.rotation.from_quat(state["q"]).as_matrix())
            states.append(np.concatenate([state["x"], state["v"], att, state["w"]]))
        return np.stack(states)


@register("gym-pybullet-drones CF2X", "rigid body and drag by its published numbers; its attitude controller")
class PyBulletDrones:
    """The numbers of `assets/cf2x.urdf` and `DSLPIDControl.py`, CF2X; rotors follow at once, as there."""

    MASS_KG, ARM_M = 0.027, 0.0397
    INERTIA_KGM2 = np.array([1.4e-5, 1.4e-5, 2.17e-5])
    # per square of RPM
    THRUST_N, TORQUE_NM = 3.16e-10, 7.94e-12
    # per sum of the rotor speeds in rad/s
    DRAG_KG = np.array([9.1785e-7, 9.1785e-7, 10.311e-7])
    PROPORTIONAL, INTEGRAL = np.array([7e4, 7e4, 6e4]), np.array([0.0, 0.0, 500.0])
    DERIVATIVE = np.array([2e4, 2e4, 1.2e4])
    RPM_PER_PWM, RPM_AT_ZERO, PWM, TORQUE_PWM = 0.2685, 4070.3, (20000.0, 65535.0), 3200.0
    # shares of roll, pitch and yaw for motors 0 to 3
    MIXER = np.array([[1.0, -1.0, -1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""
        memory = {"integral": np.zeros((len(command), 3))}

        def speeds_rpm(matrix, rate, u):
            wanted = rotation(u[:, :3])
            error = np.swapaxes(wanted, 1, 2) @ matrix
            error = (error - np.swapaxes(error, 1, 2))[:, [2, 0, 1], [1, 2, 0]]
            memory["integral"] = np.clip(
                memory["integral"] - error * dt_s / SUBSTEPS, [-1.0, -1.0, -1500.0], [1.0, 1.0, 1500.0]
            )
            turning = euler_rates(angles(matrix), rate)
            torque = np.clip(
                -self.PROPORTIONAL * error - self.DERIVATIVE * turning + self.INTEGRAL * memory["integral"],
                -self.TORQUE_PWM,
                self.TORQUE_PWM,
            )
            hover = np.sqrt(np.maximum(u[:, 3], 0.0) * self.MASS_KG * GRAVITY_MPS2 / (4.0 * self.THRUST_N))
            pwm = (hover - self.RPM_AT_ZERO) / self.RPM_PER_PWM
            pwm = pwm[:, np.newaxis] + torque @ (self.MIXER * [0.5, 0.5, 1.0]).T
            return self.RPM_PER_PWM * np.clip(pwm, *self.PWM) + self.RPM_AT_ZERO

        def accelerations(matrix, vel, rate, rotors, u):
            return *self.accelerations(matrix, vel, rate, speeds_rpm(matrix, rate, u), self.MIXER), 0.0

        return fly(start, command, dt_s, accelerations, np.zeros((len(command), 4)))

    def accelerations(self, matrix, vel, rate, rpm, signs):
        """Return those of velocity and body rates (W, 3) at rotor speeds (W, 4), whose torques have `signs` (4, 3)."""
        side_m = 0.5 * np.sqrt(2.0) * self.ARM_M
        lift = self.THRUST_N * rpm**2
        torque = lift @ (signs * [side_m, side_m, self.TORQUE_NM / self.THRUST_N])
        body_vel = np.einsum("wji,wj->wi", matrix, vel)
        force = -self.DRAG_KG * (2.0 * np.pi / 60.0 * rpm.sum(-1, keepdims=True)) * body_vel
        force[:, 2] += lift.sum(-1)
        dv = np.einsum("wij,wj->wi", matrix, force) / self.MASS_KG - [0.0, 0.0, GRAVITY_MPS2]
        return dv, (torque - np.cross(rate, self.INERTIA_KGM2 * rate)) / self.INERTIA_KGM2


def lagged(past: np.ndarray, share: float) -> np.ndarray:
    """Return (W, ...) where a lag stands after values (W, P, ...); `share` is the step over its time constant."""
    weights = np.exp(-share * np.arange(past.shape[1])[::-1])
    return np.tensordot(past, weights / weights.sum(), (1, 0))
