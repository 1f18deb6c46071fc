"""Prints a digest of flights by everything that has a name: the same lines on every machine and processor.

python tests/bits.py
"""

import hashlib

import gymnasium
import numpy as np

import crazyflie_gym
from crazyflie_gym.training import OBSERVED

STEPS, ENVS = 100, 64


def digest(envs: object, shape: tuple[int, ...]) -> str:
    """Fly random actions and hash every observation, reward and end."""
    flown = hashlib.sha256(envs.reset(seed=7)[0].tobytes())
    rng = np.random.default_rng(1)
    for _ in range(STEPS):
        for numbers in envs.step(rng.uniform(-1.0, 1.0, shape).astype(np.float32))[:4]:
            flown.update(numbers.tobytes())
    return flown.hexdigest()


def single(task: str = "Crazyflie-v0", **options: object) -> str:
    """Digest of flights of one drone each."""
    envs = gymnasium.make_vec(task, num_envs=ENVS, **options)
    return digest(envs, envs.action_space.shape)


def middle(param: dict) -> float:
    """Return a value that does something; an instant stays, since these flights are short."""
    far = param["low"] if param["off"] == param["high"] else param["high"]
    return param["off"] + (0.0 if param["name"] == "t_s" else 0.25 * (far - param["off"]))


for task in crazyflie_gym.tasks():
    if task["drones"] == 1:
        print(task["id"], single(task["id"]))
    else:
        worlds = crazyflie_gym.CrazyflieSwarm(8, task["id"])
        print(task["id"], digest(worlds, (8, worlds.num_drones, 4)))
for vehicle in crazyflie_gym.vehicles():
    print(vehicle["name"], single(vehicle=vehicle["name"]))
for effect in crazyflie_gym.effects():
    # with a thrust as command, and seen through the camera, where effects on both do something
    effects = {"camera": 1} | {effect["name"]: {param["name"]: middle(param) for param in effect["params"]}}
    print(effect["name"], single(vertical="thrust", effects=effects, observation=OBSERVED))
