"""A controller of one's own in the benchmark: python examples/submit_own.py ws://127.0.0.1:8765 hover-aruco TOKEN."""

import sys

import numpy as np

from crazyflie_gym.remote import Benchmark


def controller(interface):
    error, rate = None, 0.0

    def act(obs):  # a PD; a row of observations for each episode, laid out as crazyflie_gym.observation_fields() says
        nonlocal error, rate
        before, error = error, obs[:, 16:19] - obs[:, 0:3]
        rate += 0.2 * (((error - before) / interface.tick_s if before is not None else 0.0) - rate)
        x, y, z = 0.6 * (error + rate).T
        yaw = -interface.yaw_sign * obs[:, 3]
        lift = interface.hover_lift * (1 + 0.4 * z) if interface.hover_lift else obs[:, 18]
        return np.clip(np.stack([-y, x, yaw, 2 * lift / interface.lift_max - 1], axis=1), -1, 1)

    return act


url, scenario, token = sys.argv[1:]
with Benchmark(url, scenario, controller="my-own", token=token) as attempt:
    row = attempt.run(controller(attempt.interface))
print(f"{row['scenario']}: attempt {row['id']} scores {row['result']['score']['score']:.3f}")
