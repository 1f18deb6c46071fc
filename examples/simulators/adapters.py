"""Simulators behind one method, `predict`, and the register of them.

To add one, write a class with `predict` and put `@register("its name", "what it is")` before it, in a module that
`compare.py` imports; `peers.py` has examples. Its constructor imports what it needs: a `ModuleNotFoundError` becomes
the row "not installed".
"""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
from real_flights import ATT, DT_S, GRAVITY_MPS2, POS, RATE, VEL, Start, body_rates, euler_rates

# the firmware's gain from a yaw error to a yaw rate, 1/s (platform_defaults_cf2.h: PID_YAW_KP)
YAW_GAIN_PS = 6.0


class Simulator(Protocol):
    """What is compared."""

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """Return the states (W, K + 1, 12) of W flights of K steps of `dt_s`, the first one being `start.state`.

        A state is position m, velocity m/s, roll, pitch, yaw rad, body rates rad/s. Commands (W, K, 4) are roll, pitch,
        yaw in rad and the thrust as a multiple of the weight, or such forces of motors 1 to 4; each holds for one step.
        Frames are right-handed, z up.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Entry:
    """A line of the register.

    Attributes:
        make: makes the simulator, of the path of its fitted model, or of None.
        about: what it is.
        model: which fitted model it needs, a key of FITS, or None.
    """

    make: Callable[[Path | None], Simulator]
    about: str
    model: str | None = None


# by attitude and thrust, and by the forces of the motors
SIMULATORS: dict[str, Entry] = {}
BY_MOTORS: dict[str, Entry] = {}

# commands of `crazyflie` that fit our models to the flights of the fit
FITS = {
    "identified": ["identify", "--effects", "none"],
    "with_effects": ["identify"],
    "explained": ["explain"],
}


def crazyflie(*words: object) -> str:
    """Return what the command line prints.

    Raises:
        subprocess.CalledProcessError: if it fails; it has said why.
    """
    command = [sys.executable, "-m", "crazyflie_gym", *map(str, words)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def register(
    name: str, about: str, model: str | None = None, to: dict[str, Entry] | None = None, **options: object
) -> Callable[[type], type]:
    """Put a class into SIMULATORS or another register.

    It is made with `options`, and with `path`, that of its model, if it has one.
    """

    def put(kind: type) -> type:
        def make(path: Path | None) -> Simulator:
            return kind(**options) if model is None else kind(path=path, **options)

        (SIMULATORS if to is None else to)[name] = Entry(make, about, model)
        return kind

    return put


@register("ours, identified linear", "the same model, its numbers by `crazyflie identify --effects none`", "identified")
@register("ours, thesis", "the built-in model, linear, of another vehicle")
class Linear:
    """A model file without effects: `crazyflie_gym.linear.state_space`, one exact step at a time."""

    def __init__(self, path: Path | None = None):
        from crazyflie_gym import linear

        a, b, *_ = linear.state_space(model=path, vertical="thrust")
        self.a, self.b = a, b

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`. The equations of motion have no yaw: they hold along the heading of the start."""
        step_a, step_b = _discrete(self.a, self.b, dt_s)
        # rows of the model: position, angles, velocity, derivatives of the angles
        order = [0, 1, 2, 6, 7, 8, 3, 4, 5, 9, 10, 11]
        heading = _headings(start.state[:, 8])
        x = _along(start.state, heading)
        x[:, RATE] = euler_rates(x[:, ATT], x[:, RATE])
        # the model's yaw is of first order: in the place of its rate is what is left of a push
        x[:, 11] = 0.0
        x = x[:, order]
        states = [x]
        for u in np.moveaxis(command, 1, 0):
            yaw_rate = YAW_GAIN_PS * (u[:, 2] - x[:, 5]) / self.b[5, 2]
            # counts of PWM above those at rest: one weight accelerates by g
            lift = (u[:, 3] - 1.0) * GRAVITY_MPS2 / self.b[8, 3]
            x = x @ step_a.T + np.stack([u[:, 0], u[:, 1], yaw_rate, lift], -1) @ step_b.T
            states.append(x)
        flown = np.stack(states, 1)[..., order]
        flown[..., 11] = np.gradient(flown[..., 8], dt_s, axis=1)
        flown[..., RATE] = body_rates(flown[..., ATT], flown[..., RATE])
        flown = _along(flown, heading, back=True)
        flown[:, 0] = start.state
        return flown


@register("ours, explained", "the linear model with the effects that `crazyflie explain` adds to it", "explained")
@register("ours, identified", "model and effects by `crazyflie identify`", "with_effects")
class WithEffects:
    """A model with effects: the simulator's own step, recorded for JAX, led along the past so that lags are filled."""

    # beyond these an action is clipped
    TILT_MAX_DEG, WEIGHTS_MAX = 60.0, 3.0
    # the rule for the thrust has its curve, and its hover is of the last seconds: for all simulators
    IN_THE_RULE = ("motor_warming", "thrust_slope")

    def __init__(self, path: Path):
        import jax

        import crazyflie_gym.jax

        self.jax = jax
        model = json.loads(path.read_text())
        self.effects = sorted(set(model.get("effects", {})) - set(self.IN_THE_RULE))
        model["effects"] = {name: model["effects"][name] for name in self.effects}
        model["rig"]["control"]["value"] = 1.0 / DT_S
        model["command"]["tilt_max"]["value"] = self.TILT_MAX_DEG
        # a PWM is a unit of thrust here: any will do
        model["vertical"]["thrust"]["hover"]["value"] = model["command"]["pwm_max"]["value"] / self.WEIGHTS_MAX
        self.yaw_gain = model["yaw"]["gain"]["value"]
        self.yaw_rate_max_radps = np.radians(model["command"]["yaw_rate_max"]["value"])
        self.env = crazyflie_gym.jax.make("Crazyflie-v0", model=model, vertical="thrust", starts=1)

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`.

        Raises:
            ValueError: for another step than that of the recorded environment.
        """
        if not np.isclose(dt_s, self.env.tick_s):
            raise ValueError(f"dt_s: expected {self.env.tick_s}, got {dt_s}")
        jax, jnp = self.jax, self.jax.numpy
        past, ahead = start.past_command.shape[1], command.shape[1]
        measured = np.concatenate([start.past_state, np.repeat(start.state[:, np.newaxis], ahead, 1)], 1)
        measured[..., RATE] = euler_rates(measured[..., ATT], measured[..., RATE])
        rows = np.concatenate([measured, np.concatenate([start.past_command, command], 1)], -1)

        def tick(state, at):
            i, row = at
            parts = zip(self.env.true_state(state), (POS, VEL, ATT, RATE), strict=True)
            seen = {name: tuple(row[:, part].T) for name, part in parts}
            # the climb is kept in the first lag; the second is that of a push on the yaw
            seen = state._replace(**seen, lag=(row[:, 5], 0.0 * row[:, 5]))
            state = jax.tree.map(lambda known, flown: jnp.where(i <= past, known, flown), seen, state)
            before = jnp.concatenate(list(self.env.true_state(state).values()), -1)
            yaw_rate = YAW_GAIN_PS * (row[:, 14] - before[:, 8]) / (self.yaw_gain * self.yaw_rate_max_radps)
            tilt = row[:, 12:14] / np.radians(self.TILT_MAX_DEG)
            thrust = 2.0 * row[:, 15] / self.WEIGHTS_MAX - 1.0
            action = jnp.concatenate([tilt, yaw_rate[:, np.newaxis], thrust[:, np.newaxis]], -1)
            after = self.env.step_env(key, state, action)[1]
            return after, jnp.concatenate(list(self.env.true_state(after).values()), -1)

        key = jax.random.key(0)
        _, state = self.env.reset(key, num_envs=len(rows))
        steps = jnp.arange(rows.shape[1]), jnp.asarray(np.moveaxis(rows, 1, 0), self.env.dtype)
        flown = np.moveaxis(np.asarray(jax.jit(lambda s, r: jax.lax.scan(tick, s, r)[1])(state, steps), float), 0, 1)
        states = np.concatenate([start.state[:, np.newaxis], flown[:, past:]], 1)
        # yaw is of first order: its rate is not a state
        states[:, 1:, 11] = np.gradient(states[..., 8], dt_s, axis=1)[:, 1:]
        states[:, 1:, RATE] = body_rates(states[:, 1:, ATT], states[:, 1:, RATE])
        return states


@register("nothing moves on", "the state stays as it was", to=BY_MOTORS)
@register("nothing moves on", "the state stays as it was")
class Persist:
    """The state of the start, for ever."""

    def predict(self, start: Start, command: np.ndarray, dt_s: float) -> np.ndarray:
        """See `Simulator`."""
        return np.repeat(start.state[:, np.newaxis], command.shape[1] + 1, axis=1)


def _discrete(a: np.ndarray, b: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact step of x' = a x + b u over `dt_s` with u held: matrices (n, n) and (n, m)."""
    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n] = np.concatenate([a, b], 1) * dt_s
    halvings = 10
    term = power = np.eye(n + m)
    for k in range(1, 12):
        term = term @ block / (2.0**halvings * k)
        power = power + term
    for _ in range(halvings):
        power = power @ power
    return power[:n, :n], power[:n, n:]


def _headings(yaw_rad: np.ndarray) -> np.ndarray:
    """Return turns (W, 3, 3) by yaw angles (W,) about the vertical."""
    c, s, o = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)
    return np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, o + 1.0], -1)], -2)


def _along(states: np.ndarray, heading: np.ndarray, back: bool = False) -> np.ndarray:
    """Return states (W, ..., 12) with positions and velocities along headings (W, 3, 3), or back again."""
    turned = states.copy()
    rule = "wij,w...j->w...i" if back else "wji,w...j->w...i"
    for part in (POS, VEL):
        turned[..., part] = np.einsum(rule, heading, states[..., part])
    return turned
