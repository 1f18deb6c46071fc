"""From keyword arguments to a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gymnasium.vector import AutoresetMode

from crazyflie_gym import remote as servers
from crazyflie_gym._native import Controller, Sim, check_model
from crazyflie_gym.core import RemoteCore
from crazyflie_gym.options import Model, model_source, native_autoreset, to_json


def build(
    num_envs: int,
    *,
    task: str,
    model: Model,
    vertical: str | None,
    effects: Mapping[str, Any] | None,
    task_options: Mapping[str, Any] | None,
    physics_hz: int | None,
    threads: int,
    isa: str | None,
    autoreset: AutoresetMode,
    max_episode_steps: int,
    remote: str | None,
    remote_client: str,
    states: bool,
) -> Sim | RemoteCore:
    """Return the simulation that the arguments of an environment ask for; `states` will be read every step.

    Raises:
        ValueError: naming the argument that is wrong, with a proposal where a name is unknown.
        FileNotFoundError: if there is no such model file.
        TypeError: for a number of environments that is not an integer, and a model of a strange type.
        ConnectionError: if no server answers at `remote`.
    """
    text, name = model_source(model)
    if text is not None:
        try:
            check_model(text)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    options = to_json(
        task=task,
        task_options=task_options,
        vertical=vertical,
        effects=effects,
        physics_hz=physics_hz,
        threads=threads,
        isa=isa,
        autoreset=native_autoreset(autoreset),
        max_episode_steps=max_episode_steps,
    )
    if remote is None:
        return Sim(num_envs, options, text)
    return servers.make(remote, remote_client, num_envs, options, text, states)


def controller(name: str, sim: Sim | RemoteCore, model: Model, mode: str, options: Mapping[str, Any]) -> Controller:
    """Return the controller of that name for a simulation; it believes in `model`.

    Raises:
        ValueError: naming the controller, option or mode that is wrong, with a proposal where a name is unknown.
    """
    given = to_json(**options) if options else "null"
    return Controller(name, sim.num_envs, sim.interface, options=given, model=model_source(model)[0], mode=mode)
