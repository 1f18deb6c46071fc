"""Worlds that several clients share, in Python and beside a client in another language."""

import json
import os
import pathlib
import shlex
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

from common import LIMIT_S
from crazyflie_gym._native import Sim

remote = pytest.importorskip("crazyflie_gym.remote", reason="the extra remote is not installed")

# the program: the one that is named, or the one in the package
CRAZYFLIE = shlex.split(os.environ.get("CRAZYFLIE", "")) or [sys.executable, "-m", "crazyflie_gym"]
EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    data = tmp_path_factory.mktemp("shared") / "bench.sqlite"
    command = [*CRAZYFLIE, "serve", "--listen", "127.0.0.1:0", "--log", "warn", "--data", str(data)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    assert line.startswith("listening on "), line
    yield f"ws://{line.split()[-1]}"
    process.terminate()
    assert process.wait(LIMIT_S) == 0


def get(url, path):
    with urllib.request.urlopen(url.replace("ws", "http", 1) + path) as answer:
        return answer.read()


def world(url, name):
    return next(row for row in json.loads(get(url, "/api/v1/worlds")) if row["world"] == name)


def test_a_pilot_gets_the_bits_of_the_library(url):
    options = {"drones": 1, "max_episode_steps": 60, "effects": {"camera_noise": 0.01}}
    pilot = remote.Client(url)
    info = pilot.ask("world", name="bits", mission="formation", seed=5, options=options)
    local = Sim(1, json.dumps({"task": "formation", "autoreset": "disabled", **options}))
    assert info["width"] == local.width == 24
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (60, 4)).astype(np.float32)
    actions[:, 3] = 0.0
    seen = pilot.ask("join", name="bits")
    rows = local.reset(np.array([5], np.uint64))
    assert np.float32(seen["observation"]).tobytes() == rows.tobytes()
    for tick, action in enumerate(actions):
        seen = pilot.ask("fly", action=action.tolist())
        rows, rewards, ended, cut, *_ = local.step(action.reshape(1, 1, 4))
        assert np.float32(seen["observation"]).tobytes() == rows.tobytes(), tick
        assert np.float32(seen["reward"]) == rewards.item()
        assert (seen["terminated"], seen["truncated"]) == (ended.item(), cut.item())
        if not seen["flying"]:
            break
    assert seen["tick"] == tick + 1 >= 40
    with pytest.raises(RuntimeError, match="over"):
        pilot.ask("fly", action=[0, 0, 0, 0])
    print(f"{seen['tick']} ticks, the same bits")


def test_mistakes(url):
    pilot, second = remote.Client(url), remote.Client(url)
    with pytest.raises(ValueError, match="no world"):
        pilot.ask("join", name="nowhere")
    with pytest.raises(ValueError, match="swop"):
        pilot.ask("world", name="x", mission="swop")
    pilot.ask("world", name="mistakes", mission="swap", options={"drones": 2})
    with pytest.raises(RuntimeError, match="already"):
        pilot.ask("world", name="mistakes", mission="swap")
    seat = pilot.ask("join", name="mistakes", drone=1)
    with pytest.raises(RuntimeError, match="has a pilot"):
        second.ask("join", name="mistakes", drone=1)
    with pytest.raises(ValueError, match="expected 4 numbers"):
        pilot.ask("fly", action=[0, 0, 0])
    assert len(pilot.ask("fly", action=[0, 0, 0, 0])["observation"]) == 32
    # a second connection of the same pilot takes the seat over
    second.ask("join", name="mistakes", drone=1, token=seat["token"])
    second.ask("fly", action=[0, 0, 0, 0])
    with pytest.raises(RuntimeError, match="taken over"):
        pilot.ask("fly", action=[0, 0, 0, 0])
    pilot.close(), second.close()


def test_three_programs_of_the_page_carry_a_load(url):
    page = (EXAMPLES.parent / "docs/swarm.md").read_text()
    block = page.split('three programs side by side"\n')[1].split("```")[0]
    serve, *lines = [line.rstrip(" &") for line in block.splitlines()]
    assert serve == "crazyflie serve" and len(lines) == 3 and all(line.startswith("crazyflie ") for line in lines)
    commands = [[*CRAZYFLIE, *shlex.split(line)[1:], "--server", url, "--json"] for line in lines]
    programs = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for command in commands]
    said = [json.loads(program.communicate(timeout=LIMIT_S)[0]) for program in programs]
    assert [program.returncode for program in programs] == [0, 0, 0]
    assert sorted(pilot["drone"] for pilot in said) == [0, 1, 2] and {pilot["ticks"] for pilot in said} == {1000}
    row = world(url, "load")
    print(row["metrics"], said)
    assert row["over"] and row["metrics"]["collisions"] == row["metrics"]["crashes"] == 0
    # the load's distance from its way
    assert row["metrics"]["rms_error_m"] < 0.3


def test_two_processes_in_two_languages_swap_places(url, tmp_path):
    here = subprocess.Popen(
        [sys.executable, EXAMPLES / "swap_places.py", url, "places"], stdout=subprocess.PIPE, text=True
    )
    assert "waits" in here.stdout.readline()
    command = [
        *CRAZYFLIE,
        "world",
        "join",
        "--server",
        url,
        "--world",
        "places",
        "--drone",
        "1",
        "--collision-avoidance",
    ]
    there = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    output = here.communicate(timeout=LIMIT_S)[0]
    print(output, there.stdout, there.stderr)
    assert (here.returncode, there.returncode) == (0, 0)
    row = world(url, "places")
    print(row["metrics"])
    assert row["over"] and row["metrics"]["collisions"] == 0 and row["metrics"]["crashes"] == 0
    # both are where the other one began
    assert row["metrics"]["done"] == 2 and row["metrics"]["min_separation_m"] > 0.14
    log = tmp_path / "log.jsonl"
    log.write_bytes(get(url, "/api/v1/worlds/places/log"))
    again = subprocess.run(
        [*CRAZYFLIE, "world", "replay", str(log), "--json"], capture_output=True, text=True, timeout=LIMIT_S
    )
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["flown"]["sha256"] == row["sha256"]
