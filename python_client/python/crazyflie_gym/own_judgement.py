"""Rewards and ends of episodes by functions of one's own, over the whole batch at once."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crazyflie_gym._native import Sim, expression_fields
from crazyflie_gym._types import BoolArray, FloatArray

RewardFunction = Callable[..., ArrayLike]
"""A function of fields, by the names of its parameters: `def reward(dist, rate2): ...`."""

Reward = str | RewardFunction | None
"""An expression such as "exp(-4*dist**2) - 0.01*rate2", a function of fields, or None for the task's own."""

_LENGTHS = {field["name"]: field["length"] for field in expression_fields()}


def split_judgement(reward: Reward, termination: Reward) -> tuple[dict[str, Any], dict[str, RewardFunction]]:
    """Return what the simulator does itself, as options, and what functions do.

    Raises:
        TypeError: for what is neither an expression nor a function.
        ValueError: for a function whose parameters are not the names of fields.
    """
    options: dict[str, Any] = {}
    functions: dict[str, RewardFunction] = {}
    for name, given in (("reward", reward), ("termination", termination)):
        if callable(given):
            functions[name] = given
        elif given is None or isinstance(given, str):
            options[name] = given
        else:
            raise TypeError(f"{name}: expected an expression or a function, got {type(given).__name__}")
    if functions:
        wanted = [field for name, function in functions.items() for field in _parameters(name, function)]
        # the time says at which step something was no number
        options["watch"] = list(dict.fromkeys([*wanted, "time_s"]))
    return options, functions


def _parameters(name: str, function: RewardFunction) -> list[str]:
    """Return the fields that a function wants. The simulator rejects unknown names with a proposal."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        parameters = []  # type: ignore[assignment]
    if not parameters or any(p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD, p.POSITIONAL_ONLY) for p in parameters):
        raise ValueError(
            f"{name}: expected a function whose parameters are names of fields, such as `def {name}(dist, rate2)`; "
            "crazyflie_gym.expression_fields() lists them"
        )
    return [p.name for p in parameters if p.default is p.empty or p.name in _LENGTHS]


class CallbackSim(Sim):
    """A simulation whose rewards or ends are those of functions.

    A function gets arrays (num_envs,), of a field of several numbers (num_envs, length); of several drones
    (num_envs, num_drones) and so on. It returns as many rewards, or as many bools, true for flights that end.
    """

    def __new__(
        cls, num_envs: int, options: str = "{}", models: list[str] | None = None, **functions: RewardFunction
    ) -> CallbackSim:
        """Make the simulation; `options` names the fields as `watch`."""
        return super().__new__(cls, num_envs, options, models)

    def __init__(
        self, num_envs: int, options: str = "{}", models: list[str] | None = None, **functions: RewardFunction
    ) -> None:
        asked = json.loads(options)
        self._mode = asked.get("autoreset", "next_step")
        if "termination" in functions and self._mode == "same_step":
            raise ValueError(
                "termination: a function cannot end episodes where the same step resets them: write an expression, or "
                'use autoreset_mode="next_step"'
            )
        self._made_from = (num_envs, options, models, functions)
        self._functions = functions
        self._watched: list[str] = asked["watch"]
        self._wants = {name: _parameters(name, function) for name, function in functions.items()}
        lead = (self.num_envs, self.num_drones) if self.has_drone_axis else (self.num_envs,)
        # a step that only resets is worth nothing
        self._alive: BoolArray = np.ones(lead, np.bool_)

    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray:
        """Begin episodes."""
        rows = super().reset(seeds, mask, observations)
        self._alive[slice(None) if mask is None else mask] = True
        return rows

    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]:
        """Fly one tick."""
        rows, rewards, terminated, truncated, _ = super().step(actions)
        return rows, rewards, terminated, truncated, self._judge(rewards, terminated, truncated)

    def step_into(
        self,
        actions: FloatArray,
        observations: FloatArray,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> int:
        """Fly one tick, into arrays of the caller."""
        super().step_into(actions, observations, rewards, terminated, truncated)
        return self._judge(rewards, terminated, truncated)

    def step_one(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Fly one tick of a batch of one."""
        row, reward, terminated, truncated, info = super().step_one(action)
        rewards, ends = np.array([reward], np.float32), np.array([terminated])
        self._judge(rewards, ends, np.array([truncated]))
        return row, float(rewards[0]), bool(ends[0]), truncated, info

    def rollout_into(self, *_: Any, **__: Any) -> NoReturn:
        """Refuse: functions have to run in every step."""
        names = " and ".join(self._functions)
        raise ValueError(
            f"{names}: a rollout flies many steps without Python: write an expression in place of the function, or "
            "call step() for every step"
        )

    fly_into = rollout_into

    def _judge(self, rewards: FloatArray, terminated: BoolArray, truncated: BoolArray) -> int:
        """Put the functions' answers in place of the task's; return the number of flights that ended."""
        fields = self._fields()
        alive = self._alive
        if "reward" in self._functions:
            answer = self._answer("reward", fields)
            bad = alive & ~np.isfinite(answer)
            if bad.any():
                self._refuse(answer, bad, fields["time_s"])
            rewards[...] = np.where(alive, answer, 0.0)
        if "termination" in self._functions:
            answer = self._answer("termination", fields)
            if answer.dtype != np.bool_:
                raise TypeError(f"termination: expected bools from the function, got {answer.dtype}")
            ends = answer & alive & ~terminated & ~truncated
            if ends.any():
                self.end_flights(ends)
                terminated |= ends
        ended = terminated | truncated
        flying = self.flying()
        if flying is not None:
            self._alive = flying
        elif self._mode == "next_step":
            self._alive = ~ended
        return int(np.count_nonzero(ended))

    def _fields(self) -> dict[str, FloatArray]:
        """Return what was watched, by field."""
        rows, fields, first = self.watched(), {}, 0
        for name in self._watched:
            length = _LENGTHS[name]
            fields[name] = rows[..., first] if length == 1 else rows[..., first : first + length]
            first += length
        return fields

    def _answer(self, name: str, fields: dict[str, FloatArray]) -> NDArray[Any]:
        answer = np.asarray(self._functions[name](**{field: fields[field] for field in self._wants[name]}))
        shape = self._alive.shape
        if answer.shape != shape:
            raise ValueError(f"{name}: expected an array of shape {shape} from the function, got {answer.shape}")
        return answer

    def _refuse(self, answer: NDArray[Any], bad: BoolArray, time_s: FloatArray) -> None:
        """Name the reward that is no number."""
        place = np.unravel_index(int(np.argmax(bad)), bad.shape)
        drone = f", drone {place[1]}" if len(place) > 1 else ""
        raise ValueError(
            f"reward: the function gives {answer[place]} in environment {place[0]}{drone}, at step "
            f"{round(float(time_s[place]) / self.tick_s)} of its episode: expected a finite number"
        )

    def get_state(self) -> bytes:
        """Return all that the flights go on from."""
        return super().get_state() + self._alive.tobytes()

    def set_state(self, state: bytes) -> None:
        """Go on from where another simulation was."""
        size = self._alive.size
        super().set_state(state[:-size])
        self._alive = np.frombuffer(state[-size:], np.bool_).reshape(self._alive.shape).copy()

    def set_copies(self, state: bytes, seeds: NDArray[np.uint64] | None = None) -> None:
        """Let every environment go on from where the one of another simulation was."""
        rows = self._alive.size // self.num_envs
        super().set_copies(state[:-rows], seeds)
        lead = self._alive.shape
        self._alive = np.broadcast_to(np.frombuffer(state[-rows:], np.bool_), (lead[0], rows)).reshape(lead).copy()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what it is made of, for pickling."""
        return _remake, self._made_from, self.get_state()

    def __setstate__(self, state: bytes) -> None:
        """Go on from where the pickled one was."""
        self.set_state(state)


def _remake(num_envs: int, options: str, models: list[str] | None, functions: dict[str, RewardFunction]) -> CallbackSim:
    return CallbackSim(num_envs, options, models, **functions)
