"""The Crazyflie quadrotor that the TU Darmstadt thesis identified, as fast Gymnasium environments.

    import crazyflie_gym
    import gymnasium

    env = gymnasium.make("Crazyflie-v0")                      # one drone
    envs = gymnasium.make_vec("Crazyflie-v0", num_envs=1024)  # many, stepped in Rust
    worlds = crazyflie_gym.CrazyflieSwarm(64, "swap")         # several drones in each of many worlds

What there is to choose from: `tasks()`, `missions()`, `effects()`, `controllers()`,
`observation_fields()`, `model_text()`.
"""

import gymnasium

from crazyflie_gym._native import (
    Controller,
    Crowd,
    Interface,
    Pid,
    Sim,
    Swarm,
    ansi,
    check_model,
    controllers,
    effects,
    metrics,
    missions,
    model_text,
    observation_fields,
    render,
    tasks,
)
from crazyflie_gym.env import CrazyflieEnv
from crazyflie_gym.png import save_png
from crazyflie_gym.spaces import STATE_FIELDS, flatten, split
from crazyflie_gym.swarm import CrazyflieSwarm
from crazyflie_gym.team import CrazyflieTeamEnv, CrazyflieTeamVectorEnv
from crazyflie_gym.vector import CrazyflieVectorEnv

__all__ = [
    "STATE_FIELDS",
    "Controller",
    "CrazyflieEnv",
    "CrazyflieSwarm",
    "CrazyflieTeamEnv",
    "CrazyflieTeamVectorEnv",
    "CrazyflieVectorEnv",
    "Crowd",
    "Interface",
    "Pid",
    "Sim",
    "Swarm",
    "ansi",
    "check_model",
    "controllers",
    "effects",
    "flatten",
    "metrics",
    "missions",
    "model_text",
    "observation_fields",
    "render",
    "save_png",
    "split",
    "tasks",
]


def _register() -> None:
    one, several = (
        ("env:CrazyflieEnv", "vector:CrazyflieVectorEnv"),
        ("team:CrazyflieTeamEnv", "team:CrazyflieTeamVectorEnv"),
    )
    for task, (single, vector) in [(task, one) for task in tasks()] + [(mission, several) for mission in missions()]:
        if task["id"] not in gymnasium.registry:
            gymnasium.register(
                id=task["id"],
                entry_point=f"crazyflie_gym.{single}",
                vector_entry_point=f"crazyflie_gym.{vector}",
                max_episode_steps=task["max_episode_steps"],
                kwargs={"task": task["name"]},
            )


_register()
