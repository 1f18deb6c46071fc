"""Deployments for the tests: `crazyflie deploy` on the program `crazyflie cf2`, over real sockets.

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
import time

import pytest

from crazyflies import PROGRAM

SPEED = 4
# a loaded machine stands still for a moment, in which a simulation four times as fast flies four
PATIENCE = ("--stale", 1.5)
GOAL = (0.3, -0.2, 0.7)
THERE = ("--setpoint", ",".join(map(str, GOAL)), "--duration", 4)


class Truth:
    """True poses of a simulated vehicle, as they come."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.2)
        self.address = f"127.0.0.1:{self.socket.getsockname()[1]}"
        self.seen, self.forward, self._ended = [], None, False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while not self._ended:
            with contextlib.suppress(TimeoutError, OSError):
                message = json.loads(self.socket.recv(4096))
                self.seen.append((message["t_s"], *message["pos_m"]))
                if self.forward is not None:
                    self.forward(message)

    def close(self):
        self._ended = True
        self._thread.join(timeout=2)
        self.socket.close()

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

    def __init__(self, told, truth, folder, process):
        self.uri, self.truth, self.folder, self.process = told["drones"][0]["udp"], truth, folder, process
        self.log = folder / "flight.csv"

    def command(self, *options):
        patience = () if "--stale" in options else PATIENCE
        words = ["deploy", "--uri", self.uri, "--log", self.log, "--json", *patience, *options]
        return [sys.executable, "-m", "crazyflie_gym", *map(str, words)]

    def start(self, *options, **kwargs):
        env = os.environ | {"XDG_CACHE_HOME": str(self.folder / "cache")}
        kwargs = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | kwargs
        return subprocess.Popen(self.command(*options), text=True, env=env, cwd=self.folder, **kwargs)

    def fly(self, *options):
        return FlightOutcome(self.start(*options))

    def rows(self):
        with open(self.log, newline="") as file:
            return [{name: float(cell) for name, cell in row.items() if cell} for row in csv.DictReader(file)]


class FlightOutcome:
    """How a flight ended."""

    def __init__(self, process, timeout=60):
        out, self.told = process.communicate(timeout=timeout)
        self.code = process.returncode
        self.summary = json.loads(out) if out.strip() else {}

    def ended(self, reason, code, landed=True):
        assert self.code == code, self.told
        assert self.summary["reason"] == reason, self.told
        assert self.summary["landed"] is landed and self.summary["ok"] is (code == 0), self.told
        assert reason == "done" or reason in self.told
        return self.summary


@contextlib.contextmanager
def simulated(folder, *options, speed=SPEED):
    truth = Truth()
    words = ["cf2", "--json", "--port", 0, "--speed", speed, "--poses", truth.address, *options]
    process = subprocess.Popen([PROGRAM, *map(str, words)], stdout=subprocess.PIPE, text=True)
    try:
        yield Vehicle(json.loads(process.stdout.readline()), truth, folder, process)
    finally:
        process.terminate()
        process.wait(timeout=10)
        truth.close()


@pytest.fixture
def vehicle(tmp_path):
    with simulated(tmp_path) as vehicle:
        yield vehicle


def wait(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


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


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        return port.getsockname()[1]
