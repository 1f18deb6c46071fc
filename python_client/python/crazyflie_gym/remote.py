"""Environments and benchmark runs on a server, `crazyflie serve`; docs/protocol.md says what is sent.

    env = gymnasium.make("Crazyflie-v0", remote="ws://127.0.0.1:8765")
    envs = gymnasium.make_vec("Crazyflie-v0", num_envs=1024, remote="wss://lab.example", remote_client="python")

    with Benchmark("ws://127.0.0.1:8765", "hover-aruco", controller="mine", token="cft_...") as attempt:
        row = attempt.run(controller)

    found_world("ws://127.0.0.1:8765", "room", "swap", drones=2, pilots=2)
    with Pilot("ws://127.0.0.1:8765", world="room") as pilot:
        while pilot.flying:
            pilot.fly(controller(pilot.observation))

The client "native" is the fast one, in Rust. The client "python" is written in Python and needs the extra `remote`.
"""

from __future__ import annotations

import json
import operator
import os
from collections.abc import Callable
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import numpy as np

from crazyflie_gym import _native
from crazyflie_gym._native import Interface
from crazyflie_gym._types import BoolArray, FloatArray
from crazyflie_gym.backend import RemoteBackend
from crazyflie_gym.options import to_json

TOKEN = "CRAZYFLIE_TOKEN"
"""The environment variable with a team's token, for servers that want one."""

_MOST_ENVS = 16384


def connect(url: str, client: str = "native", *, token: str | None = None, num_envs: int = 1) -> RemoteBackend:
    """Return a connection over which nothing was made yet.

    Args:
        url: ws://host:port or wss://host:port; the path is /ws unless another one is given.
        client: "native" or "python".
        token: a team's, by default from the environment variable `CRAZYFLIE_TOKEN`.
        num_envs: how many environments it will be used for, which sizes its buffers.

    Raises:
        ValueError: for another kind of URL, and an unknown client.
        ConnectionError: if nobody answers there.
        ModuleNotFoundError: if the client "python" lacks its package.
    """
    url, token = _address(url), token or os.environ.get(TOKEN)
    if client == "native":
        return _native.Remote(url, token, min(max(num_envs, 1), _MOST_ENVS))
    if client == "python":
        try:
            from crazyflie_gym.remote_python import Remote
        except ModuleNotFoundError as error:
            hint = 'pip install "crazyflie-gym[remote]" brings it'
            raise ModuleNotFoundError(f'remote_client="python": {error}; {hint}', name=error.name) from None
        return Remote(url, token)
    raise ValueError(f'remote_client is {client!r}, expected "native" or "python"')


def make(url: str, client: str, num_envs: int, options: str, model: str | None, states: bool) -> RemoteBackend:
    """Return a batch of environments on a server; `options` is JSON, `model` the text of a model file.

    Raises:
        ValueError: as `connect`, and for what the server refuses, in its words.
        ConnectionError: if nobody answers there.
        TypeError: for a number of environments that is not an integer.
    """
    num_envs = operator.index(num_envs)
    if num_envs < 1:
        raise ValueError(f"num_envs is {num_envs}, expected at least 1")
    backend = connect(url, client, num_envs=num_envs)
    fields = to_json(num_envs=num_envs, model=model)[:-1] + f', "options": {options}}}'
    try:
        backend.begin("make", fields, states)
    except BaseException:
        backend.close()
        raise
    return backend


class Benchmark:
    """An attempt at a scenario of the benchmark: all its episodes fly in lock-step, and the server scores them.

    From the beginning on it is listed; one that is not finished is listed as abandoned.

    Args:
        url: as of `connect`.
        scenario: its name, such as "hover-aruco", or "name@version"; `crazyflie bench scenarios` lists them.
        controller: what the leaderboard calls what flies here.
        token: the team's, by default from the environment variable `CRAZYFLIE_TOKEN`.
        client: "native" or "python".

    Raises:
        ValueError: for an unknown scenario, a token that is not valid, a name that is no good.
        RuntimeError: if the team has too many attempts, or the server no benchmark.
        ConnectionError: if nobody answers, and from any method if the connection is lost.
    """

    def __init__(
        self, url: str, scenario: str, *, controller: str, token: str | None = None, client: str = "native"
    ) -> None:
        token = token or os.environ.get(TOKEN, "")
        self._backend = connect(url, client, token=token)
        try:
            attempt = self._backend.begin("benchmark", to_json(scenario=scenario, controller=controller, token=token))
        except BaseException:
            self._backend.close()
            raise
        reply: dict[str, Any] = json.loads(attempt)
        self.attempt: str = reply["attempt"]
        self.scenario: str = reply["scenario"]
        self.num_envs: int = reply["num_envs"]
        """Rows of actions and observations: the drones of all episodes, episode by episode."""
        self.drones: int = reply["drones"]
        """In each episode."""
        self.interface: Interface = self._backend.interface
        self.observations: FloatArray = np.array(reply["observation"], np.float32)
        self.over = False

    def step(self, actions: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
        """Fly one control tick of all episodes with actions from -1 to 1, float32 (num_envs, 4).

        Returns:
            Observations (num_envs, 24; where drones share the air, 8 more for each of the others), rewards,
            terminations and truncations (num_envs,). Rewards are 0: in an attempt nothing tells the true state. A
            flight that has ended stays as it is; when the last one has, `over` is true.

        Raises:
            ValueError: for another shape or layout, and for numbers that are not from -1 to 1; nothing has moved then.
            TypeError: for another dtype.
            RuntimeError: when all episodes are over.
        """
        rows, rewards, terminated, truncated, _ = self._backend.step(actions)
        self.observations, self.over = rows, bool((terminated | truncated).all())
        return rows, rewards, terminated, truncated

    def finish(self) -> dict[str, Any]:
        """Return the attempt as the server has scored, signed and stored it.

        Raises:
            RuntimeError: if episodes are still under way (the attempt is then abandoned), or it took too long.
        """
        attempt: dict[str, Any] = json.loads(self._backend.ask("finish"))["attempt"]
        return attempt

    def run(self, act: Callable[[FloatArray], FloatArray]) -> dict[str, Any]:
        """Fly to the end with `act`, from observations of `step` to actions, and return what `finish` does."""
        while not self.over:
            self.step(np.ascontiguousarray(act(self.observations), np.float32))
        return self.finish()

    def close(self) -> None:
        """Close the connection."""
        self._backend.close()

    def __enter__(self) -> Benchmark:
        """Return the attempt."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connection."""
        self.close()


def found_world(
    url: str,
    name: str,
    mission: str,
    *,
    seed: int = 0,
    deadline_s: float = 1.0,
    pilots: int = 1,
    autopilot: str = "thesis-pid",
    model: str | None = None,
    client: str = "native",
    **options: Any,
) -> dict[str, Any]:
    """Found a world that several clients share, each flying one of its drones, and return what the server says of it.

    Args:
        url: as of `connect`.
        name: what it is joined by: letters, digits, and -, _ or . but not at the beginning.
        mission: such as "swap"; `crazyflie_gym.missions()` lists them.
        seed: of the episode.
        deadline_s: so long after it began, a tick is flown without those who are late.
        pilots: so many must have joined before the first tick.
        autopilot: the controller of drones without a pilot.
        model: the text of a model file.
        client: "native" or "python".
        options: of the mission's environment, such as `drones` and `effects`.

    Raises:
        ValueError: for what cannot be flown, and a name that is no good.
        RuntimeError: if there is a world of this name, or the server has too many.
        ConnectionError: if nobody answers.
    """
    backend = connect(url, client)
    world_fields = {"name": name, "mission": mission, "seed": seed, "deadline_s": deadline_s, "pilots": pilots}
    try:
        reply: dict[str, Any] = json.loads(
            backend.ask("world", to_json(**world_fields, autopilot=autopilot, model=model, options=options))
        )
    finally:
        backend.close()
    return reply


class Pilot:
    """A seat at the controls of one drone of a shared world. There is no reset: a world is one episode.

    Who leaves or loses the connection leaves the drone to the autopilot, and may join again.

    Args:
        url: as of `connect`.
        world: its name.
        drone: which one; the first that is free unless given.
        token: of the seat, to take it over from a connection that was lost.
        client: "native" or "python".

    Raises:
        ValueError: for an unknown world or drone.
        RuntimeError: if no drone is free, or this one has a pilot or has ended.
        ConnectionError: if nobody answers, and from any method if the connection is lost.
    """

    def __init__(
        self, url: str, world: str, drone: int | None = None, *, token: str | None = None, client: str = "native"
    ) -> None:
        self._backend = connect(url, client)
        try:
            reply: dict[str, Any] = json.loads(self._backend.ask("join", to_json(name=world, drone=drone, token=token)))
        except BaseException:
            self._backend.close()
            raise
        self.world: str = reply["world"]
        self.drone: int = reply["drone"]
        self.drones: int = reply["drones"]
        self.token: str = reply["token"]
        self.tick: int = reply["tick"]
        self.interface = Interface(tick_s=reply["tick_s"], **reply["interface"])
        self.observation: FloatArray = np.array(reply["observation"], np.float32)
        self.flying, self.terminated, self.truncated = True, False, False
        self.late = 0
        """So many ticks were flown without this pilot's action."""

    def fly(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool]:
        """Give the action of this tick, 4 numbers from -1 to 1, and wait until the tick is over.

        Returns:
            Observation (24 own numbers and 8 for each of the other drones), reward, terminated and truncated.

        Raises:
            ValueError: for another number of numbers, and for those that are not from -1 to 1; nothing has moved then.
            RuntimeError: if the drone's flight has ended, or the seat was taken over.
        """
        numbers = np.asarray(action, np.float32).reshape(-1)
        if not np.isfinite(numbers).all():
            raise ValueError(f"action: expected numbers from -1 to 1, got {numbers.tolist()}")
        reply = json.loads(self._backend.ask("fly", to_json(action=numbers.tolist())))
        self.observation = np.array(reply["observation"], np.float32)
        self.tick, self.flying, self.late = reply["tick"], reply["flying"], reply["late"]
        self.terminated, self.truncated = reply["terminated"], reply["truncated"]
        return self.observation, float(reply["reward"]), self.terminated, self.truncated

    def close(self) -> None:
        """Leave the drone to the autopilot and close the connection."""
        self._backend.close()

    def __enter__(self) -> Pilot:
        """Return the pilot."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave."""
        self.close()


def _address(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme not in ("ws", "wss") or not parts.hostname:
        raise ValueError(f"remote is {url!r}, expected ws://host:port or wss://host:port")
    if parts.username or parts.password:
        raise ValueError(f"remote: a URL gets into logs; give the token in the environment variable {TOKEN}")
    path = "/ws" if parts.path in ("", "/") else parts.path
    return urlunsplit((parts.scheme, parts.netloc, path, parts.query, ""))
