"""`crazyflie deploy` flies controllers over stock cflib against the program `crazyflie cf2`, on real sockets."""

import json
import math
import socket
import subprocess
import sys
import time

import gymnasium
import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from crazyflies import PROGRAM
from deployments import GOAL, OWN, POSES, THERE, free_port, simulated

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


def exported_policy(path, **options):
    """The same controller as a layer that reads an estimate, or what is chosen, and commands a PWM."""
    env = gymnasium.make("Crazyflie-v0", vertical="pwm", observation=["error_m", "vel_mps", "yaw_error_rad"]).unwrapped
    kernel, interface = np.zeros((7, 4)), env.interface
    kernel[1, 0], kernel[4, 0] = -0.8, 0.9
    kernel[0, 1], kernel[3, 1] = 0.8, -0.9
    kernel[6, 2] = -0.4
    kernel[2, 3], kernel[5, 3] = 1.0, -0.6
    bias = np.array([0.0, 0.0, 0.0, 2 * interface.hover_lift / interface.lift_max - 1])
    crazyflie_gym.export_policy([{"kernel": kernel, "bias": bias}], path, env=env, **options)
    return path


def test_a_policy_of_the_true_state_does_not_leave_the_floor(vehicle, tmp_path):
    process = vehicle.start(*THERE, "--controller", f"policy:{exported_policy(tmp_path / 'truth.safetensors')}")
    assert "it reads the true state, and no vehicle measures it" in process.communicate(timeout=LIMIT_S)[1]
    assert process.returncode == 2


@pytest.mark.parametrize("kind", ["thesis-pid", "lqr", "velocity", "mpc", "height", "policy", "exported", "python"])
def test_controllers_of_every_kind_fly_and_land(vehicle, kind, tmp_path):
    options = {
        "height": ["--controller", "thesis-pid", "--vertical", "height"],
        "policy": ["--controller", f"policy:{linear_policy(tmp_path / 'linear.safetensors')}"],
        "exported": [
            "--controller",
            f"policy:{exported_policy(tmp_path / 'exported.safetensors', estimated=True)}",
        ],
        "python": ["--controller", f"python:{tmp_path / 'own.py'}:Pd", "--controller-options", '{"tilt": 0.7}'],
        "thesis-pid": ["--controller", "thesis-pid"],
    }.get(kind, ["--controller", kind])
    (tmp_path / "own.py").write_text(OWN)
    summary = vehicle.fly(*THERE, *options).ended("done", 0)
    assert vehicle.truth.nearest(GOAL) < 0.12 and vehicle.truth.highest() < 1.0
    assert vehicle.truth.place[2] < 0.05, "it is on the ground"
    last = [row for row in vehicle.rows() if abs(row["setpoint_x_m"] - GOAL[0]) < 1e-6][-50:]
    assert max(math.dist([row[f"marker_{axis}_m"] for axis in "xyz"], GOAL) for row in last) < 0.15, "it stays"
    assert summary["flown_s"] == 4 and summary["missed"] == 0 and summary["speed"] == 1


def test_a_controller_of_another_vehicle_than_the_one_that_flies_is_told(tmp_path):
    with simulated(tmp_path, "--vehicle", "cf21") as vehicle:
        for name, is_told in (("cf21-brushless", True), ("cf21", False)):
            told = vehicle.fly("--vehicle", name, "--duration", 0.5).told
            assert (f"is a cf21, and the controller's model is that of {name}" in told) is is_told, told


def test_real_vehicles_tell_their_platform():
    from crazyflie_gym.deploy.command import is_other

    platforms = {"Crazyflie 2.0": "cf2-thesis", "Crazyflie 2.1": "cf21", "Crazyflie 2.1 Brushless": "cf21-brushless"}
    for kind in platforms:
        assert [name for name in platforms.values() if not is_other(kind, name)] == [platforms[kind]]
    assert not is_other("Crazyflie 2.1", "mine") and not is_other("", "cf21") and is_other("Crazyflie Bolt", "cf21")


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
    # both clocks: in lock-step the host's is the vehicle's
    vehicle_s = (rows[-1]["vehicle_clock_ms"] - rows[0]["vehicle_clock_ms"]) / 1000
    host_s = rows[-1]["received_clock_s"] - rows[0]["received_clock_s"]
    assert vehicle_s == pytest.approx(host_s, abs=1e-3)
    # a sent command is in force a few samples later, to the vehicle's own rounding
    sent = [i for i, row in enumerate(rows) if "sent_clock_s" in row]
    names = ("roll_deg", "pitch_deg", "yaw_rate_degps", "thrust_pwm")
    obeyed = [
        any(all(row["cmd_" + name] == rows[i]["sent_" + name] for name in names) for row in rows[i : i + 4])
        for i in sent
    ]
    assert len(sent) > 0.9 * 50 * 7 and np.mean(obeyed) > 0.9, np.mean(obeyed)
    # logged positions against true ones at those times
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
    port = free_port()
    (tmp_path / "ends.py").write_text(
        POSES.format(port=port)
        + """
def poses():
    for message, is_over in since_high(4):
        if is_over:
            return
        yield message
"""
    )
    listens = f"127.0.0.1:{port}"
    with simulated(tmp_path, "--position", "none", "--poses", listens) as vehicle:
        process = vehicle.start(*THERE, "--position", "mocap", "--poses", f"udp://{listens}/0")
        with socket.socket(type=socket.SOCK_DGRAM) as stranger:
            while process.poll() is None:
                stranger.sendto(b"no pose", ("127.0.0.1", port))
                other = {"body": "other", "pos_m": [9, 9, 9]}
                stranger.sendto(json.dumps(other).encode(), ("127.0.0.1", port))
                time.sleep(0.001)
        vehicle.outcome(process).ended("done", 0)
        assert vehicle.truth.nearest(GOAL) < 0.1 and vehicle.truth.place[2] < 0.05
        options = ["--position", "mocap", "--poses", f"python:{tmp_path / 'ends.py'}:poses"]
        flown = vehicle.fly(*options, "--duration", 60)
        assert flown.code == 1 and flown.summary["reason"] == "stale", flown.told
        assert flown.summary["levelled"] >= 3
        assert vehicle.truth.place[2] < 0.05


def test_a_marker_in_the_camera_is_flown_by(tmp_path):
    """Poses of the marker as a camera 2 cm below the vehicle sees it, 30 a second and a frame old."""
    port = free_port()
    (tmp_path / "camera.py").write_text(
        POSES.format(port=port)
        + """
def poses():
    import numpy as np
    from scipy.spatial.transform import Rotation

    # picture's right and down, and the view, along the body's axes
    camera = Rotation.from_matrix(np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]]))
    late, last_s = [], 0.0
    for message in received():
        if message["t_s"] - last_s < 0.0333:
            continue
        last_s = message["t_s"]
        body = Rotation.from_quat(message["quat_xyzw"])
        lens = np.array(message["pos_m"]) + body.apply([0, 0, -0.02])
        seen = (body * camera).inv()
        late.append({"tvec_m": seen.apply(-lens).tolist(), "rvec_rad": seen.as_rotvec().tolist(), "age_s": 0.0333})
        if len(late) > 1:
            yield late.pop(0)
"""
    )
    with simulated(tmp_path, "--position", "none", "--poses", f"127.0.0.1:{port}") as vehicle:
        options = ["--position", "aruco", "--poses", f"python:{tmp_path / 'camera.py'}:poses", "--controller", "lqr"]
        vehicle.fly(*THERE, *options).ended("done", 0)
        assert vehicle.truth.nearest(GOAL) < 0.12 and vehicle.truth.place[2] < 0.05
        fixes = [row for row in vehicle.rows() if "marker_t_s" in row]
        ages = [row["t_s"] - row["marker_t_s"] for row in fixes]
        assert 0.02 < np.median(ages) < 0.09 and len(fixes) < 0.5 * len(vehicle.rows())


def test_from_python_with_a_function_that_yields_poses(tmp_path):
    port = free_port()
    with simulated(tmp_path, "--position", "none", "--poses", f"127.0.0.1:{port}") as vehicle:
        script = tmp_path / "mine.py"
        script.write_text(
            POSES.format(port=port)
            + f"""
from crazyflie_gym.deploy import Settings, deploy

options = {{"task_options": {{"setpoint_m": {list(GOAL)}}}, "duration_s": 4, "lockstep": True, "log": "own.csv"}}
settings = Settings("{vehicle.uri}", position="mocap", poses=received, **options)
print(json.dumps(deploy(settings)))
"""
        )
        done = subprocess.run([sys.executable, script], capture_output=True, text=True, cwd=tmp_path, timeout=LIMIT_S)
        summary = json.loads(done.stdout)
        assert summary["reason"] == "done" and summary["landed"] and (tmp_path / "own.csv").exists()
        vehicle.truth.until(summary["states"]["end"])
        assert vehicle.truth.nearest(GOAL) < 0.12


def test_the_same_commands_fly_the_same_bits(tmp_path):
    logs = []
    for name in ("one", "two"):
        (folder := tmp_path / name).mkdir()
        with simulated(folder, "--effects", "camera_noise.xy_m=0.004", "--seed", 3, "--loss", 0.05) as vehicle:
            vehicle.fly(*THERE, "--controller", "lqr").ended("done", 0)
        # the host's clocks begin anywhere
        logs.append([{key: n for key, n in row.items() if "clock_s" not in key} for row in vehicle.rows()])
        logs.append(vehicle.truth.seen)
    assert logs[:2] == logs[2:] and len(logs[0]) > 700
