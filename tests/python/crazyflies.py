"""Simulated Crazyflies for the tests of cflib: the program on real sockets, connected and flown."""

import contextlib
import json
import math
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import cflib.crtp
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

PROGRAM = os.environ.get("CRAZYFLIE", str(Path(sys.executable).with_name("crazyflie")))
SPEED = 8


cflib.crtp.init_drivers()


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return str(tmp_path_factory.mktemp("cache"))


@contextlib.contextmanager
def simulated(*options, port=0):
    """The program; addresses of its drones."""
    with started(*options, port=port) as told:
        yield told["drones"]


@contextlib.contextmanager
def started(*options, port=0):
    """The program; what it tells of itself."""
    command = [PROGRAM, "cf2", "--json", "--port", str(port), *map(str, options)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield json.loads(process.stdout.readline())
        assert process.poll() is None, "it flies on, whatever was sent"
    finally:
        process.terminate()
        assert process.wait(timeout=10) == 0


class Link:
    """A connected Crazyflie that keeps what it is told of itself."""

    VARIABLES = (
        *(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "yaw")),
        "stabilizer.thrust",
    )

    def __init__(self, scf, speed):
        self.cf, self.speed, self.now, self.heights = scf.cf, speed, {}, []
        scf.wait_for_params()
        config = LogConfig("state", 50)
        for name in self.VARIABLES:
            config.add_variable(name)
        self.cf.log.add_config(config)
        config.data_received_cb.add_callback(self.take)
        config.start()
        self.until(lambda: self.now)

    def take(self, _time, values, _config):
        self.now = values
        self.heights.append(values["stateEstimate.z"])

    def until(self, condition, seconds=5):
        """Waits for something to become true, in real time."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"still not after {seconds} s: {self.now}"
            time.sleep(0.01)

    @property
    def place(self):
        return tuple(self.now[f"stateEstimate.{axis}"] for axis in "xyz")

    def sleep(self, seconds):
        """Simulated seconds."""
        time.sleep(seconds / self.speed)

    def repeat(self, seconds, send, *values):
        """The same set-point for so many simulated seconds."""
        end = time.monotonic() + seconds / self.speed
        while time.monotonic() < end:
            send(*values)
            time.sleep(0.02)

    def is_at(self, *place, within=0.1):
        assert math.dist(self.place, place) < within, f"at {self.place}, not at {place}"

    def take_off(self, height=0.5):
        self.cf.high_level_commander.takeoff(height, 2.0)
        self.sleep(3)


@contextlib.contextmanager
def flying(uri, cache, speed=SPEED):
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        yield Link(scf, speed)


@pytest.fixture
def drone():
    """The address of a drone that nobody has flown."""
    with simulated("--speed", SPEED) as drones:
        yield drones[0]["udp"]


@pytest.fixture
def link(drone, cache):
    """A connected one."""
    with flying(drone, cache) as link:
        yield link


def restart(uri):
    """As by the power button."""
    host, port = uri.removeprefix("udp://").split(":")
    end = time.monotonic() + 5
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
        raw.connect((host, int(port)))
        raw.settimeout(0.2)
        while time.monotonic() < end:
            with contextlib.suppress(OSError):
                raw.send(b"\xff\xfe\xf0\x01")
                raw.recv(64)
                break
            time.sleep(0.05)
        else:
            raise AssertionError("the drone stays another client's")
    # until the drone has noticed that this client is gone
    time.sleep(0.15)
