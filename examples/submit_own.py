"""A controller of one's own in the benchmark: python examples/submit_own.py ws://127.0.0.1:8765 hover-aruco TOKEN."""

import sys

import numpy as np

from crazyflie_gym import split
from crazyflie_gym.remote import Benchmark


def controller(interface):
    error, rate = None, 0.0

    def act(obs):  # a PD; a row of observations for each episode
        nonlocal error, rate
        fields = split(obs)
        setpoint = fields["setpoint"]
        before, error = error, setpoint[:, :3] - fields["marker_pos_m"]
        rate += 0.2 * (((error - before) / interface.tick_s if before is not None else 0.0) - rate)
        x, y, z = 0.6 * (error + rate).T
        yaw = -interface.yaw_sign * fields["marker_yaw_rad"][:, 0]
        lift = interface.hover_lift * (1 + 0.4 * z) if interface.hover_lift else setpoint[:, 2]
        return np.clip(np.stack([-y, x, yaw, 2 * lift / interface.lift_max - 1], axis=1), -1, 1)

    return act


url, scenario, token = sys.argv[1:]
with Benchmark(url, scenario, controller="my-own", token=token) as attempt:
    row = attempt.run(controller(attempt.interface))
print(f"{row['scenario']}: attempt {row['id']} scores {row['result']['score']['score']:.3f}")
