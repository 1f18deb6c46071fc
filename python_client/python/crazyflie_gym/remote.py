"""Environments and benchmark runs on a server, `crazyflie serve`; docs/protocol.md says what is sent.

    env = gymnasium.make("Crazyflie-v0", remote="ws://127.0.0.1:8765")
    envs = gymnasium.make_vec("Crazyflie-v0", num_envs=1024, remote="wss://lab.example", remote_client="python")

The client "native" is the fast one, in Rust. The client "python" is written in Python and needs the extra `remote`.
"""

from __future__ import annotations

import operator
import os
from urllib.parse import urlsplit, urlunsplit

from crazyflie_gym import _native
from crazyflie_gym.core import RemoteCore
from crazyflie_gym.options import to_json

TOKEN = "CRAZYFLIE_TOKEN"
"""The environment variable with a team's token, for servers that want one."""

_MOST_ENVS = 16384


def connect(url: str, client: str = "native", *, token: str | None = None, num_envs: int = 1) -> RemoteCore:
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


def make(url: str, client: str, num_envs: int, options: str, model: str | None, states: bool) -> RemoteCore:
    """Return a batch of environments on a server; `options` is JSON, `model` the text of a model file.

    Raises:
        ValueError: as `connect`, and for what the server refuses, in its words.
        ConnectionError: if nobody answers there.
        TypeError: for a number of environments that is not an integer.
    """
    num_envs = operator.index(num_envs)
    if num_envs < 1:
        raise ValueError(f"num_envs is {num_envs}, expected at least 1")
    core = connect(url, client, num_envs=num_envs)
    fields = to_json(num_envs=num_envs, model=model)[:-1] + f', "options": {options}}}'
    try:
        core.begin("make", fields, states)
    except BaseException:
        core.close()
        raise
    return core


def _address(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme not in ("ws", "wss") or not parts.hostname:
        raise ValueError(f"remote is {url!r}, expected ws://host:port or wss://host:port")
    if parts.username or parts.password:
        raise ValueError(f"remote: a URL gets into logs; give the token in the environment variable {TOKEN}")
    path = "/ws" if parts.path in ("", "/") else parts.path
    return urlunsplit((parts.scheme, parts.netloc, path, parts.query, ""))
