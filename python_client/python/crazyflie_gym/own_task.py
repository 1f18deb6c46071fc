"""Tasks of one's own: a file or a dict that becomes an id of Gymnasium."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium

from crazyflie_gym._native import read_task
from crazyflie_gym.options import to_json

TaskSource = str | os.PathLike[str] | Mapping[str, Any]
"""The path of a task file (TOML or JSON), or its content as a dict."""


def register_task(source: TaskSource) -> str:
    """Make a task an id of Gymnasium, and return the id: "crazyflie/NAME-v0".

    The keys are the names of the arguments of `CrazyflieEnv`: `task` (whose start, set-point and options it has),
    `task_options`, `reward`, `termination`, `max_episode_steps`, `observation`, `history`, `effects`, and so on; and
    `name` and `about`. A task of that name that was there before is replaced.

    Raises:
        ValueError: naming the file, and the key or expression that is wrong.
        FileNotFoundError: if there is no such file.
    """
    if isinstance(source, Mapping):
        where, text = "task", to_json(**source)
    else:
        where, text = os.fspath(source), Path(source).read_text(encoding="utf-8")
    try:
        task_id, _, options = read_task(text)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    kwargs = json.loads(options)
    steps = kwargs.pop("max_episode_steps")
    gymnasium.registry.pop(task_id, None)
    gymnasium.register(
        id=task_id,
        entry_point="crazyflie_gym.env:CrazyflieEnv",
        vector_entry_point="crazyflie_gym.vector:CrazyflieVectorEnv",
        max_episode_steps=steps,
        kwargs=kwargs,
    )
    return task_id


def make_task(source: TaskSource, num_envs: int | None = None, **more: Any) -> Any:
    """Make an environment of a task of one's own, or `num_envs` of them as one batch.

    `more` is as of `gymnasium.make` and `gymnasium.make_vec`, and overrides the task's.

    Raises:
        ValueError: naming the file, and the key or expression that is wrong.
        FileNotFoundError: if there is no such file.
    """
    task_id = register_task(source)
    return gymnasium.make(task_id, **more) if num_envs is None else gymnasium.make_vec(task_id, num_envs, **more)
