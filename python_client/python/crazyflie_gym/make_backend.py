"""Backends and controllers from keyword arguments."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, cast

from gymnasium.vector import AutoresetMode

from crazyflie_gym._native import Controller, Crowd, Sim, check_model, model_text, tasks
from crazyflie_gym._types import AnyController, Backend
from crazyflie_gym.options import EnvOptions, Model, model_sources, native_autoreset, to_json
from crazyflie_gym.own_judgement import CallbackSim, RewardFunction, split_judgement
from crazyflie_gym.spaces import RowLayout

Source = tuple[str | None, str]
"""Text of a model, None for the built-in one, and its name in errors."""


def native_options(task: str, options: EnvOptions, **more: Any) -> tuple[str, list[Source], dict[str, RewardFunction]]:
    """Return options as the simulator reads them: JSON and models; and the rewards and ends that are functions.

    Raises:
        ValueError: for what JSON has no word for, for a file that is no model, and a function of unknown fields.
        FileNotFoundError: if there is no such model file.
        TypeError: for a model, a reward or an end of a strange type.
    """
    models = checked_sources(options.get("model"))
    judgement, functions = split_judgement(options.get("reward"), options.get("termination"))
    elsewhere = ("model", "reward", "termination", "clip")
    plain = {name: value for name, value in options.items() if name not in elsewhere}
    return to_json(task=task, **plain, **judgement, **more), models, functions


def make_backend(
    num_envs: int,
    task: str,
    options: EnvOptions,
    *,
    autoreset: AutoresetMode,
    max_episode_steps: int = 0,
    threads: int = 1,
    remote: str | None = None,
    states: bool = False,
    draws: bool = False,
) -> Backend:
    """Return the simulation of an environment's arguments.

    `states` will be read every step; `draws` requests the data of pictures.

    Raises:
        ValueError: naming the argument that is wrong, with a proposal where a name is unknown.
        TypeError: for a number of environments that is not an integer.
        ConnectionError: if no server answers at `remote`.
        Exception: as `native_options`.
    """
    more = {"autoreset": native_autoreset(autoreset), "max_episode_steps": max_episode_steps, "threads": threads}
    text, models, functions = native_options(task, options, **more)
    if remote is None:
        texts = native_texts(models)
        return CallbackSim(num_envs, text, texts, **functions) if functions else Sim(num_envs, text, texts)
    if functions:
        raise ValueError(f"{next(iter(functions))}: a server cannot call a function, expected an expression")
    observation, history = options["observation"], options.get("history", 1)
    if draws and (history != 1 or "setpoint" not in (field["name"] for field in RowLayout(observation).fields)):
        raise ValueError(
            "render_mode: pictures of a server's flights need the field setpoint and history=1, got "
            f"{observation!r} with {history}"
        )
    if len(models) > 1:
        raise ValueError(f"model: expected one for all drones where a server simulates, got {len(models)}")
    from crazyflie_gym.remote import RemoteSim

    return RemoteSim(remote, num_envs, text, models[0][0], states)


def checked_sources(model: Model | Sequence[Model]) -> list[Source]:
    """Return text and name of each model, as `model_sources`.

    Raises:
        ValueError: naming the file that is no model, and what is wrong in it.
    """
    models = model_sources(model)
    for text, name in models:
        if text is not None:
            try:
                check_model(text)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
    return models


def native_texts(models: Sequence[Source]) -> list[str]:
    """Return the texts of models, the built-in one's among them."""
    return [model_text() if text is None else text for text, _ in models]


def episode_steps(task: str, max_episode_steps: int | None) -> int:
    """Return the length of an episode as the simulator takes it, 0 for no end: as given, or the task's own."""
    if max_episode_steps is None:
        return next((entry["max_episode_steps"] for entry in tasks() if entry["name"] == task), 0)
    return 0 if max_episode_steps == -1 else max_episode_steps


def make_controller(
    name: AnyController | Sequence[AnyController],
    sim: Backend,
    model: Model | Sequence[Model],
    mode: str,
    avoid: bool | Mapping[str, float],
    options: Mapping[str, Any],
    file: bytes | None = None,
) -> Controller | Crowd:
    """Return the controller of that name for a simulation; it believes in `model`. Several drones may have one each.

    Instead of a name there may be a controller of one's own, see `crazyflie_gym.custom`.

    Raises:
        ValueError: naming the controller, option or mode that is wrong, with a proposal where a name is unknown.
        TypeError: for what is neither a name nor a controller.
    """
    options_json = to_json(**options) if options else "null"
    names = list(name) if isinstance(name, (list, tuple)) else [cast("AnyController", name)]
    if not sim.has_drone_axis:
        if len(names) != 1:
            raise ValueError(f"controller: expected one for one drone, got {len(names)}")
        believed = model_sources(model)[0][0]
        of = sim if isinstance(sim, Sim) else sim.interface
        return Controller(names[0], sim.num_envs, of, options=options_json, model=believed, mode=mode, file=file)
    if mode != "automatic":
        raise ValueError(f'mode is {mode!r}, expected "automatic": several drones begin in the air')
    if not isinstance(sim, Sim):
        raise ValueError("controllers of several drones fly in this process, not on a server")
    layer = None if avoid is False else json.dumps({} if avoid is True else dict(avoid))
    return Crowd(names, sim, options=options_json, avoid=layer)
