"""Several vehicles of `crazyflie cf2` fly one task by `crazyflie deploy`, in lock-step over real sockets."""

import csv
import itertools
import json
import math
import subprocess
import sys

import pytest

from common import LIMIT_S
from crazyflies import PROGRAM

SWAP = ("--task", "swap", "--controller", "velocity", "--duration", 10, "--room", "2,2,2")


LAYERS = {"with": (), "without": ("--no-collision-avoidance",)}


def flown(folder, *options, drones=3):
    """What three vehicles that fly together print, and their true places by time and drone."""
    folder.mkdir()
    words = ["cf2", "--json", "--port", 0, "--lockstep", "--drones", drones, "--poses", folder / "poses"]
    process = subprocess.Popen([PROGRAM, *map(str, words)], stdout=subprocess.PIPE, text=True)
    try:
        uris = [drone["udp"] for drone in json.loads(process.stdout.readline())["drones"]]
        words = ["deploy", "--lockstep", "--json", "--uri", *uris, "--log", folder / "flight.csv", *options]
        command = [sys.executable, "-m", "crazyflie_gym", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, stdin=subprocess.DEVNULL)
    finally:
        process.terminate()
        process.wait(timeout=LIMIT_S)
    places = {}
    for line in (folder / "poses").read_text().splitlines():
        pose = json.loads(line)
        places.setdefault(pose["t_s"], {})[pose["body"]] = pose["pos_m"]
    return done, list(places.values())


def nearest_m(places):
    """The least distance between two vehicles in the air."""
    pairs = (itertools.combinations(at.values(), 2) for at in places)
    return min(math.dist(a, b) for pair in pairs for a, b in pair if min(a[2], b[2]) > 0.2)


def test_vehicles_change_places_without_touching(tmp_path):
    done, places = flown(tmp_path / "a", *SWAP)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["ok"] and [each["reason"] for each in summary["vehicles"]] == ["done"] * 3
    assert nearest_m(places) > 0.2
    for number in (1, 2, 3):
        with open(tmp_path / "a" / f"flight-{number}.csv", newline="") as file:
            last = [row for row in csv.DictReader(file) if float(row["setpoint_z_m"]) > 0.5][-1]
        goal, place = ([float(last[f"{kind}_{axis}_m"]) for axis in "xyz"] for kind in ("setpoint", "marker"))
        assert math.dist(goal, place) < 0.15, (goal, place)
    # the same flight again, to the bit, whatever else this machine does
    _, again = flown(tmp_path / "b", *SWAP)
    start = next(i for i, at in enumerate(places) if max(place[2] for place in at.values()) > 0.1)
    same = next(i for i, at in enumerate(again) if max(place[2] for place in at.values()) > 0.1)
    assert places[start : start + 500] == again[same : same + 500]


def test_the_layer_keeps_them_apart(tmp_path):
    near_m = [nearest_m(flown(tmp_path / name, *SWAP, *options)[1]) for name, options in LAYERS.items()]
    assert near_m[0] > 0.3 and near_m[1] < 0.25, near_m


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--task", "hover"), "for one drone"),
        (("--task", "follow"), "waits for the drone"),
        (("--task", "swap", "--position", "mocap"), "expected 'estimate' for several vehicles"),
    ],
)
def test_tasks_that_they_cannot_fly_are_refused(tmp_path, options, words):
    done, _ = flown(tmp_path / "a", *options)
    assert done.returncode == 2 and words in done.stderr, done.stderr


def test_all_land_when_one_does(tmp_path):
    """The room ends where the third goes."""
    done, places = flown(tmp_path / "a", *SWAP[:-1], "0.9,0.9,2")
    assert done.returncode == 1, done.stderr
    summary = json.loads(done.stdout)
    reasons = [each["reason"] for each in summary["vehicles"]]
    assert "room" in reasons and "done" not in reasons, reasons
    assert all(place[2] < 0.1 for place in places[-1].values()), "they are on the ground"
