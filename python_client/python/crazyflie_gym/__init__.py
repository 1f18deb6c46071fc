"""The Crazyflie quadrotor that the TU Darmstadt thesis identified, as fast Gymnasium environments.

    import crazyflie_gym
    import gymnasium

    env = gymnasium.make("Crazyflie-v0")                      # one drone
    envs = gymnasium.make_vec("Crazyflie-v0", num_envs=1024)  # many, stepped in Rust

What there is to choose from: `tasks()`, `effects()`, `controllers()`, `observation_fields()`, `model_text()`.
"""

import gymnasium

from crazyflie_gym._native import (
    Controller,
    Interface,
    Pid,
    Sim,
    ansi,
    check_model,
    controllers,
    effects,
    model_text,
    observation_fields,
    render,
    tasks,
)
from crazyflie_gym.env import CrazyflieEnv
from crazyflie_gym.png import save_png
from crazyflie_gym.spaces import STATE_FIELDS, flatten, split
from crazyflie_gym.vector import CrazyflieVectorEnv

__all__ = [
    "STATE_FIELDS",
    "Controller",
    "CrazyflieEnv",
    "CrazyflieVectorEnv",
    "Interface",
    "Pid",
    "Sim",
    "ansi",
    "check_model",
    "controllers",
    "effects",
    "flatten",
    "model_text",
    "observation_fields",
    "render",
    "save_png",
    "split",
    "tasks",
]


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
