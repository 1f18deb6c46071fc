"""A controller of one's own in the benchmark: python examples/submit_own.py ws://127.0.0.1:8765 hover-aruco TOKEN."""

import sys

import numpy as np

from crazyflie_gym import Interface, split
from crazyflie_gym.remote import Client


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
client = Client(url, token)
result = client.ask("benchmark", scenario=scenario, controller="my-own", token=token)
act = controller(Interface(tick_s=result["tick_s"], **result["interface"]))
while not result.get("over"):
    result = client.ask("step", action=act(np.array(result["observation"], np.float32)).tolist())
row = client.ask("finish")["attempt"]
print(f"{row['scenario']}: attempt {row['id']} scores {row['result']['score']['score']:.3f}")
