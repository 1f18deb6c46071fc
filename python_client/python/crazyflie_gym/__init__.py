"""The Crazyflie quadrotor that the TU Darmstadt thesis identified, as fast Gymnasium environments.

    import crazyflie_gym
    import gymnasium

    env = gymnasium.make("Crazyflie-v0")                      # one drone
    envs = gymnasium.make_vec("Crazyflie-v0", num_envs=1024)  # many, stepped in Rust
    worlds = crazyflie_gym.CrazyflieSwarm(64, "swap")         # several drones in each of many worlds

The choices are listed by `vehicles()`, `tasks()`, `effects()`, `controllers()`, `observation_fields()`,
`neighbour_fields()`, `model_text()`, `model_from_datasheet()`.
"""

import importlib.metadata
import warnings
from typing import Any

import gymnasium

from crazyflie_gym._native import (
    Controller,
    Crowd,
    Interface,
    Pid,
    Sim,
    action_levels,
    ansi,
    check_model,
    controllers,
    effects,
    expression_fields,
    expression_functions,
    metrics,
    model_text,
    neighbour_fields,
    observable_fields,
    observation_choices,
    observation_fields,
    render,
    tasks,
    vehicles,
)
from crazyflie_gym.datasheet import model_from_datasheet
from crazyflie_gym.env import CrazyflieEnv
from crazyflie_gym.export import export_policy
from crazyflie_gym.options import EnvOptions
from crazyflie_gym.own_task import make_task, register_task
from crazyflie_gym.png import save_png
from crazyflie_gym.spaces import STATE_FIELDS, flatten, split
from crazyflie_gym.swarm import CrazyflieSwarm
from crazyflie_gym.tracks import track
from crazyflie_gym.vector import CrazyflieVectorEnv
from crazyflie_gym.wind import WindField

__version__ = importlib.metadata.version("crazyflie-gym")

__all__ = [
    "STATE_FIELDS",
    "Controller",
    "CrazyflieEnv",
    "CrazyflieSwarm",
    "CrazyflieVectorEnv",
    "Crowd",
    "EnvOptions",
    "Interface",
    "Pid",
    "Sim",
    "WindField",
    "__version__",
    "action_levels",
    "ansi",
    "check_model",
    "controllers",
    "effects",
    "export_policy",
    "expression_fields",
    "expression_functions",
    "flatten",
    "make_task",
    "metrics",
    "model_from_datasheet",
    "model_text",
    "neighbour_fields",
    "observable_fields",
    "observation_choices",
    "observation_fields",
    "register_task",
    "render",
    "save_png",
    "split",
    "tasks",
    "track",
    "vehicles",
]


_RENAMED = {"CrazyflieTeamEnv": "CrazyflieEnv", "CrazyflieTeamVectorEnv": "CrazyflieVectorEnv", "missions": "tasks"}


def __getattr__(name: str) -> Any:
    """Return what has another name now, for one release."""
    new = _RENAMED.get(name)
    if new is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(f"crazyflie_gym.{name} is crazyflie_gym.{new} now", DeprecationWarning, stacklevel=2)
    if name == "missions":
        return lambda: [task for task in tasks() if task["drones"] > 1]
    return globals()[new]


def _register() -> None:
    for task in tasks():
        if task["id"] not in gymnasium.registry:
            gymnasium.register(
                id=task["id"],
                entry_point="crazyflie_gym.env:CrazyflieEnv",
                vector_entry_point="crazyflie_gym.vector:CrazyflieVectorEnv",
                max_episode_steps=task["max_episode_steps"],
                kwargs={"task": task["name"]},
            )


_register()
