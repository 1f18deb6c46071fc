"""Simulated Crazyflies for the tests of cflib: the program on real sockets, connected and flown in lock-step."""

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

from common import LIMIT_S, wait
from crazyflie_gym.lockstep import Clock

PROGRAM = os.environ.get("CRAZYFLIE", str(Path(sys.executable).with_name("crazyflie")))


cflib.crtp.init_drivers()


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return str(tmp_path_factory.mktemp("cache"))


@contextlib.contextmanager
def simulated(*options, **kwargs):
    """The program; addresses of its drones."""
    with started(*options, **kwargs) as told:
        yield told["drones"]


@contextlib.contextmanager
def started(*options, port=0, pace=("--lockstep",)):
    """The program; what it tells of itself."""
    command = [PROGRAM, "cf2", "--json", "--port", port, *pace, *options]
    process = subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, text=True)
    try:
        yield json.loads(process.stdout.readline())
        assert process.poll() is None, "it flies on, whatever was sent"
    finally:
        process.terminate()
        assert process.wait(timeout=LIMIT_S) == 0


class Link:
    """A connected Crazyflie that keeps what it is told of itself."""

    VARIABLES = (
        *(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "yaw")),
        "stabilizer.thrust",
    )

    def __init__(self, scf):
        self.cf, self.now, self.heights = scf.cf, {}, []
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

    def until(self, condition, seconds=LIMIT_S):
        """Waits for something to become true."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"still not after {seconds} s: {self.now}"
            time.sleep(0.01)

    @property
    def place(self):
        return tuple(self.now[f"stateEstimate.{axis}"] for axis in "xyz")

    def repeat(self, seconds, send, *values):
        """The same set-point for so many seconds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            send(*values)
            time.sleep(0.02)

    def is_at(self, *place, within=0.1):
        assert math.dist(self.place, place) < within, f"at {self.place}, not at {place}"

    def take_off(self, height=0.5):
        self.cf.high_level_commander.takeoff(height, 2.0)
        time.sleep(3)


@contextlib.contextmanager
def connected(uri, cache):
    with SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache)) as scf:
        yield Link(scf)


@contextlib.contextmanager
def flying(uri, cache):
    """In lock-step: time is the drone's."""
    with Clock(), connected(uri, cache) as link:
        yield link


@pytest.fixture
def drone():
    """The address of a drone that nobody has flown."""
    with simulated() as drones:
        yield drones[0]["udp"]


@pytest.fixture
def link(drone, cache):
    """A connected one."""
    with flying(drone, cache) as link:
        yield link


def restart(uri):
    """As by the power button."""
    host, port = uri.removeprefix("udp://").split(":")

    def is_answered(packet):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw, contextlib.suppress(OSError):
            raw.connect((host, int(port)))
            raw.settimeout(0.2)
            raw.send(packet)
            return raw.recv(64)

    wait(lambda: is_answered(b"\xff\xfe\xf0\x01"), "the drone stays another client's")
    # a scan finds it as soon as it has noticed that this client is gone
    wait(lambda: is_answered(b"\xff"), "the drone stays this client's")
