"""What the tests share."""

import select
import time

import gymnasium as gym
import numpy as np

import crazyflie_gym

# longest wait of a test: more than a busy machine takes
LIMIT_S = 300


def wait(condition, what="", pause_s=0.02):
    """Waits until something is true, whatever clock the script has; what, or what a function says, is told if it does
    not come true."""
    end_s = time.clock_gettime(time.CLOCK_MONOTONIC) + LIMIT_S
    while not (found := condition()):
        in_time = time.clock_gettime(time.CLOCK_MONOTONIC) < end_s
        assert in_time, f"not within {LIMIT_S} s: {what() if callable(what) else what}"
        select.select([], [], [], pause_s)
    return found


IDS = [task["id"] for task in crazyflie_gym.tasks()]
SINGLE = {task["id"] for task in crazyflie_gym.tasks() if task["drones"] == 1}

# the five of env/benches/step.rs
FIVE = {
    "camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5},
    "ground_effect": 1.0,
    "drag_linear": 0.3,
    "cmd_delay": 0.03,
    "battery_sag": {"exponent": 1.0, "resistance_ohm": 0.1},
}


def random_actions(steps, num_envs, seed=0, size=1.0):
    """Random actions, float32 (steps, num_envs, 4)."""
    return np.random.default_rng(seed).uniform(-size, size, (steps, num_envs, 4)).astype(np.float32)


def actions_for(space, steps, seed=0):
    """Random actions of a space, float32 (steps, ...)."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *space.shape)).astype(np.float32)


def single_env(**kwargs):
    """A single environment with the time limit that the vector environment has."""
    limit = kwargs.pop("max_episode_steps")
    return gym.make("Crazyflie-v0", max_episode_steps=limit, disable_env_checker=True, **kwargs)
