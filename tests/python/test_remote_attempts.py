"""Attempts at the benchmark that clients fly on a real server."""

import json
import pathlib
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from served import Server

remote = pytest.importorskip("crazyflie_gym.remote", reason="the extra remote is not installed")

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("server"))
    yield server
    server.stop()


@pytest.fixture(scope="module")
def token(server):
    command = [
        sys.executable,
        "-m",
        "crazyflie_gym",
        "bench",
        "token",
        "create",
        "team-a",
        "--json",
        "--data",
        server.data,
    ]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)["token"]


def fly_attempt(client, attempt, act):
    """Fly all episodes of an attempt, and return the row that the server stored."""
    result = attempt
    while not result.get("over"):
        result = client.ask("step", action=act(np.array(result["observation"], np.float32)).tolist())
        assert set(result["reward"]) == {0.0} and "state" not in result
    return client.ask("finish")["attempt"]


def test_an_attempt_at_the_benchmark(server, token):
    client = remote.Client(server.url, token)
    attempt = client.ask("benchmark", scenario="wind", controller="pid", token=token)
    count = attempt["num_envs"]
    assert np.array(attempt["observation"]).shape == (count, 24) and count >= 20
    assert attempt["scenario"].startswith("wind@")
    with pytest.raises(ValueError, match="expected a number from -1 to 1"):
        client.ask("step", action=[[2, 2, 2, 2]] * count)
    with pytest.raises(ValueError, match="expected"):
        client.ask("step", action=[[0, 0, 0, 0]])
    with pytest.raises(ValueError, match="action: Out of range"):
        client.ask("step", action=[[float("nan")] * 4] * count)
    pid = crazyflie_gym.Pid(count, crazyflie_gym.Interface(tick_s=attempt["tick_s"], **attempt["interface"]))
    row = fly_attempt(client, attempt, pid.act)
    assert row["id"] == attempt["attempt"] and row["status"] == "finished" and row["team"] == "team-a"
    score = row["result"]["score"]
    assert score["episodes"] == count and score["failed"] == 0 and 10.0 < score["score"] <= 100.0
    assert score["low"] <= score["score"] <= score["high"]


def test_an_attempt_of_drones_that_share_the_air(server, token):
    client = remote.Client(server.url, token)
    attempt = client.ask("benchmark", scenario="land-in-turn", controller="pids", token=token)
    assert (attempt["drones"], np.array(attempt["observation"]).shape) == (4, (24 * 4, 24 + 3 * 8))
    interface = crazyflie_gym.Interface(tick_s=attempt["tick_s"], **attempt["interface"])
    pid = crazyflie_gym.Pid(attempt["num_envs"], interface)
    row = fly_attempt(client, attempt, lambda seen: pid.act(np.ascontiguousarray(seen[:, :24])))
    score, metrics = row["result"]["score"], row["result"]["metrics"]
    assert score["episodes"] == 24 and score["failed"] == 0 and 10.0 < score["score"] <= 100.0
    assert metrics["collisions"] == 0 and metrics["min_separation_m"] > 0.3


def test_an_attempt_that_is_refused_or_left(server, token):
    client = remote.Client(server.url)
    for fields, words in (
        ({"scenario": "calm", "controller": "x", "token": token}, "unknown scenario"),
        ({"scenario": "wind", "controller": "x", "token": "cft_0"}, "token"),
        ({"scenario": "wind", "controller": "x" * 65, "token": token}, "1 to 64 letters"),
    ):
        with pytest.raises(ValueError, match=words):
            client.ask("benchmark", **fields)
    attempt = client.ask("benchmark", scenario="wind", controller="early", token=token, new_entry=True)
    client.ask("step", action=[[0, 0, 0, 0]] * attempt["num_envs"])
    with pytest.raises(RuntimeError, match="still under way"):
        client.ask("finish")
    with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/api/v1/attempts/{attempt['attempt']}") as page:
        assert json.load(page)["status"] == "abandoned"


def test_the_example(server, token):
    command = [sys.executable, str(EXAMPLES / "submit_own.py"), server.url, "hover-aruco", token]
    words = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert words.startswith("hover-aruco@") and float(words.split()[-1]) > 10.0, words


def test_an_entry_is_replaced_by_who_asks_for_it(server, tmp_path):
    def bench(*words):
        command = [sys.executable, "-m", "crazyflie_gym", "bench", *words]
        return subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)

    token = tmp_path / "token.txt"
    token.write_text(bench("token", "create", "team-b", "--data", server.data).stdout)
    there = ("--scenario", "hover-aruco", "--server", server.url, "--token-file", str(token))
    assert bench("submit", "--controller", "lqr", *there).returncode == 0
    # the line that the page offers
    refused = bench("submit", "--controller", "thesis-pid", *there)
    assert refused.returncode == 1 and "--new-entry" in refused.stderr and '"lqr"' in refused.stderr, refused
    assert bench("submit", "--controller", "thesis-pid", "--new-entry", *there).returncode == 0
    # and back, with what it had
    client = remote.Client(server.url, token.read_text().strip())
    asked = {"scenario": "hover-aruco", "controller": "lqr", "token": token.read_text().strip()}
    with pytest.raises(RuntimeError, match="thesis-pid"):
        client.ask("benchmark", **asked)
    client.ask("benchmark", **asked, new_entry=True)
    client.close()


def test_a_server_prints_the_command_that_makes_a_token_for_it(tmp_path):
    server = Server(tmp_path)
    line = server.process.stdout.readline()
    command = line.partition("crazyflie ")[2].replace("TEAM", "team-c").split()
    made = subprocess.run([sys.executable, "-m", "crazyflie_gym", *command], capture_output=True, text=True, check=True)
    client = remote.Client(server.url, made.stdout.strip())
    client.ask("benchmark", scenario="wind", controller="mine", token=made.stdout.strip())
    client.close()
    server.stop()
