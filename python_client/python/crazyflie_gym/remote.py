"""Requests to a server, `crazyflie serve`, and environments there; docs/protocol.md defines the messages.

    env = gymnasium.make("Crazyflie-v0", remote="ws://127.0.0.1:8765")
    envs = gymnasium.make_vec("Crazyflie-v0", num_envs=1024, remote="wss://lab.example")

    server = Client("ws://127.0.0.1:8765")
    attempt = server.ask("benchmark", scenario="hover-aruco", controller="mine", token="cft_...")
    result = server.ask("step", action=actions)  # and so on, until result["over"]; then server.ask("finish")

Needs the extra `remote`.
"""

from __future__ import annotations

import json
import math
import operator
import os
import struct
import time
import weakref
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym._native import Controller, Crowd, Interface
from crazyflie_gym._types import BoolArray, FloatArray, Steps
from crazyflie_gym.options import to_json
from crazyflie_gym.spaces import MEASURED, RowLayout

try:
    from websockets.exceptions import ConnectionClosed, InvalidHandshake
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol
except ModuleNotFoundError as error:
    hint = 'pip install "crazyflie-gym[remote]" brings it'
    raise ModuleNotFoundError(f"remote: {error}; {hint}", name=error.name) from None

TOKEN = "CRAZYFLIE_TOKEN"
"""The environment variable with a team's token, for servers that want one."""
_RESET, _STEP, _STATE = 1, 2, 3
_STATES, _SEEDS, _MASK = 1, 2, 4
_REQUEST, _REPLY = struct.Struct("<QBBHI"), struct.Struct("<QBBHIIIQ")
# close codes of a connection whose session waits: none came, and no answers to pings
_WAITING = (1005, 4002)
# for how long a request is repeated that the server cannot carry out at the moment
_UNAVAILABLE_S = 60.0
# codes that blame the arguments, as opposed to the moment
_ARGUMENT = {
    *("bad_message", "bad_frame", "wrong_length", "bad_action", "bad_options", "bad_model", "bad_token", "bad_name"),
    *("bad_shape", "too_large", "unknown_scenario", "unknown_world", "unknown_drone"),
}
_RESULT = ("observations", "rewards", "terminated", "truncated")


class LostError(ConnectionError):
    """The connection is gone; the session may be waiting."""


class Client:
    """A connection to a server; a session that was begun over it is resumed over a new one if it is lost.

    Args:
        url: ws://host:port or wss://host:port; the path is /ws unless another one is given.
        token: a team's, by default from the environment variable `CRAZYFLIE_TOKEN`.

    Raises:
        ValueError: for another kind of URL.
        ConnectionError: if nobody answers there.
    """

    def __init__(self, url: str, token: str | None = None) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("ws", "wss") or not parts.hostname:
            raise ValueError(f"remote is {url!r}, expected ws://host:port or wss://host:port")
        if parts.username or parts.password:
            raise ValueError(f"remote: a URL gets into logs; give the token in the environment variable {TOKEN}")
        self.url = urlunsplit(parts._replace(path="/ws" if parts.path in ("", "/") else parts.path, fragment=""))
        self.resumed = 0
        """Number of lost connections that were restored."""
        self._hello = to_json(id=0, type="hello", client="crazyflie_gym", token=token or os.environ.get(TOKEN))
        self._id, self._resume = 0, ""
        self._limits: dict[str, Any] = {"idle_s": 60.0}
        self._limits = self._connect()
        self.resume_s: float = self._limits["resume_s"]
        """For how long a lost session is looked for; at first as the server says."""

    def _connect(self) -> Any:
        try:
            # entered and never left: it is closed by hand, like the environment that has it
            self._ws = connect(
                self.url,
                subprotocols=[Subprotocol("crazyflie.v1")],
                compression=None,
                max_size=None,
                # the server pings; a server that is paused for a minute is not lost
                ping_interval=None,
                close_timeout=1.0,
                proxy=None,
            ).__enter__()
        except (OSError, InvalidHandshake, EOFError) as error:
            raise LostError(f"no connection to {self.url}: {error}") from None
        # its thread would keep it open
        weakref.finalize(self, self._ws.close)
        return self._try(0, self._hello)

    def ask(self, kind: str, **fields: Any) -> dict[str, Any]:
        """Send a request in JSON and return its reply. Fields that are None are left out.

        Raises:
            ValueError: for what the server refuses, in its words.
            RuntimeError: for what it refuses at this moment.
            ConnectionError: if the connection is lost and cannot be resumed.
        """
        number = self.next_id()
        text = to_json(**fields, id=number, type=kind)
        if len(text) > self._limits["max_text_bytes"]:
            raise ValueError(
                f"{kind}: a message of {len(text)} bytes, the server takes {self._limits['max_text_bytes']}"
            )
        reply: dict[str, Any] = self.exchange(number, text)
        if kind == "make":
            self._resume = to_json(id=0, type="resume", session=reply["session"], token=reply["token"])
        return reply

    def next_id(self) -> int:
        """Return the id of the next request; its repetition has the same, so that it is carried out once."""
        self._id += 1
        return self._id

    def exchange(self, number: int, request: str | bytes) -> Any:
        """Send a request and return its reply, bytes or parsed JSON; over a new connection if necessary.

        Raises:
            Exception: as `ask`.
        """
        try:
            return self._try(number, request)
        except LostError as lost:
            if not self._resume:
                raise
            self._reconnect(lost)
        return self._try(number, request)

    def _try(self, number: int, request: str | bytes) -> Any:
        """Send a request and return its reply; again while the server is unavailable."""
        until = time.monotonic() + _UNAVAILABLE_S
        while True:
            answer = self._try_once(number, request)
            if not isinstance(answer, dict) or answer["type"] != "error":
                return answer
            wait_s = answer.get("retry_after_s") if answer["code"] == "unavailable" else None
            if wait_s is None or time.monotonic() >= until:
                raise (ValueError if answer["code"] in _ARGUMENT else RuntimeError)(answer["message"])
            time.sleep(wait_s)

    def _try_once(self, number: int, request: str | bytes) -> Any:
        try:
            self._ws.send(request)
            got = -1
            # a smaller id is of a request whose caller was interrupted
            while got is not None and got < number:
                reply = self._ws.recv(timeout=self._limits["idle_s"])
                answer: Any = reply if isinstance(reply, bytes) else json.loads(reply)
                got = _REPLY.unpack_from(reply)[0] if isinstance(reply, bytes) else answer["id"]
        except ConnectionClosed as closed:
            frame = closed.rcvd
            if frame is None or frame.code in _WAITING:
                raise LostError(f"the connection to {self.url} was lost: {closed}") from None
            why = f"{frame.reason} (close code {int(frame.code)})"
            raise ConnectionError(f"the connection to {self.url} has ended: {why}") from None
        except TimeoutError:
            raise LostError(f"the connection to {self.url} was lost: no reply in time") from None
        return answer

    def _reconnect(self, lost: LostError) -> None:
        """Connect anew and take the session up again."""
        until = time.monotonic() + self.resume_s
        while True:
            try:
                self._connect()
                self._try(0, self._resume)
            except LostError:
                if time.monotonic() >= until:
                    raise lost from None
            except (ValueError, RuntimeError) as refused:
                raise ConnectionError(f"the connection to {self.url} has ended: {lost}; {refused}") from None
            else:
                self.resumed += 1
                return
            time.sleep(0.1)

    def close(self) -> None:
        """Close the connection; the server ends the session."""
        self._resume = ""
        self._ws.close()


class RemoteSim:
    """A batch of environments on a server, with the methods of `Sim`; `options` is JSON, `model` the text of a file.

    Raises:
        TypeError: for a number of environments that is not an integer.
        Exception: as `Client` and its `ask`.
    """

    def __init__(self, url: str, num_envs: int, options: str, model: str | None, states: bool) -> None:
        num_envs = operator.index(num_envs)
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}, expected at least 1")
        self.client = Client(url)
        chosen = json.loads(options)
        made = self.client.ask("make", num_envs=num_envs, options=chosen, model=model)
        self._observation = chosen.get("observation", "measured")
        self.num_envs: int = made["num_envs"]
        self.num_drones: int = made["drones"]
        self.width: int = made["observation"]
        self.tick_s: float = made["tick_s"]
        self.interface = Interface(tick_s=self.tick_s, **made["interface"])
        self._metrics_width: int = made["metrics"]
        self.has_drone_axis = self._metrics_width > 0
        # the server counts without true states, which make a reply half as long again
        self.max_steps = max(1, made["max_steps"] * 2 // 3 if states else made["max_steps"])
        self._lead = (self.num_envs, self.num_drones) if self.has_drone_axis else (self.num_envs,)
        self._with_states = states
        self._last: dict[str, NDArray[Any]] = {}

    def _talk(self, kind: int, flags: int, steps: int, payload: bytes) -> dict[str, NDArray[Any]]:
        """Send a binary request and return the parts of its reply, with an axis of steps in front."""
        flags |= _STATES if self._with_states and kind != _STATE else 0
        number = self.client.next_id()
        reply = self.client.exchange(number, _REQUEST.pack(number, kind, flags, steps, self.num_envs) + payload)
        lead, step = (max(1, steps), *self._lead), kind == _STEP
        own = self.num_drones * (self.width + (12 if self._with_states else 0))
        layout: list[tuple[str, Any, tuple[int, ...], bool]] = [
            ("observations", np.float32, (*lead, self.width), kind != _STATE),
            ("rewards", np.float32, lead, step),
            ("states", np.float32, (*lead, 12), kind == _STATE or self._with_states),
            ("metrics", np.float32, (lead[0], self.num_envs, self._metrics_width), step),
            ("finals", np.float32, (_REPLY.unpack_from(reply)[5], own), True),
            ("terminated", np.bool_, lead, step),
            ("truncated", np.bool_, lead, step),
            ("flying", np.bool_, lead, step and self.has_drone_axis),
        ]
        parts, at = {}, _REPLY.size
        for name, dtype, shape, sent in layout:
            part = np.frombuffer(reply, dtype, math.prod(shape) if sent else 0, at)
            at += part.nbytes
            if sent:
                parts[name] = part.reshape(shape).copy()
        if at != len(reply):
            raise ConnectionError(f"{self.client.url} answers with {len(reply)} bytes, expected {at}")
        if kind != _STATE:
            self._last = parts
        return parts

    def reset(
        self,
        seeds: NDArray[np.uint64] | None = None,
        mask: BoolArray | None = None,
        observations: FloatArray | None = None,
    ) -> FloatArray:
        """Begin episodes."""
        payload = b"".join(array.tobytes() for array in (seeds, mask) if array is not None)
        flags = (0 if seeds is None else _SEEDS) | (0 if mask is None else _MASK)
        begun: FloatArray = self._talk(_RESET, flags, 0, payload)["observations"][0]
        if observations is None:
            return begun
        chosen = slice(None) if mask is None else mask
        observations[chosen] = begun[chosen]
        return observations

    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, int]:
        """Fly one tick."""
        parts = self._talk(_STEP, 0, 1, _bytes("actions", actions, (*self._lead, 4)))
        rows, rewards, terminated, truncated = (parts[name][0] for name in _RESULT)
        return rows, rewards, terminated, truncated, int((terminated | truncated).sum())

    def step_one(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Fly one tick of a batch of one."""
        parts = self._talk(_STEP, 0, 1, _bytes("action", action, (4,)))
        row, reward, terminated, truncated = (parts[name][0, 0] for name in _RESULT)
        return row, float(reward), bool(terminated), bool(truncated), {}

    def step_many(self, actions: FloatArray) -> Steps:
        """Fly several ticks in one request, at most `max_steps`."""
        parts = self._talk(_STEP, 0, len(actions), _bytes("actions", actions, (len(actions), *self._lead, 4)))
        rows, rewards, terminated, truncated = (parts[name] for name in _RESULT)
        step = rows, rewards, terminated, truncated, int((terminated | truncated).sum())
        finals, states = np.split(parts["finals"], [self.width], axis=1)
        return step, parts.get("states"), finals, states if self._with_states else None

    def measured(self, observations: FloatArray) -> FloatArray:
        """Return measured rows for a picture: NaN where the observations lack a field (see `make_backend`)."""
        if self._observation == "measured":
            return observations
        rows = np.full((*self._lead, MEASURED.width), np.nan, np.float32)
        known = RowLayout(self._observation).split(observations)
        for name, numbers in MEASURED.split(rows).items():
            if name in known:
                numbers[...] = known[name]
        return rows

    def act(self, controller: Controller | Crowd, observations: FloatArray) -> FloatArray:
        """Return the actions of a controller, which reads measured rows.

        Raises:
            ValueError: for other observations: a server sends nothing beside them.
        """
        if self._observation != "measured":
            raise ValueError(
                f'controller: on a server it reads the observations, expected observation="measured", got '
                f"{self._observation!r}"
            )
        return controller.act(observations)

    def flying(self) -> BoolArray | None:
        """Return which of several drones fly on after the last step."""
        return self._last["flying"][-1] if "flying" in self._last else None

    def metrics(self) -> FloatArray | None:
        """Return what is measured of the episodes of several drones."""
        return self._last["metrics"][-1] if self.has_drone_axis else None

    def states(self) -> FloatArray:
        """Return the true states."""
        parts = self._last if self._with_states else self._talk(_STATE, 0, 0, b"")
        states: FloatArray = parts["states"][-1]
        return states.copy()

    def last_of_episode(self, env: int) -> tuple[FloatArray, FloatArray | None] | None:
        """Return the last observation and true state of an episode that the last step ended."""
        over = (self._last["terminated"] | self._last["truncated"])[-1]
        if self.has_drone_axis:
            # an episode has not ended while any drone flies on; a drone reset in the same step flies again
            over = over.any(axis=-1) & self._last["flying"][-1].all(axis=-1)
        if not len(self._last["finals"]) or not over[env]:
            return None
        row, shape = self._last["finals"][int(over[:env].sum())], self._lead[1:]
        rows, states = np.split(row, [self.num_drones * self.width])
        return rows.reshape(*shape, self.width), states.reshape(*shape, 12) if self._with_states else None

    def close(self) -> None:
        """End the session and the connection."""
        self.client.close()


def _bytes(what: str, array: Any, shape: tuple[int, ...]) -> bytes:
    if not isinstance(array, np.ndarray) or array.dtype != np.float32:
        raise TypeError(f"{what}: expected a numpy array of float32 with shape {shape}, got {type(array).__name__}")
    if array.shape != shape:
        raise ValueError(f"{what}: expected shape {shape}, got {array.shape}")
    return array.tobytes()
