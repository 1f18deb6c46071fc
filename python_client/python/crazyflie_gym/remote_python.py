"""The client of `crazyflie serve` in Python, byte for byte as docs/protocol.md has it; needs the extra `remote`."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym._native import Interface
from crazyflie_gym._types import BoolArray, FloatArray, Steps
from crazyflie_gym.remote_client import REPLY, Client

ACTION, STATE = 4, 12
_RESET, _STEP, _STATE = 1, 2, 3
_STATES, _SEEDS, _MASK = 1, 2, 4
# in the reply to the last step of an attempt; the rows say so as well
_OVER = 2
_REQUEST = struct.Struct("<QBBHI")


class Remote:
    """A connection to a server, and the batch that was begun over it, with the methods of `_native.Remote`."""

    def __init__(self, url: str, token: str | None = None) -> None:
        self._client = Client(url, token)
        self._session: dict[str, Any] = {}
        self._with_states = False
        self._states: FloatArray | None = None
        self._finals: FloatArray = np.empty((0, 0), np.float32)
        self._ended: list[int] = []
        self._flying: BoolArray | None = None
        self._metrics: FloatArray | None = None

    def ask(self, kind: str, fields: str = "{}") -> str:
        """Send a request in JSON and return its reply, JSON."""
        return self._client.ask(kind, fields)

    @property
    def resume_s(self) -> float:
        """For how long a lost session is looked for; at first as the server says."""
        return self._client.resume_s

    @resume_s.setter
    def resume_s(self, resume_s: float) -> None:
        self._client.resume_s = resume_s

    @property
    def resumed(self) -> int:
        """How many lost connections were mended."""
        return self._client.resumed

    def begin(self, kind: str, fields: str, states: bool = False) -> str:
        """Send the request that begins a session and return its reply, JSON."""
        if self._session:
            raise RuntimeError("this connection has a session already")
        reply = self.ask(kind, fields)
        self._session, self._with_states = json.loads(reply), states
        if "token" in self._session:
            self._client.session = self._session["session"], self._session["token"]
        return reply

    def _get(self, key: str) -> Any:
        if not self._session:
            raise RuntimeError("nothing was made yet: call begin() first")
        return self._session[key]

    @property
    def num_envs(self) -> int:
        """Environments in the batch."""
        return int(self._get("num_envs"))

    @property
    def num_drones(self) -> int:
        """Drones in each environment."""
        # an attempt counts its drones as environments
        return 1 if "attempt" in self._session else int(self._get("drones"))

    @property
    def width(self) -> int:
        """Numbers in a drone's observation."""
        return int(self._get("width" if "attempt" in self._session else "observation"))

    @property
    def has_drone_axis(self) -> bool:
        """Whether the task has several drones, so that arrays have an axis of drones."""
        return self._metrics_width > 0

    @property
    def _metrics_width(self) -> int:
        return int(self._session.get("metrics", 0))

    @property
    def _lead(self) -> tuple[int, ...]:
        """The first axes of all arrays."""
        return (self.num_envs, self.num_drones) if self.has_drone_axis else (self.num_envs,)

    def measured(self, observations: FloatArray) -> FloatArray:
        """Return the observations: pictures are drawn from no others (see `make_backend`)."""
        return observations

    def flying(self) -> BoolArray | None:
        """Return which of several drones fly on after the last step."""
        return self._flying

    def metrics(self) -> FloatArray | None:
        """Return what is measured of the episodes of several drones."""
        return self._metrics

    @property
    def tick_s(self) -> float:
        """Seconds per step."""
        return float(self._get("tick_s"))

    @property
    def interface(self) -> Interface:
        """What an action means."""
        return Interface(tick_s=self.tick_s, **self._get("interface"))

    @property
    def max_steps(self) -> int:
        """The most steps of one `step_many`."""
        # the server counts without true states, which make a reply half as long again
        most = int(self._get("max_steps")) if "max_steps" in self._session else 1
        return max(1, most * 2 // 3 if self._with_states else most)

    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray:
        """Begin episodes."""
        n = self.num_envs
        payload = b""
        for what, array, dtype in (("seeds", seeds, np.uint64), ("reset_mask", mask, np.bool_)):
            if array is not None:
                payload += (_check_array(what, array, dtype, (n,)) != 0 if what == "reset_mask" else array).tobytes()
        flags = (0 if seeds is None else _SEEDS) | (0 if mask is None else _MASK)
        parts = self._talk(_RESET, flags, 0, payload)
        shape = (*self._lead, self.width)
        rows = np.zeros(shape, np.float32) if observations is None else observations
        chosen = slice(None) if mask is None else mask != 0
        rows[chosen] = parts[0].reshape(shape)[chosen]
        return rows

    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]:
        """Fly one tick."""
        return self._fly(actions, None)

    def step_into(
        self,
        actions: FloatArray,
        observations: FloatArray,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> int:
        """Fly one tick, into arrays of the caller."""
        observations[:], rewards[:], terminated[:], truncated[:], ended = self.step(actions)
        return ended

    def step_one(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Fly one tick of a batch of one."""
        action = _check_array("action", action, np.float32, (ACTION,))
        rows, rewards, terminated, truncated, _ = self._fly(action[np.newaxis], None)
        return rows[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), {}

    def step_many(self, actions: FloatArray) -> Steps:
        """Fly several ticks in one request."""
        steps = len(actions)
        if not 1 <= steps <= self.max_steps:
            raise ValueError(f"actions: {steps} steps, expected 1 to {self.max_steps}")
        result = self._fly(actions, steps)
        finals = self._finals[:, : self.width].copy()
        if not self._with_states or self._states is None:
            return result, None, finals, None
        states = self._states.reshape(steps, self.num_envs, STATE).copy()
        return result, states, finals, self._finals[:, self.width :].copy()

    def states(self) -> FloatArray:
        """Return the true states."""
        shape = (*self._lead, STATE)
        if self._states is not None:
            return self._states[-self.num_envs * self.num_drones :].reshape(shape).copy()
        return self._talk(_STATE, 0, 0, b"")[2].reshape(shape).copy()

    def last_of_episode(self, env: int) -> tuple[FloatArray, FloatArray | None] | None:
        """Return the last observation and true state of an episode that the last step ended."""
        if env not in self._ended:
            return None
        row = self._finals[self._ended.index(env)].copy()
        own = self.num_drones * self.width
        shape = (self.num_drones,) if self.has_drone_axis else ()
        state = row[own:].reshape(*shape, STATE) if self._with_states else None
        return row[:own].reshape(*shape, self.width), state

    def close(self) -> None:
        """End the session and the connection."""
        self._client.close()

    def _fly(self, actions: FloatArray, steps: int | None) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]:
        lead = self._lead if steps is None else (steps, *self._lead)
        actions = _check_array("actions", actions, np.float32, (*lead, ACTION))
        parts = self._talk(_STEP, 0, 1 if steps is None else steps, actions.tobytes())
        rows, rewards = parts[0].reshape(*lead, self.width).copy(), parts[1].reshape(lead).copy()
        terminated, truncated = ((part != 0).reshape(lead) for part in parts[5:7])
        ends = terminated | truncated
        over = ends
        if self.has_drone_axis:
            self._metrics = parts[3].reshape(-1, self._metrics_width).copy()
            self._flying = (parts[7] != 0).reshape(lead)
            # where one has crashed and others fly on, nothing has ended; who was reset in the same step flies again
            over = ends.any(axis=-1) & self._flying.all(axis=-1)
        self._finals = parts[4].reshape(-1, self._final_numbers)
        self._ended = np.flatnonzero(over).tolist() if len(self._finals) else []
        return rows, rewards, terminated, truncated, int(ends.sum())

    @property
    def _final_numbers(self) -> int:
        """Numbers of the last rows of an environment whose episode ended."""
        return self.num_drones * (self.width + (STATE if self._with_states else 0))

    def _talk(self, kind: int, asked: int, steps: int, payload: bytes) -> list[NDArray[Any]]:
        """Send a binary request and return the parts of its reply: as the protocol orders them, numbers and flags."""
        n, number = self.num_envs, self._client.next_id()
        state_flag = _STATES if self._with_states and kind != _STATE else 0
        reply = self._client.exchange(number, _REQUEST.pack(number, kind, asked | state_flag, steps, n) + payload)
        if not isinstance(reply, bytes):
            raise self._client.unexpected("a text for a binary request")
        _, got_kind, got_flags, got_steps, got_envs, finals, _, _ = REPLY.unpack_from(reply)
        if (got_kind, got_flags & ~_OVER, got_steps, got_envs) != (kind | 128, state_flag, steps, n):
            raise self._client.unexpected("a header that does not fit the request")
        rows, wide = max(1, steps) * n * self.num_drones, STATE if state_flag or kind == _STATE else 0
        step = int(kind == _STEP)
        numbers = [
            rows * self.width * int(kind != _STATE),
            rows * step,
            rows * wide,
            max(1, steps) * n * self._metrics_width * step,
            finals * self._final_numbers,
        ]
        flags = [rows * step, rows * step, rows * step if self.has_drone_axis else 0]
        expected = REPLY.size + 4 * sum(numbers) + sum(flags)
        if len(reply) != expected:
            raise self._client.unexpected(f"{len(reply)} bytes, expected {expected}")
        parts: list[NDArray[Any]] = []
        at = REPLY.size
        layout = [(count, np.dtype("<f4")) for count in numbers] + [(count, np.dtype(np.uint8)) for count in flags]
        for count, dtype in layout:
            parts.append(np.frombuffer(reply, dtype, count, at))
            at += count * dtype.itemsize
        if state_flag:
            self._states = parts[2].reshape(-1, STATE)
        return parts


def _check_array(what: str, array: Any, dtype: Any, shape: tuple[int, ...]) -> Any:
    """Return the array if it is what the native module would take.

    Raises:
        TypeError: for another type or dtype.
        ValueError: for another shape or layout.
    """
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        got = f"dtype {array.dtype}" if isinstance(array, np.ndarray) else type(array).__name__
        raise TypeError(f"{what}: expected a numpy array of {np.dtype(dtype).name} with shape {shape}, got {got}")
    if array.shape != shape:
        raise ValueError(f"{what}: expected shape {shape}, got {array.shape}")
    if not array.flags.c_contiguous:
        raise ValueError(
            f"{what}: expected a C-contiguous array, got one with other strides; numpy.ascontiguousarray makes one"
        )
    return array
