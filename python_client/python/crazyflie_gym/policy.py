"""A policy as JAX sees it: what it makes of observations, its network, and its file, which Rust flies without Python.

Position, velocity and heading come from the Kalman filter that LQR flies with (`observation="estimate"`); in Rust the
filter runs inside the policy. Beside them there is, for a few signals and time constants, how far each signal is from
its own moving average: that tells how fast a set-point moves, and what an error adds up to. The network's output is a
linear function of the features plus a multi-layer perceptron, so that it can begin as a linear controller.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import save_file

from crazyflie_gym.spaces import RowLayout
from crazyflie_gym.training import OBSERVED

FORMAT = "crazyflie-policy-2"
LAYOUT = RowLayout(OBSERVED)
PRESENT = 19  # position error, velocity, push (3 each), yaw error, roll, pitch, gyro (3), last action from level (4)
SIGNALS = 12  # position error (3), roll, pitch, last action from level (4), set-point (3)
CLIP = 5.0  # normalised features beyond so many standard deviations are cut off

Array = jax.Array
Layers = list[tuple[Any, Any]]


@dataclass(frozen=True)
class Policy:
    """Weights and biases of the layers, the linear function beside them (features, 4), mean and standard deviation of
    the features, time constants in seconds."""

    layers: Layers
    skip: NDArray[np.float32]
    mean: NDArray[np.float32]
    std: NDArray[np.float32]
    taus_s: tuple[float, ...]
    tick_s: float

    def save(self, path: str | Path, note: str = "") -> None:
        """Write a safetensors file; `note` says how it was trained."""
        tensors = {"feature_mean": self.mean, "feature_std": self.std, "taus_s": np.asarray(self.taus_s, np.float32)}
        tensors["skip.weight"] = self.skip
        for number, (weight, bias) in enumerate(self.layers):
            tensors |= {f"layer{number}.weight": weight, f"layer{number}.bias": bias}
        plain = {name: np.ascontiguousarray(tensor, np.float32) for name, tensor in tensors.items()}
        save_file(plain, path, {"format": FORMAT, "tick_s": json.dumps(self.tick_s), "note": note})

    @staticmethod
    def load(path: str | Path) -> Policy:
        """Read what `save` wrote.

        Raises:
            ValueError: if it is another file.
        """
        with safe_open(path, framework="numpy") as file:
            about = file.metadata() or {}
            if about.get("format") != FORMAT:
                raise ValueError(f"{path}: expected a policy ({FORMAT}), found {about.get('format')!r}")
            tensor = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  not a mapping
        count = sum(name.startswith("layer") and name.endswith(".weight") for name in tensor)
        layers = [(tensor[f"layer{n}.weight"], tensor[f"layer{n}.bias"]) for n in range(count)]
        taus_s = tuple(float(tau) for tau in tensor["taus_s"])
        mean, std = tensor["feature_mean"], tensor["feature_std"]
        return Policy(layers, tensor["skip.weight"], mean, std, taus_s, json.loads(about["tick_s"]))


def width(taus: int) -> int:
    """Return how many features there are for so many time constants."""
    return PRESENT + SIGNALS * taus


def level(interface: Any) -> NDArray[np.float32]:
    """Return the action that holds the vehicle level and carries its weight: what the network's output is added to."""
    return np.array([0, 0, 0, 2 * interface.hover_lift / interface.lift_max - 1], np.float32)


def rotated(vectors: Array, yaw: Array) -> Array:
    """Return world vectors (..., 3) in a frame that is turned by the yaw (...)."""
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return jnp.stack([c * x + s * y, c * y - s * x, z], -1)


def features(o: Array, averages: Array, fresh: Array, gains: Any, rest: Any) -> tuple[Array, Array]:
    """Return features (n, width) and new averages (n, taus, SIGNALS) of observations (n, numbers of OBSERVED).

    Args:
        o: observations.
        averages: what the last call returned; where `fresh` (n,) is true a flight begins, and they are not read.
        fresh: see above.
        gains: tick / (tau + tick) for each time constant.
        rest: the level action.
    """
    f: Any = LAYOUT.split(cast("Any", o))
    yaw, setpoint, tilt = f["est_yaw_rad"][:, 0], f["setpoint"], f["attitude_rad"][:, :2]
    goal = setpoint[:, :3]
    signals = jnp.concatenate([goal - f["est_pos_m"], tilt, f["last_action"] - rest, goal], -1)
    now = signals[:, None]
    averages = jnp.where(fresh[:, None, None], now, averages + gains[:, None] * (now - averages))
    off = now - averages
    turned = jnp.broadcast_to(yaw[:, None], off.shape[:2])
    off = jnp.concatenate([rotated(off[..., 0:3], turned), off[..., 3:9], rotated(off[..., 9:12], turned)], -1)
    turn = setpoint[:, 3] - yaw
    turn = turn - 2 * jnp.pi * jnp.round(turn / (2 * jnp.pi))
    vectors = [rotated(v, yaw) for v in (signals[:, 0:3], f["est_vel_mps"], f["est_push_mps2"])]
    present = [*vectors, turn[:, None], tilt, f["gyro_radps"], signals[:, 5:9]]
    return jnp.concatenate([*present, off.reshape(len(o), -1)], -1), averages


def gains(taus_s: tuple[float, ...], tick_s: float) -> NDArray[np.float32]:
    """Return the gains of the moving averages."""
    taus = np.asarray(taus_s, np.float32)
    return np.float32(tick_s) / (taus + np.float32(tick_s))


def normalised(x: Array, mean: Any, std: Any) -> Array:
    """Return features or states in standard deviations, cut off."""
    return jnp.clip((x - mean) / std, -CLIP, CLIP)


def mlp(layers: Layers, x: Array) -> Array:
    """Return the output of a network with tanh between its layers."""
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = layers[-1]
    return jnp.add(x @ weight, bias)


def output(layers: Layers, skip: Any, x: Array) -> Array:
    """Return the action from level: the linear function plus the network."""
    return jnp.add(x @ skip, mlp(layers, x))


class Pilot:
    """A policy that flies `num_envs` environments with the command interface `interface`, in JAX, for its trainer."""

    def __init__(self, policy: Policy, num_envs: int, interface: Any) -> None:
        self._fresh = np.ones(num_envs, np.bool_)
        self._averages = jnp.zeros((num_envs, len(policy.taus_s), SIGNALS))
        pull, rest = gains(policy.taus_s, policy.tick_s), level(interface)

        @jax.jit
        def act(o: Array, averages: Array, fresh: Array) -> tuple[Array, Array]:
            x, averages = features(o, averages, fresh, pull, rest)
            return jnp.clip(
                rest + output(policy.layers, policy.skip, normalised(x, policy.mean, policy.std)), -1, 1
            ), averages

        self._act = act

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return actions (n, 4) for observations of `OBSERVED`."""
        actions, self._averages = self._act(observations, self._averages, self._fresh)
        self._fresh = np.zeros_like(self._fresh)
        return np.asarray(actions)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the flights of all environments, or of those of `mask`."""
        self._fresh |= np.True_ if mask is None else mask
