"""Bags and MCAP files written by other programs read as the flight that they were made of."""

import csv
import json
import subprocess
import sys

import pytest

pytest.importorskip("rosbags", reason="needs the package rosbags")
pytest.importorskip("mcap", reason="needs the package mcap")

import recordings
from common import LIMIT_S

FLIGHT = ["--task", "fly-80cm", "--seconds", "25", "--sensors", "lab"]


def crazyflie(*args):
    done = subprocess.run(
        [sys.executable, "-m", "crazyflie_gym", *map(str, args)],
        capture_output=True,
        text=True,
        timeout=2 * LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A CSV of the lab's rig: a 30 Hz camera, 50 ms late, and noise."""
    path = tmp_path_factory.mktemp("flight") / "flight.csv"
    crazyflie("fly", *FLIGHT, "--csv", path)
    return path


@pytest.fixture(scope="module")
def blind(flight):
    """The same without the simulator's truth, which no recording holds either."""
    rows = [{name: cell for name, cell in row.items() if "true_" not in name} for row in recordings.rows(flight)]
    path = flight.with_name("blind.csv")
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def replayed(path):
    log = json.loads(crazyflie("replay", path, "--horizon", "2", "--json"))["logs"][0]
    return log["runs"][0]["signals"], log["notes"]


WRITERS = {
    "flight.bag": lambda rows, path: recordings.write_bag(rows, path),
    "lz4.bag": lambda rows, path: recordings.write_bag(rows, path, "LZ4"),
    "bz2.bag": lambda rows, path: recordings.write_bag(rows, path, "BZ2"),
    "ros1.mcap": lambda rows, path: recordings.write_mcap(rows, path, "ros1"),
    "ros2.mcap": lambda rows, path: recordings.write_mcap(rows, path, "cdr"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_messages_of_the_rig_replay_as_the_flight_does(flight, blind, tmp_path, name):
    path = tmp_path / name
    WRITERS[name](recordings.rows(flight), path)
    expected, _ = replayed(blind)
    found, notes = replayed(path)
    # degrees, metres per second, metres; attitude is integrated from the gyro here and measured there
    limits = {"roll": 0.1, "pitch": 0.1, "yaw": 0.1, "z": 0.002, "vx": 0.01, "vy": 0.01, "x": 0.01, "y": 0.01}
    for signal, limit in limits.items():
        assert abs(found[signal]["rmse"] - expected[signal]["rmse"]) < limit, (signal, found[signal], expected[signal])
    assert any("stamps on the recorder's clock" in note and "imu" in note for note in notes), notes
    assert not any("reading ended" in note or "lost" in note for note in notes), notes


def test_rows_of_another_program_read_to_the_same_bits(flight, tmp_path):
    path = tmp_path / "rows.mcap"
    recordings.write_rows(recordings.rows(flight), path)
    assert replayed(path) == replayed(flight)


def test_what_fly_writes_as_mcap_other_programs_read(flight, tmp_path):
    from mcap.reader import make_reader

    path = tmp_path / "flight.mcap"
    crazyflie("fly", *FLIGHT, "--csv", path)
    with open(path, "rb") as file:
        read = [(schema, message) for schema, _, message in make_reader(file, validate_crcs=True).iter_messages()]
    assert {schema.encoding for schema, _ in read} == {"jsonschema"}
    assert [json.loads(message.data) for _, message in read] == recordings.rows(flight)
    required = json.loads(read[0][0].data)["required"]
    assert "t_s" in required and "marker_x_m" not in required
    assert replayed(path) == replayed(flight)
