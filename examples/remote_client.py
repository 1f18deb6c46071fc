"""A client of `crazyflie serve` from docs/protocol.md alone, for whom this package is not at hand: one flight.

    crazyflie serve &
    python examples/remote_client.py ws://127.0.0.1:8765

Text messages are JSON; steps go as binary frames. The SHA-256 of all rows is the same wherever this flight is flown.
"""

import hashlib
import json
import struct
import sys

from websockets.sync.client import connect

# header of a reply: id, kind + 128, flags, steps, environments, final rows, 0, ticks
HEADER = struct.Struct("<QBBHIIIQ")
# indices of an observation: yaw over the marker, first of the set-point's x, y, z; the marker's x, y, z come first
YAW, SETPOINT = 3, 16


class Session:
    """One environment of one drone on a server. Requests have growing ids, and each has one reply."""

    def __init__(self, ws, **make):
        self.ws, self.id = ws, 0
        self.ask("hello", client="remote_client.py")
        self.made = self.ask("make", **make)

    def exchange(self, message):
        """Send a message and return its reply: bytes, or what JSON says."""
        self.ws.send(message)
        reply = self.ws.recv()
        answer = {} if isinstance(reply, bytes) else json.loads(reply)
        if answer.get("type") == "error":
            raise ValueError(f"{answer['code']}: {answer['message']}")
        return reply if isinstance(reply, bytes) else answer

    def ask(self, kind, **fields):
        """Send a request in JSON and return its reply."""
        self.id += 1
        return self.exchange(json.dumps({"id": self.id, "type": kind, **fields}))

    def step(self, action):
        """Fly a tick; returns the observation, the reward, and whether the flight has ended."""
        self.id += 1
        kind, flags, steps, envs = 2, 0, 1, 1
        reply = self.exchange(struct.pack("<QBBHI4f", self.id, kind, flags, steps, envs, *action))
        width = self.made["observation"]
        *row, reward, terminated, truncated = struct.unpack_from(f"<{width + 1}f2?", reply, HEADER.size)
        return row, reward, terminated or truncated


def act(row, before, tick_s, interface):
    """A PD towards the set-point: an action from -1 to 1, and the distance for the next tick."""
    x, y, z = (row[SETPOINT + axis] - row[axis] for axis in range(3))
    lean = [0.6 * (now + 0.2 * (now - last) / tick_s) for now, last in zip((x, y), before or (x, y), strict=True)]
    turn, height = -interface["yaw_sign"] * row[YAW], 2 * (row[SETPOINT + 2] + 0.2 * z) / interface["lift_max"] - 1
    return [max(-1.0, min(1.0, number)) for number in (-lean[1], lean[0], turn, height)], (x, y)


def fly(session, seed):
    """Fly an episode; returns its rows from the first one on, its actions and its rewards."""
    rows, actions, rewards = session.ask("reset", seed=seed)["observation"], [], []
    distance, over = None, False
    while not over:
        action, distance = act(rows[-1], distance, session.made["tick_s"], session.made["interface"])
        row, reward, over = session.step(action)
        rows.append(row), actions.append(action), rewards.append(reward)
    return rows, actions, rewards


if __name__ == "__main__":
    with connect(f"{sys.argv[1]}/ws", subprotocols=["crazyflie.v1"], compression=None) as ws:
        options = {"effects": {"gust": 0.2, "camera_noise": 0.01}}
        rows, actions, rewards = fly(Session(ws, env="Crazyflie-v0", options=options), seed=7)
    numbers = [number for row in rows for number in row]
    sha256 = hashlib.sha256(struct.pack(f"<{len(numbers)}f", *numbers)).hexdigest()
    print(f"{len(actions)} ticks, return {sum(rewards):.3f}, rows {sha256}")
