"""Deployments for the tests: `crazyflie deploy` on the program `crazyflie cf2`, over real sockets and in lock-step.

Where a vehicle truly is, `cf2 --poses` tells the test: not what the flight itself believes."""

import contextlib
import csv
import json
import math
import os
import socket
import subprocess
import sys
import threading

import pytest

from common import LIMIT_S, wait
from crazyflies import PROGRAM

GOAL = (0.3, -0.2, 0.7)
THERE = ("--setpoint", ",".join(map(str, GOAL)), "--duration", 4)


class Truth:
    """True poses of a simulated vehicle, as the program writes them."""

    def __init__(self, lines):
        self.seen = []
        self._thread = threading.Thread(target=self._read, args=(lines,), daemon=True)
        self._thread.start()

    def _read(self, lines):
        for line in lines:
            message = json.loads(line)
            self.seen.append((message["t_s"], *message["pos_m"]))

    def close(self):
        self._thread.join()

    def until(self, t_s):
        """Waits until all is read that happened before."""
        wait(lambda: self.seen and self.seen[-1][0] >= t_s)

    @property
    def place(self):
        return self.seen[-1][1:]

    def nearest(self, goal):
        """The least distance to a place over the whole flight."""
        return min(math.dist(row[1:], goal) for row in self.seen)

    def highest(self):
        return max(row[3] for row in self.seen)


class Vehicle:
    """A simulated Crazyflie, what is true of it, and flights on it."""

    def __init__(self, process, folder):
        self.uri = json.loads(process.stdout.readline())["drones"][0]["udp"]
        self.truth, self.folder, self.process = Truth(process.stdout), folder, process
        self.log = folder / "flight.csv"

    def command(self, *options):
        words = ["deploy", "--lockstep", "--uri", self.uri, "--log", self.log, "--json", *options]
        return [sys.executable, "-m", "crazyflie_gym", *map(str, words)]

    def start(self, *options, **kwargs):
        env = os.environ | {"XDG_CACHE_HOME": str(self.folder / "cache")}
        kwargs = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | kwargs
        return subprocess.Popen(self.command(*options), text=True, env=env, cwd=self.folder, **kwargs)

    def fly(self, *options):
        return self.outcome(self.start(*options))

    def outcome(self, process):
        outcome = FlightOutcome(process)
        self.truth.until(outcome.summary.get("states", {}).get("end", 0.0))
        return outcome

    def wait_high(self, seconds):
        """Waits until it has been in the air for some seconds."""
        high_s = wait(lambda: next((t_s for t_s, _, _, z in self.truth.seen if z > 0.45), None))
        self.truth.until(high_s + seconds)

    def rows(self):
        with open(self.log, newline="") as file:
            return [{name: float(cell) for name, cell in row.items() if cell} for row in csv.DictReader(file)]


class FlightOutcome:
    """How a flight ended."""

    def __init__(self, process):
        out, self.told = process.communicate(timeout=LIMIT_S)
        self.code = process.returncode
        self.summary = json.loads(out) if out.strip() else {}

    def ended(self, reason, code, landed=True):
        assert self.code == code, self.told
        assert self.summary["reason"] == reason, self.told
        assert self.summary["landed"] is landed and self.summary["ok"] is (code == 0), self.told
        assert reason == "done" or reason in self.told
        return self.summary


@contextlib.contextmanager
def simulated(folder, *options):
    words = ["cf2", "--json", "--port", 0, "--lockstep", "--poses", "/dev/stdout", *options]
    process = subprocess.Popen([PROGRAM, *map(str, words)], stdout=subprocess.PIPE, text=True)
    try:
        vehicle = Vehicle(process, folder)
        yield vehicle
    finally:
        process.terminate()
        process.wait(timeout=LIMIT_S)
    vehicle.truth.close()


@pytest.fixture
def vehicle(tmp_path):
    with simulated(tmp_path) as vehicle:
        yield vehicle


OWN = """
import numpy as np


class Pd:
    def __init__(self, num_envs, interface, tilt=0.8):
        self.tilt, self.level = tilt, 2 * interface.hover_lift / interface.lift_max - 1
        self.before = None

    def reset(self, mask):
        self.before = None

    def act(self, rows):
        off = rows[:, 16:19] - rows[:, 0:3]
        slope = 0 * off if self.before is None else (off - self.before) / 0.02
        self.before = off
        asked = self.tilt * off + 0.8 * slope
        actions = np.zeros((len(rows), 4))
        actions[:, 0], actions[:, 1] = -asked[:, 1], asked[:, 0]
        actions[:, 3] = self.level + asked[:, 2]
        return np.clip(actions, -1, 1)


class Wrong(Pd):
    def act(self, rows):
        if abs(rows[0, 16] - rows[0, 0]) < 0.15:
            raise RuntimeError("lost my way")
        return super().act(rows)


class NotANumber(Pd):
    def act(self, rows):
        actions = super().act(rows)
        if abs(rows[0, 16] - rows[0, 0]) < 0.15:
            actions[:] = np.nan
        return actions


class Backwards(Pd):
    def act(self, rows):
        actions = super().act(rows)
        actions[:, 0:2] *= -1
        return actions
"""


# poses as `cf2 --poses` sends them, to a port of which a test knows; more of a file that `--poses python:` reads
POSES = """
import json
import os
import signal
import socket


def received():
    with socket.socket(type=socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", {port}))
        while True:
            yield json.loads(port.recv(4096))


def since_high(seconds):
    # each pose, and whether the vehicle has been in the air for so long
    high_s = None
    for message in received():
        if high_s is None and message["pos_m"][2] > 0.45:
            high_s = message["t_s"]
        yield message, high_s is not None and message["t_s"] > high_s + seconds

"""


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        return port.getsockname()[1]
