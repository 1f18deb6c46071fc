"""Two processes in two languages swap places: this one, and `crazyflie world join`, which is written in Rust.

crazyflie serve &
python examples/swap_places.py ws://127.0.0.1:8765 swap &
crazyflie world join --server ws://127.0.0.1:8765 --world swap --drone 1 --collision-avoidance --wait 30
"""

import sys

import numpy as np

from crazyflie_gym import Interface, split
from crazyflie_gym.remote import Client


def limited(vector, most):
    return vector * min(1.0, most / max(np.linalg.norm(vector), 1e-9))


def aside(obs):
    """How fast to go out of the way: from the other drone, and to its right, so that both pass on the same side."""
    fields = split(obs)
    other, speed, known = fields["neighbour_pos_m"][0], fields["neighbour_vel_mps"][0], fields["neighbour_known"][0, 0]
    soon = other + np.clip(-other @ speed / (speed @ speed + 1e-4), 0.0, 1.0) * speed
    near = known * max(0.0, 1.0 - 0.5 * (np.linalg.norm(other) + np.linalg.norm(soon)))
    right = np.array([other[1], -other[0], 0.0])
    return near * (1.2 * right - other) / max(np.linalg.norm(other), 0.05)


def controller(interface):
    tick_s, goal, error, rate = interface.tick_s, None, None, np.zeros(3)

    def act(obs):  # the PD of submit_own.py, after a goal that moves at half a metre per second
        nonlocal goal, error, rate
        fields = split(obs)
        own, setpoint = fields["marker_pos_m"], fields["setpoint"]
        goal = own if goal is None else goal
        speed = limited(limited((setpoint[:3] - goal) / tick_s, 0.5) + aside(obs), 0.5)
        goal = own + limited(goal + tick_s * speed - own, 0.5)
        before, error = error, goal - own
        rate = rate + 0.2 * ((error - before) / tick_s - rate) if before is not None else rate
        x, y, z = 0.6 * (error + rate)
        yaw = -interface.yaw_sign * fields["marker_yaw_rad"][0]
        lift = interface.hover_lift * (1 + 0.4 * z) if interface.hover_lift else goal[2]
        return np.clip([-y, x, yaw, 2 * lift / interface.lift_max - 1], -1, 1)

    return act


url, name = sys.argv[1:]
pilot = Client(url)
pilot.ask("world", name=name, mission="swap", options={"drones": 2}, pilots=2, seed=3, deadline_s=5.0)
seat = pilot.ask("join", name=name, drone=0)
print(f"drone {seat['drone']} of {name} waits for the other pilot", flush=True)
act = controller(Interface(tick_s=seat["tick_s"], **seat["interface"]))
flown = {**seat, "flying": True}
while flown["flying"]:
    flown = pilot.ask("fly", action=act(np.array(flown["observation"], np.float32)).tolist())
pilot.close()
fields = split(np.array(flown["observation"], np.float32))
off_m = np.linalg.norm(fields["setpoint"][:3] - fields["marker_pos_m"])
how = "its flight ended" if flown["terminated"] else "the time was over"
print(f"drone 0 of {name}: {flown['tick']} ticks, {how}; late {flown['late']} times; {off_m:.3f} m away")
