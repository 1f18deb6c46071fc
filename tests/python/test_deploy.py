"""`crazyflie deploy` flies controllers over stock cflib against the program `crazyflie cf2`, on real sockets."""

import json
import math
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from crazyflies import PROGRAM
from deployments import GOAL, OWN, SPEED, THERE, FlightOutcome, free_port, simulated, wait

pytest_plugins = ["deployments"]


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
        "policy": ["--controller", f"policy:{linear_policy(tmp_path / 'linear.safetensors')}"],
        "python": ["--controller", f"python:{tmp_path / 'own.py'}:Pd", "--controller-options", '{"tilt": 0.7}'],
        "thesis-pid": ["--controller", "thesis-pid"],
    }.get(kind, ["--controller", kind])
    (tmp_path / "own.py").write_text(OWN)
    summary = vehicle.fly(*THERE, *options).ended("done", 0)
    assert vehicle.truth.nearest(GOAL) < 0.12 and vehicle.truth.highest() < 1.0
    assert vehicle.truth.place[2] < 0.05, "it is on the ground"
    last = [row for row in vehicle.rows() if abs(row["setpoint_x_m"] - GOAL[0]) < 1e-6][-50:]
    assert max(math.dist([row[f"marker_{axis}_m"] for axis in "xyz"], GOAL) for row in last) < 0.15, "it stays"
    assert summary["flown_s"] == pytest.approx(4, abs=0.5) and summary["speed"] == pytest.approx(SPEED, rel=0.2)


def test_a_vehicle_that_waits_for_it_is_armed_and_follows_a_track(tmp_path):
    options = ["--task", "track", "--task-options", '{"size_m": 0.3, "period_s": 8}', "--duration", 8]
    with simulated(tmp_path, "--no-auto-arm") as vehicle:
        summary = vehicle.fly("--controller", "lqr", *options).ended("done", 0)
        xs, ys = ([row[i] for row in vehicle.truth.seen] for i in (1, 2))
    assert min(xs) < -0.2 and max(xs) > 0.2 and max(ys) - min(ys) > 0.15
    assert summary["rmse_m"] < 0.15


def test_the_log_is_read_back_as_the_flight_that_was_flown(vehicle):
    steps = [{"from_s": 2 * i, "setpoint_m": [x, y, 0.6]} for i, (x, y) in enumerate([(0.4, 0), (0, 0.3), (-0.3, 0)])]
    options = ["--duration", 7, "--task-options", json.dumps({"steps": steps})]
    summary = vehicle.fly("--controller", "lqr", *options).ended("done", 0)
    rows = vehicle.rows()
    times = [row["t_s"] for row in rows]
    assert len(rows) == summary["rows"] and np.median(np.diff(times)) == pytest.approx(0.01)
    # both clocks: the host's runs slower than that of a simulation in fast motion
    vehicle_s = (rows[-1]["vehicle_clock_ms"] - rows[0]["vehicle_clock_ms"]) / 1000
    host_s = rows[-1]["received_clock_s"] - rows[0]["received_clock_s"]
    assert vehicle_s / host_s == pytest.approx(SPEED, rel=0.1)
    # what was sent is in force a few samples later, to the vehicle's own rounding
    sent = [i for i, row in enumerate(rows) if "sent_clock_s" in row]
    names = ("roll_deg", "pitch_deg", "yaw_rate_degps", "thrust_pwm")
    obeyed = [
        any(all(row["cmd_" + name] == rows[i]["sent_" + name] for name in names) for row in rows[i : i + 4])
        for i in sent
    ]
    assert len(sent) > 0.9 * 50 * 7 and np.mean(obeyed) > 0.9, np.mean(obeyed)
    # what the log says against what was true at those times
    truth = {round(t_s * 1000): place for t_s, *place in vehicle.truth.seen}
    off = [
        math.dist([row[f"marker_{axis}_m"] for axis in "xyz"], truth[round(row["vehicle_clock_ms"])])
        for row in rows
        if "marker_x_m" in row and round(row["vehicle_clock_ms"]) in truth
    ]
    assert len(off) > 0.8 * len(rows) and np.percentile(off, 95) < 0.01, np.percentile(off, 95)
    asked = ["--horizon", "1", "--vertical", "thrust", "--json"]
    read = subprocess.run([PROGRAM, "replay", vehicle.log, *asked], capture_output=True, text=True)
    assert read.returncode == 0, read.stderr
    log = json.loads(read.stdout)["logs"][0]
    signals = log["runs"][0]["signals"]
    # the declared model is the vehicle's: its commands foretell the flight
    assert all(signals[axis]["rmse"] < 0.02 for axis in "xyz"), signals
    assert all(signals[angle]["rmse"] < 0.1 for angle in ("roll", "pitch")), signals
    assert not any("ignored" in note for note in log["notes"]), log["notes"]


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
        summary = FlightOutcome(process)
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
        vehicle.fly(*THERE, *options).ended("done", 0)
        assert vehicle.truth.nearest(GOAL) < 0.12 and vehicle.truth.place[2] < 0.05
        fixes = [row for row in vehicle.rows() if "marker_t_s" in row]
        ages = [row["t_s"] - row["marker_t_s"] for row in fixes]
        assert 0.02 < np.median(ages) < 0.09 and len(fixes) < 0.5 * len(vehicle.rows())


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


options = {{"task_options": {{"setpoint_m": {list(GOAL)}}}, "duration_s": 4, "stale_s": 1.5, "log": "own.csv"}}
settings = Settings("{vehicle.uri}", position="mocap", poses=poses, **options)
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
