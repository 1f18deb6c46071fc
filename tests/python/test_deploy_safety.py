"""What `crazyflie deploy` does when things go wrong, or somebody wants to land."""

import itertools
import json
import os
import pty
import subprocess
import sys

import pytest

from common import LIMIT_S, wait
from deployments import GOAL, OWN, POSES, THERE, FlightOutcome, free_port, simulated

pytest_plugins = ["deployments"]


@pytest.mark.parametrize("how, presses", [("key", 1), ("signal", 2)])
def test_a_key_lands_and_a_second_one_stops(tmp_path, how, presses):
    parent, child = pty.openpty()
    press = {"key": f"os.write({parent}, b' ')", "signal": "os.kill(os.getpid(), signal.SIGINT)"}[how]
    port = free_port()
    # pressed where the vehicle is known tick by tick
    (tmp_path / "press.py").write_text(
        POSES.format(port=port)
        + f"""
def poses():
    presses = 0
    for message, has_flown in since_high(5):
        if has_flown and (presses == 0 or presses < {presses} and message["pos_m"][2] < 0.42):
            {press}
            presses += 1
        yield message
"""
    )
    with simulated(tmp_path, "--position", "none", "--poses", f"127.0.0.1:{port}") as vehicle:
        options = ["--position", "mocap", "--poses", f"python:{tmp_path / 'press.py'}:poses"]
        # longer than any machine takes to notice the key
        process = vehicle.start(*options, "--duration", 3000, "--time-limit", 3600, stdin=child, pass_fds=[parent])
        summary = vehicle.outcome(process).ended("key", 0, landed=presses == 1)
        assert ("stopped" in summary) is (presses == 2)
        assert vehicle.truth.place[2] < 0.05
        heights = [z_m for *_, z_m in vehicle.truth.seen]
    steepest_mps = max(a - b for a, b in itertools.pairwise(heights)) * 100
    assert (steepest_mps > 1.0) is (presses == 2), "who stops the motors falls"
    os.close(parent), os.close(child)


@pytest.mark.parametrize(
    "reason, options, simulator",
    [
        ("room", ["--room", "0.2,1,1.5", *THERE], []),
        ("room", ["--room", "0.6,0.6,1.5", *THERE, "--controller", "python:own.py:Backwards"], []),
        ("tilt", ["--tilt-max", 2, *THERE], []),
        ("time", ["--time-limit", 3.0, "--duration", 30], []),
        ("battery", ["--battery-min", 3.66, "--duration", 60],
         ["--effects", '{"battery_sag": {"exponent": 0, "charge": 0.3, "resistance_ohm": 0.1}}']),
    ],
)  # fmt: skip
def test_soft_limits_land(tmp_path, reason, options, simulator):
    (tmp_path / "own.py").write_text(OWN)
    with simulated(tmp_path, *simulator) as vehicle:
        vehicle.fly(*options).ended(reason, 1)
        x, _, z = vehicle.truth.place
        # under load the voltage is low from the start
        assert vehicle.truth.highest() > (0.1 if reason == "battery" else 0.4) and z < 0.05
        if "0.2,1,1.5" in options:
            assert 0.15 < x < 0.5
        elif reason == "room":
            assert max(abs(number) for row in vehicle.truth.seen for number in row[1:3]) > 0.55, "it flew away"


@pytest.mark.parametrize("name, told", [("Wrong", "lost my way"), ("NotANumber", "nan")])
def test_a_controller_that_fails_is_landed(vehicle, tmp_path, name, told):
    (tmp_path / "own.py").write_text(OWN)
    flown = vehicle.fly("--controller", f"python:{tmp_path / 'own.py'}:{name}", *THERE)
    summary = flown.ended("controller", 1)
    assert told in flown.told and told in summary["detail"]
    assert ("raise RuntimeError" in flown.told) is (name == "Wrong"), "the traceback leads into the file"
    assert vehicle.truth.nearest((*GOAL[:2], 0.02)) < 0.3 and vehicle.truth.place[2] < 0.05


def test_a_vehicle_that_is_gone_ends_the_flight_with_an_error(vehicle):
    process = vehicle.start("--duration", 3000, "--time-limit", 3600)
    vehicle.wait_high(4)
    vehicle.process.kill()
    vehicle.process.wait()
    FlightOutcome(process).ended("stale", 1, landed=False)
    rows = vehicle.rows()
    assert len(rows) > 200 and rows[-1]["marker_z_m"] > 0.3
    beside = json.loads(vehicle.log.with_name("flight.csv.json").read_text())
    assert beside["settings"]["uri"] == vehicle.uri and beside["summary"]["reason"] == "stale"


def test_a_terminal_that_is_gone_is_no_reason_to_fall(vehicle):
    process = vehicle.start("--duration", 2)
    process.stderr.close()
    wait(lambda: process.poll() is not None)
    summary = json.loads(process.stdout.read())
    assert summary["reason"] == "done" and summary["landed"]
    vehicle.truth.until(summary["states"]["end"])
    assert vehicle.truth.highest() > 0.4 and vehicle.truth.place[2] < 0.05


def test_losses_and_latency_are_flown_through(tmp_path):
    with simulated(tmp_path, "--loss", 0.1, "--latency", 0.01, "--seed", 4) as vehicle:
        summary = vehicle.fly(*THERE, "--controller", "lqr").ended("done", 0)
        assert vehicle.truth.nearest(GOAL) < 0.1 and vehicle.truth.place[2] < 0.05
        assert summary["rows"] < 0.95 * 100 * (summary["states"]["end"] - summary["states"]["take-off"])


def test_nobody_at_the_address_is_an_error(tmp_path):
    command = [sys.executable, "-m", "crazyflie_gym", "deploy", "--uri", "udp://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=LIMIT_S)
    assert done.returncode == 1 and "udp://127.0.0.1:9" in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.glob("deploy-*"))


def test_a_vehicle_that_is_not_fit_stays_on_the_ground(tmp_path):
    with simulated(tmp_path) as vehicle:
        flown = vehicle.fly("--battery-min", 4.5)
        assert flown.code == 1 and "check: the battery is at 4.20 V" in flown.told
        assert vehicle.truth.highest() < 0.01
