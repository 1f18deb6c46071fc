"""`crazyflie deploy` flies controllers over stock cflib against the program `crazyflie cf2`, on real sockets.

Where a vehicle truly is, `cf2 --poses` tells the test: not what the flight itself believes."""

import contextlib
import csv
import json
import math
import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from crazyflies import PROGRAM

SPEED = 6
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
        words = ["deploy", "--uri", self.uri, "--log", self.log, "--json", *options]
        return [sys.executable, "-m", "crazyflie_gym", *map(str, words)]

    def start(self, *options, **kwargs):
        env = os.environ | {"XDG_CACHE_HOME": str(self.folder / "cache")}
        kwargs = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | kwargs
        return subprocess.Popen(self.command(*options), text=True, env=env, cwd=self.folder, **kwargs)

    def fly(self, *options):
        return Flown(self.start(*options))

    def rows(self):
        with open(self.log, newline="") as file:
            return [{name: float(cell) for name, cell in row.items() if cell} for row in csv.DictReader(file)]


class Flown:
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
def simulated(folder, *options):
    truth = Truth()
    words = ["cf2", "--json", "--port", 0, "--speed", SPEED, "--poses", truth.address, *options]
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


def linear_policy(path):
    """A policy that is a linear controller: a push towards the place against the velocity, with the model's signs."""
    from safetensors.numpy import save_file

    width = 19 + 12
    skip = np.zeros((width, 4), np.float32)
    # features: position error, velocity, push (3 each), yaw error; actions: roll, pitch, yaw rate, lift
    skip[1, 0], skip[4, 0] = -0.8, 0.9
    skip[0, 1], skip[3, 1] = 0.8, -0.9
    skip[9, 2] = -0.4
    skip[2, 3], skip[5, 3] = 1.0, -0.6
    tensors = {"taus_s": [0.2], "feature_mean": [0.0] * width, "feature_std": [1.0] * width, "skip.weight": skip}
    tensors |= {"layer0.weight": np.zeros((width, 4)), "layer0.bias": np.zeros(4)}
    plain = {name: np.array(value, np.float32) for name, value in tensors.items()}
    save_file(plain, path, {"format": "crazyflie-policy-2", "tick_s": "0.02"})
    return path


@pytest.mark.parametrize("kind", ["thesis-pid", "lqr", "velocity", "mpc", "height", "policy", "python"])
def test_controllers_of_every_kind_fly_and_land(vehicle, kind, tmp_path):
    options = {
        "height": ["--controller", "thesis-pid", "--vertical", "height"],
        "policy": ["--controller", f"policy:{linear_policy(tmp_path / 'linear.safetensors')}", "--vertical", "thrust"],
        "python": ["--controller", f"python:{tmp_path / 'own.py'}:Pd", "--controller-options", '{"tilt": 0.7}'],
        "thesis-pid": ["--controller", "thesis-pid"],
    }.get(kind, ["--controller", kind, "--vertical", "thrust"])
    (tmp_path / "own.py").write_text(OWN)
    summary = vehicle.fly(*THERE, *options).ended("done", 0)
    assert vehicle.truth.nearest(GOAL) < 0.12 and vehicle.truth.highest() < 1.0
    assert vehicle.truth.place[2] < 0.05, "it is on the ground"
    last = [row for row in vehicle.rows() if abs(row["setpoint_x_m"] - GOAL[0]) < 1e-6][-1]
    at = [last[f"marker_{axis}_m"] for axis in "xyz"]
    assert math.dist(at, GOAL) < 0.15, at
    assert summary["flown_s"] == pytest.approx(4, abs=0.5) and summary["speed"] == pytest.approx(SPEED, rel=0.2)


def test_a_track_is_followed(vehicle):
    options = ["--task", "track", "--task-options", '{"size_m": 0.3, "period_s": 8}', "--duration", 8]
    summary = vehicle.fly("--controller", "lqr", "--vertical", "thrust", *options).ended("done", 0)
    xs, ys = ([row[i] for row in vehicle.truth.seen] for i in (1, 2))
    assert min(xs) < -0.2 and max(xs) > 0.2 and max(ys) - min(ys) > 0.15
    assert summary["rmse_m"] < 0.15


def test_a_vehicle_that_waits_for_it_is_armed(tmp_path):
    with simulated(tmp_path, "--no-auto-arm") as vehicle:
        vehicle.fly("--duration", 1).ended("done", 0)
        assert vehicle.truth.highest() > 0.4


@pytest.mark.parametrize("how", ["key", "signal"])
def test_a_key_lands_and_a_second_one_stops(vehicle, how):
    parent, child = pty.openpty()

    def press(process):
        if how == "key":
            os.write(parent, b" ")
        else:
            process.send_signal(signal.SIGINT)

    for presses in (1, 2):
        process = vehicle.start("--duration", 60, stdin=child)
        wait(lambda: vehicle.truth.seen and vehicle.truth.place[2] > 0.45)
        time.sleep(3 / SPEED)
        press(process)
        if presses == 2:
            wait(lambda: vehicle.truth.place[2] < 0.42)
            press(process)
        summary = Flown(process).ended("key", 0, landed=presses == 1)
        assert ("stopped" in summary) is (presses == 2)
        if presses == 1:
            assert vehicle.truth.place[2] < 0.05
    wait(lambda: vehicle.truth.place[2] < 0.03)
    os.close(parent), os.close(child)


@pytest.mark.parametrize(
    "reason, options, simulator",
    [
        ("room", ["--room", "0.2,1,1.5", *THERE], []),
        ("room", ["--room", "1,1,0.55", "--setpoint", "0,0,0.8"], []),
        ("tilt", ["--tilt-max", 2, *THERE], []),
        ("time", ["--time-limit", 3.0, "--duration", 30], []),
        ("battery", ["--battery-min", 3.66, "--duration", 60],
         ["--effects", '{"battery_sag": {"exponent": 0, "charge": 0.3, "resistance_ohm": 0.1}}']),
    ],
)  # fmt: skip
def test_soft_limits_land(tmp_path, reason, options, simulator):
    with simulated(tmp_path, *simulator) as vehicle:
        vehicle.fly(*options).ended(reason, 1)
        x, _, z = vehicle.truth.place
        # under load the voltage is low from the start
        assert vehicle.truth.highest() > (0.1 if reason == "battery" else 0.4) and z < 0.05
        if "0.2,1,1.5" in options:
            assert 0.15 < x < 0.5


@pytest.mark.parametrize("name, told", [("Wrong", "lost my way"), ("NotANumber", "nan")])
def test_a_controller_that_fails_is_landed(vehicle, tmp_path, name, told):
    (tmp_path / "own.py").write_text(OWN)
    flown = vehicle.fly("--controller", f"python:{tmp_path / 'own.py'}:{name}", *THERE)
    summary = flown.ended("controller", 1)
    assert told in flown.told and told in summary["detail"]
    assert ("raise RuntimeError" in flown.told) is (name == "Wrong"), "the traceback leads into the file"
    assert vehicle.truth.nearest((*GOAL[:2], 0.02)) < 0.3 and vehicle.truth.place[2] < 0.05


def test_a_vehicle_that_is_gone_ends_the_flight_with_an_error(vehicle):
    process = vehicle.start("--duration", 60)
    wait(lambda: vehicle.truth.seen and vehicle.truth.place[2] > 0.45)
    time.sleep(4 / SPEED)
    vehicle.process.kill()
    vehicle.process.wait()
    flown = Flown(process)
    flown.ended("stale", 1, landed=False)
    rows = vehicle.rows()
    assert len(rows) > 100 and rows[-1]["marker_z_m"] > 0.3 if "marker_z_m" in rows[-1] else len(rows) > 100
    beside = json.loads(vehicle.log.with_name("flight.csv.json").read_text())
    assert beside["settings"]["uri"] == vehicle.uri and beside["summary"]["reason"] == "stale"


def test_nobody_at_the_address_is_an_error(tmp_path):
    command = [sys.executable, "-m", "crazyflie_gym", "deploy", "--uri", "udp://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=60)
    assert done.returncode == 1 and "udp://127.0.0.1:9" in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.glob("deploy-*"))


def test_a_vehicle_that_is_not_fit_stays_on_the_ground(tmp_path):
    with simulated(tmp_path) as vehicle:
        flown = vehicle.fly("--battery-min", 4.5)
        assert flown.code == 1 and "check: the battery is at 4.20 V" in flown.told
        assert vehicle.truth.highest() < 0.01


def test_the_log_is_read_back_as_the_flight_that_was_flown(vehicle):
    steps = [{"from_s": 2 * i, "setpoint_m": [x, y, 0.6]} for i, (x, y) in enumerate([(0.4, 0), (0, 0.3), (-0.3, 0)])]
    options = ["--duration", 7, "--task-options", json.dumps({"steps": steps}), "--vertical", "thrust"]
    summary = vehicle.fly("--controller", "lqr", *options).ended("done", 0)
    rows = vehicle.rows()
    times = [row["t_s"] for row in rows]
    assert len(rows) == summary["rows"] and 0.015 < np.median(np.diff(times)) < 0.025
    # both clocks: the host's runs slower than that of a simulation in fast motion
    vehicle_s = (rows[-1]["vehicle_clock_ms"] - rows[0]["vehicle_clock_ms"]) / 1000
    host_s = rows[-1]["sent_clock_s"] - rows[0]["sent_clock_s"]
    assert vehicle_s / host_s == pytest.approx(SPEED, rel=0.1)
    assert all(row["received_clock_s"] <= row["sent_clock_s"] + 1e-6 for row in rows)
    # what the log says against what was true at those times, a step of 10 ms off at most
    truth = {round(t_s * 1000): place for t_s, *place in vehicle.truth.seen}
    off = [
        math.dist([row[f"marker_{axis}_m"] for axis in "xyz"], truth[round(row["vehicle_clock_ms"])])
        for row in rows
        if "marker_x_m" in row and round(row["vehicle_clock_ms"]) in truth
    ]
    assert len(off) > 0.8 * len(rows) and np.percentile(off, 95) < 0.02, np.percentile(off, 95)
    read = subprocess.run([PROGRAM, "replay", vehicle.log, "--horizon", "1", "--json"], capture_output=True, text=True)
    assert read.returncode == 0, read.stderr
    log = json.loads(read.stdout)["logs"][0]
    signals = log["runs"][0]["signals"]
    # the declared model is the vehicle's: its commands foretell the flight, but for the link's delay
    assert signals["x"]["rmse"] < 0.04 and signals["y"]["rmse"] < 0.04 and signals["z"]["rmse"] < 0.05, signals
    assert signals["roll"]["rmse"] < 1.0 and signals["pitch"]["rmse"] < 1.0, signals
    assert not any("ignored" in note for note in log["notes"]), log["notes"]


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        return port.getsockname()[1]


def test_motion_capture_is_flown_by_and_its_end_is_a_landing(tmp_path):
    target = ("127.0.0.1", free_port())
    with simulated(tmp_path, "--position", "none") as vehicle, socket.socket(type=socket.SOCK_DGRAM) as port:

        def forward(message):
            port.sendto(b"no pose", target)
            port.sendto(json.dumps(message | {"body": "other", "pos_m": [9, 9, 9]}).encode(), target)
            port.sendto(json.dumps(message).encode(), target)

        vehicle.truth.forward = forward
        options = ["--position", "mocap", "--poses", f"udp://127.0.0.1:{target[1]}/0"]
        vehicle.fly(*THERE, *options).ended("done", 0)
        assert vehicle.truth.nearest(GOAL) < 0.1 and vehicle.truth.place[2] < 0.05
        process = vehicle.start(*options, "--duration", 60)
        count = len(vehicle.truth.seen)
        wait(lambda: max(row[3] for row in vehicle.truth.seen[count:] or [(0, 0, 0, 0)]) > 0.45)
        time.sleep(4 / SPEED)
        vehicle.truth.forward = None
        summary = Flown(process)
        assert summary.code == 1 and summary.summary["reason"] == "stale", summary.told
        assert summary.summary["levelled"] >= 3
        time.sleep(2 / SPEED)
        assert vehicle.truth.place[2] < 0.05


def test_a_marker_in_the_camera_is_flown_by(tmp_path):
    """Poses of the marker as a camera 2 cm below the vehicle sees it, 30 a second and a frame old."""
    from scipy.spatial.transform import Rotation

    # picture's right and down, and the view, along the body's axes
    camera = Rotation.from_matrix(np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]]))
    target = ("127.0.0.1", free_port())
    with simulated(tmp_path, "--position", "none") as vehicle, socket.socket(type=socket.SOCK_DGRAM) as port:
        late, last = [], [0.0]

        def forward(message):
            if message["t_s"] - last[0] < 0.0333:
                return
            last[0] = message["t_s"]
            body = Rotation.from_quat(message["quat_xyzw"])
            lens = np.array(message["pos_m"]) + body.apply([0, 0, -0.02])
            seen = (body * camera).inv()
            told = {"tvec_m": seen.apply(-lens).tolist(), "rvec_rad": seen.as_rotvec().tolist()}
            late.append(json.dumps(told | {"age_s": 0.0333 / SPEED}).encode())
            if len(late) > 1:
                port.sendto(late.pop(0), target)

        vehicle.truth.forward = forward
        options = ["--position", "aruco", "--poses", f"udp://127.0.0.1:{target[1]}", "--controller", "lqr"]
        vehicle.fly("--vertical", "thrust", *THERE, *options).ended("done", 0)
        assert vehicle.truth.nearest(GOAL) < 0.12 and vehicle.truth.place[2] < 0.05
        fixes = [row for row in vehicle.rows() if "marker_t_s" in row]
        ages = [row["t_s"] - row["marker_t_s"] for row in fixes]
        assert 0.02 < np.median(ages) < 0.09 and len(fixes) < 0.75 * len(vehicle.rows())


def test_from_python_with_a_function_that_yields_poses(tmp_path):
    with simulated(tmp_path, "--position", "none") as vehicle:
        script = tmp_path / "mine.py"
        script.write_text(
            f"""
import json, socket
from crazyflie_gym.deploy import Settings, deploy


def poses():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", {free_port()}))
        print(port.getsockname()[1], flush=True)
        while True:
            yield json.loads(port.recv(4096))


options = {{"setpoint_m": {list(GOAL)}}}
settings = Settings("{vehicle.uri}", position="mocap", poses=poses, duration_s=4, task_options=options, log="own.csv")
print(json.dumps(deploy(settings)))
"""
        )
        process = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
        target = ("127.0.0.1", int(process.stdout.readline()))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
            vehicle.truth.forward = lambda message: port.sendto(json.dumps(message).encode(), target)
            out, _ = process.communicate(timeout=60)
            vehicle.truth.forward = None
        summary = json.loads(out)
        assert summary["reason"] == "done" and summary["landed"] and (tmp_path / "own.csv").exists()
        assert vehicle.truth.nearest(GOAL) < 0.12
