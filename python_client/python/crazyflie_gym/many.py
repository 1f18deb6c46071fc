"""Several ticks at once: on a server in as few requests as it allows."""

from __future__ import annotations

import numpy as np

from crazyflie_gym._native import Sim
from crazyflie_gym._types import FloatArray, Steps
from crazyflie_gym.core import RemoteCore
from crazyflie_gym.spaces import WIDTH


def check(actions: FloatArray, num_envs: int) -> None:
    """Check all that could stop a flight after its first tick.

    Raises:
        ValueError: for another shape, and for numbers that are not from -1 to 1.
        TypeError: for another type.
    """
    if not isinstance(actions, np.ndarray):
        raise TypeError(f"actions: expected a numpy array of float32, got {type(actions).__name__}")
    if actions.ndim != 3 or actions.shape[1:] != (num_envs, 4) or len(actions) == 0:
        raise ValueError(f"actions: expected shape (ticks, {num_envs}, 4) with at least one tick, got {actions.shape}")
    bad = ~(np.abs(actions) <= 1.0)
    if bad.any():
        tick, env, axis = np.argwhere(bad)[0]
        value = actions[tick, env, axis]
        raise ValueError(f"step {tick}: actions[{env}][{axis}] is {value}, expected a number from -1 to 1")


def fly(sim: Sim | RemoteCore, actions: FloatArray, with_states: bool) -> Steps:
    """Fly the ticks of `actions`, float32 (ticks, num_envs, 4); see `_native.Remote.step_many` for what is returned."""
    if isinstance(sim, Sim):
        return _joined([_one(sim, tick, with_states) for tick in actions])
    most = sim.max_steps
    return _joined([sim.step_many(actions[at : at + most]) for at in range(0, len(actions), most)])


def _one(sim: Sim, actions: FloatArray, with_states: bool) -> Steps:
    rows, rewards, terminated, truncated, ended = sim.step(actions)
    last = [sim.last_of_episode(int(env)) for env in np.flatnonzero(terminated | truncated)]
    known = [pair for pair in last if pair is not None]
    finals = np.array([row for row, _ in known], np.float32).reshape(-1, WIDTH)
    step = (rows[np.newaxis], rewards[np.newaxis], terminated[np.newaxis], truncated[np.newaxis], ended)
    if not with_states:
        return step, None, finals, None
    final_states = np.array([state for _, state in known], np.float32).reshape(-1, 12)
    return step, sim.states()[np.newaxis], finals, final_states


def _joined(parts: list[Steps]) -> Steps:
    if len(parts) == 1:
        return parts[0]
    steps = [part[0] for part in parts]
    rows, rewards = np.concatenate([step[0] for step in steps]), np.concatenate([step[1] for step in steps])
    terminated, truncated = np.concatenate([step[2] for step in steps]), np.concatenate([step[3] for step in steps])
    states = [part[1] for part in parts if part[1] is not None]
    final_states = [part[3] for part in parts if part[3] is not None]
    return (
        (rows, rewards, terminated, truncated, sum(step[4] for step in steps)),
        np.concatenate(states) if states else None,
        np.concatenate([part[2] for part in parts]),
        np.concatenate(final_states) if final_states else None,
    )
