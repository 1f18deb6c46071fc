"""Simulators whose input is the force of each motor, without any controller: what `motor_flights.py` is predicted by.

A force is a multiple of the weight, which each turns into its own PWM or rotor speed by its own thrust curve. So what
differs is inertia, arm, lag and drag. Numbers are those of the vehicle that a row names; only those of
"ours, identified" are fitted to other flights of the set.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from adapters import BY_MOTORS, crazyflie, register
from motor_flights import SIGNS
from peers import SUBSTEPS, PyBulletDrones, RotorPy, fly
from real_flights import ATT, DT_S, GRAVITY_MPS2, POS, RATE, VEL, Start, body_rates, euler_rates

FULL_PWM = 65535.0
# above its floor, which no other simulator has
HIGH_M = 50.0


@register("ours, cf2-thesis", "motor-level, Foerster's data sheet", to=BY_MOTORS, vehicle="cf2-thesis")
@register("ours, cf21-thrust-upgrade", "motor-level, data sheet", to=BY_MOTORS, vehicle="cf21-thrust-upgrade")
@register("ours, cf21", "motor-level, drag and lag identified", to=BY_MOTORS, vehicle="cf21")
@register("ours, identified, no flapping", "the same without `flap`", "motors", to=BY_MOTORS, flaps=False)
@register("ours, identified", "cf21 with numbers and flapping by `identify_motors.py`", "motors", to=BY_MOTORS)
class MotorLevel:
    """The simulator's own step with `vertical="motors"`, recorded for JAX, by the numbers of a vehicle."""

    def __init__(self, path: Path | None = None, vehicle: str = "cf21", flaps: bool = True):
        import jax

        import crazyflie_gym.jax

        self.jax = jax
        model = json.loads(crazyflie("model", vehicle, "--show", "--json"))
        model["rig"]["control"]["value"] = 1.0 / DT_S
        # those of the thrust form; the weight is found before every prediction
        model.pop("effects", None)
        form = model["vertical"]["motors"]
        found = json.loads(path.read_text()) if path else {}
        if found:
            lever_m = 0.5**0.5 * model["vehicle"]["arm"]["value"]
            inertia_kgm2 = model["vehicle"]["mass"]["value"] * GRAVITY_MPS2 * lever_m / found["turn_radps2"]
            form["tilt_inertia"]["value"] = form["pitch_inertia"]["value"] = inertia_kgm2
            form["lag"]["value"], model["lateral"]["drag"]["value"] = found["lag_s"], found["drag_ps"]
        self.linear = form["linear_share"]["value"]
        hover = form["hover"]["value"] / FULL_PWM
        self.hover_curve = hover * (self.linear + (1.0 - self.linear) * hover)
        self.env = crazyflie_gym.jax.make(
            "Crazyflie-v0", model=model, vertical="motors", action="motors", starts=1, effects={"flap": 1.0}
        )
        flap = self.env.default_params.flap._replace(torque_radpms=found["flap_radpms"] if found and flaps else 0.0)
        self.params = self.env.default_params._replace(flap=flap)
        self.key = jax.random.key(0)
        self.tick = jax.jit(lambda state, action: self.env.step_env(self.key, state, action, self.params)[1])
        self.reset = jax.jit(self.env.reset, static_argnames="num_envs")

    def _now(self, state) -> np.ndarray:
        """Return position, velocity, attitude and its derivatives (W, 12)."""
        return np.concatenate([np.asarray(part, float) for part in self.env.true_state(state).values()], -1)

    def actions(self, command: np.ndarray) -> np.ndarray:
        """Return actions, the PWM of -1 to 1, for forces (..., 4): the inverse of the thrust curve."""
        curve = 4.0 * np.maximum(command, 0.0) * self.hover_curve
        root = np.sqrt(self.linear**2 + 4.0 * (1.0 - self.linear) * curve)
        return np.clip(4.0 * curve / (self.linear + root) - 1.0, -1.0, 1.0)

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`.

        Raises:
            ValueError: for another step than that of the recorded environment.
        """
        if not np.isclose(dt_s, self.env.tick_s):
            raise ValueError(f"dt_s: expected {self.env.tick_s}, got {dt_s}")
        state = self.reset(self.key, self.params, num_envs=len(command))[1]
        for action in np.moveaxis(self.actions(start.past_command), 1, 0):
            state = self.tick(state, action)
        first = start.state.copy()
        first[:, 2] += HIGH_M
        first[:, RATE] = euler_rates(first[:, ATT], first[:, RATE])
        parts = zip(self.env.true_state(state), (POS, VEL, ATT, RATE), strict=True)
        state = state._replace(
            **{name: tuple(self.jax.numpy.asarray(first[:, part].T, "float32")) for name, part in parts}
        )
        flown = []
        for action in np.moveaxis(self.actions(command), 1, 0):
            state = self.tick(state, action)
            flown.append(self._now(state))
        flown = np.stack(flown, 1)
        flown[..., 2] -= HIGH_M
        flown[..., RATE] = body_rates(flown[..., ATT], flown[..., RATE])
        return np.concatenate([start.state[:, np.newaxis], flown], 1)


@register("crazyflow cf2x_T350", "first_principles without its controller", to=BY_MOTORS, drone="cf2x_T350")
@register("crazyflow cf2x_L250", "first_principles without its controller", to=BY_MOTORS, drone="cf2x_L250")
class FirstPrinciplesMotors:
    """crazyflow's `first_principles` by rotor speeds, 500 times a second."""

    def __init__(self, drone: str):
        from crazyflow.control.transform import motor_force2rotor_vel
        from crazyflow.dynamics import load_params, parametrize
        from crazyflow.dynamics.first_principles import dynamics
        from scipy.spatial.transform import Rotation

        params = load_params("first_principles", drone)
        self.dynamics, self.rotation = parametrize(dynamics, drone), Rotation
        self.weight_n = float(params["mass"]) * GRAVITY_MPS2
        self.speeds = lambda forces: motor_force2rotor_vel(forces * self.weight_n, params["rpm2thrust"])

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""
        level = np.zeros((len(command), 3))

        def accelerations(matrix, vel, rate, rotors, u):
            quat = self.rotation.from_matrix(matrix).as_quat()
            return self.dynamics(level, quat, vel, rate, self.speeds(u), rotors)[2:]

        rotors, upright = self.speeds(start.past_command[:, 0]), np.tile(np.eye(3), (len(command), 1, 1))
        for u in np.repeat(np.moveaxis(start.past_command, 1, 0), SUBSTEPS, 0):
            rotors = rotors + dt_s / SUBSTEPS * accelerations(upright, level, level, rotors, u)[2]
        return fly(start, command, dt_s, accelerations, rotors)


@register("rotorpy", "rigid body, rotors, rotor drag", to=BY_MOTORS)
class RotorPyMotors(RotorPy):
    """rotorpy's `Multirotor` by `cmd_motor_speeds`; its first motor is in front on the left."""

    def __init__(self):
        super().__init__("cmd_motor_speeds")

    def forces(self, command: np.ndarray) -> np.ndarray:
        """Return the forces (..., 4) of its motors, in weights."""
        return command[..., [3, 0, 1, 2]]

    def controls(self, command: np.ndarray) -> list[dict]:
        """Return what `Multirotor.step` takes for commands (K, 4)."""
        return [{"cmd_motor_speeds": speeds} for speeds in self.speeds_radps(self.forces(command))]


@register("gym-pybullet-drones CF2X", "rigid body and drag by its published numbers", to=BY_MOTORS)
class PyBulletMotors(PyBulletDrones):
    """The numbers of `assets/cf2x.urdf`; rotors follow at once."""

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""

        def accelerations(matrix, vel, rate, rotors, u):
            rpm = np.sqrt(np.maximum(u, 0.0) * self.MASS_KG * GRAVITY_MPS2 / self.THRUST_N)
            return *self.accelerations(matrix, vel, rate, rpm, SIGNS), 0.0

        return fly(start, command, dt_s, accelerations, np.zeros((len(command), 4)))
