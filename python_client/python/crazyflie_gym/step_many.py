"""Several ticks at once: on a server in as few requests as it allows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from crazyflie_gym._native import Sim
from crazyflie_gym._types import Backend, BoolArray, FloatArray, Observation, Steps

Step = tuple[Observation, FloatArray, BoolArray, BoolArray, dict[str, Any]]
"""Result of a step of a vector environment."""


def check_actions(actions: FloatArray, lead: tuple[int, ...]) -> None:
    """Check all that could stop a flight after its first tick; `lead` is the shape of a tick's rows.

    Raises:
        ValueError: for another shape, and for numbers that are not from -1 to 1.
    """
    check_shape(actions, lead)
    bad = ~(np.abs(actions) <= 1.0)
    if bad.any():
        tick, *place = (int(i) for i in np.argwhere(bad)[0])
        where = "".join(f"[{i}]" for i in place)
        value = actions[(tick, *place)]
        raise ValueError(f"step {tick}: actions{where} is {value}, expected a number from -1 to 1")


def check_shape(actions: FloatArray, lead: tuple[int, ...]) -> None:
    """Check the shape of the actions of several ticks.

    Raises:
        ValueError: for another one than (ticks, *lead, 4).
    """
    if actions.shape[1:] != (*lead, 4) or len(actions) == 0:
        shape = ", ".join(["ticks", *map(str, lead), "4"])
        raise ValueError(f"actions: expected shape ({shape}) with at least one tick, got {actions.shape}")


def fly_steps(sim: Backend, actions: FloatArray, with_states: bool) -> Steps:
    """Fly the ticks of `actions`, float32 (ticks, num_envs, 4); see `Steps` for what is returned."""
    if isinstance(sim, Sim):
        return _join_replies([_fly_step(sim, tick, with_states) for tick in actions])
    most = sim.max_steps
    return _join_replies([sim.step_many(actions[at : at + most]) for at in range(0, len(actions), most)])


def join_steps(steps: Sequence[Step]) -> Step:
    """Return the results of several steps with an axis of ticks in front; see `CrazyflieVectorEnv.step_many`."""
    rows, rewards, terminated, truncated, infos = zip(*steps, strict=True)
    joined: dict[str, Any] = {}
    for name in ("drone_rewards", "flying", "metrics", "true_state", "cost"):
        if name in infos[0]:
            joined[name] = np.stack([info[name] for info in infos])
    ends = [info for info in infos if "final_obs" in info]
    last = [row for info in ends for row in info["final_obs"][info["_final_obs"]]]
    if last:
        joined["final_obs"] = _stack_observations(last)
        states = [info["final_info"]["true_state"][info["_final_obs"]] for info in ends if info["final_info"]]
        if states:
            joined["final_true_state"] = np.concatenate(states)
    return _stack_observations(rows), np.stack(rewards), np.stack(terminated), np.stack(truncated), joined


def _stack_observations(observations: Sequence[Observation]) -> Observation:
    first = observations[0]
    if isinstance(first, dict):
        return {name: np.stack([row[name] for row in observations if isinstance(row, dict)]) for name in first}
    return np.stack([row for row in observations if not isinstance(row, dict)])


def _fly_step(sim: Sim, actions: FloatArray, with_states: bool) -> Steps:
    rows, rewards, terminated, truncated, ended = sim.step(actions)
    last = [sim.last_of_episode(int(env)) for env in np.flatnonzero(terminated | truncated)]
    finished = [pair for pair in last if pair is not None]
    finals = np.array([row for row, _ in finished], np.float32).reshape(-1, sim.width)
    step = (rows[np.newaxis], rewards[np.newaxis], terminated[np.newaxis], truncated[np.newaxis], ended)
    if not with_states:
        return step, None, finals, None
    final_states = np.array([state for _, state in finished], np.float32).reshape(-1, 12)
    return step, sim.states()[np.newaxis], finals, final_states


def _join_replies(parts: list[Steps]) -> Steps:
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
