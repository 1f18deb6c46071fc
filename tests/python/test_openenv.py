"""The server speaks to the stock client of `openenv`, unchanged, and its validator finds nothing wrong."""

import json
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from crazyflie_gym import _native
from served import Server

openenv = pytest.importorskip("openenv.core", reason="openenv is not installed")

PACKAGE = Path(__file__).parents[2] / "examples/openenv"
ACTIONS = np.random.default_rng(5).uniform(-1, 1, (40, 4)).astype(np.float32)
FIELDS = [
    "marker_pos_m",
    "marker_yaw_rad",
    "marker_age_s",
    "marker_valid",
    "attitude_rad",
    "gyro_radps",
    "acc_mps2",
    "vbat_v",
    "setpoint",
    "last_action",
]


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    """A server of its own on a free port."""
    server = Server(tmp_path_factory.mktemp("server"))
    yield server.url
    server.stop()


@pytest.fixture
def client(url):
    with openenv.GenericEnvClient(base_url=url).sync() as client:
        yield client


def row(observation):
    return np.array([number for name in FIELDS for number in observation[name]], np.float32)


def test_a_flight_has_the_bits_of_the_library(client):
    sim = _native.Sim(1, '{"task": "hover", "autoreset": "disabled", "max_episode_steps": 500}')
    result = client.reset(seed=11)
    assert result.reward is None and result.done is False
    np.testing.assert_array_equal(row(result.observation), sim.reset(np.array([11], np.uint64))[0])
    for action in ACTIONS:
        result = client.step({"action": action.tolist()})
        observation, reward, terminated, truncated, _ = sim.step_one(action)
        np.testing.assert_array_equal(row(result.observation), observation)
        assert (np.float32(result.reward), result.done) == (np.float32(reward), terminated or truncated)
        if result.done:
            break
    state = client.state()
    np.testing.assert_array_equal(np.array(state["true_state"], np.float32), sim.states()[0])
    assert state["step_count"] > 0


def test_the_env_and_its_options_are_chosen_with_reset(client):
    for task in crazyflie_gym.tasks():
        if task["drones"] > 1:
            with pytest.raises(
                RuntimeError, match=f"flies one drone, and the task {task['name']} has {task['drones']}"
            ):
                client.reset(env=task["id"])
            continue
        result = client.reset(seed=1, env=task["id"], options={"max_episode_steps": 2}, episode_id="mine")
        assert result.done is False
        results = [client.step({"action": [0.0, 0.0, 0.0, 0.1]}) for _ in range(2)]
        assert results[-1].done
        assert client.state()["episode_id"] == "mine"


@pytest.mark.parametrize(
    ("call", "code"),
    [
        (lambda client: client.step({"action": [0, 0, 0, 0]}), "EXECUTION_ERROR"),
        (lambda client: client.step({"action": [0, 0, 0]}), "VALIDATION_ERROR"),
        (lambda client: client.step({"thrust": 1}), "VALIDATION_ERROR"),
        (lambda client: client.reset(env="Nothing-v0"), "VALIDATION_ERROR"),
        (lambda client: client.state(), "EXECUTION_ERROR"),
    ],
)
def test_mistakes_raise_with_the_codes_of_openenv_and_the_session_lives(client, call, code):
    with pytest.raises(RuntimeError, match=code):
        call(client)
    assert client.reset(seed=1).done is False


def test_the_typed_client_has_the_bits_of_the_library(url):
    from crazyflie_gym.openenv import CrazyflieAction, CrazyflieEnv

    def history(result):
        return np.concatenate([result.observation.fields[name] for name in FIELDS], axis=1).astype(np.float32).ravel()

    options = {"max_episode_steps": 20, "history": 3, "observation": "measured"}
    sim = _native.Sim(1, json.dumps({"task": "takeoff", "autoreset": "disabled", **options}))
    with CrazyflieEnv(base_url=url).sync() as env:
        result = env.reset(seed=3, env="CrazyflieTakeoff-v0", options=options)
        np.testing.assert_array_equal(history(result), sim.reset(np.array([3], np.uint64))[0])
        steps = 0
        for action in ACTIONS:
            steps += 1
            result = env.step(CrazyflieAction(action=action.tolist()))
            row, reward, terminated, truncated, _ = sim.step_one(action)
            np.testing.assert_array_equal(history(result), row)
            seen = result.observation
            assert (np.float32(result.reward), seen.terminated, seen.truncated) == (
                np.float32(reward),
                terminated,
                truncated,
            )
            assert result.done == seen.done == (terminated or truncated)
            if result.done:
                break
        state = env.state()
        assert state.step_count == steps
        np.testing.assert_array_equal(np.array(state.true_state, np.float32), sim.states()[0])
    for wrong in ([0.0] * 3, [0.0] * 5, ["up"] * 4):
        with pytest.raises(ValueError, match="action"):
            CrazyflieAction(action=wrong)


def test_the_package_is_valid():
    command = [sys.executable, "-m", "openenv.cli", "validate", str(PACKAGE), "--level", "static", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert report["verdict"] == "pass" and [each["status"] for each in report["results"]] == ["pass"]


class HereProvider:
    """Starts the server on this machine, not in a container: there is no Docker here."""

    name = "here"
    supported_network_modes = frozenset({"no-network"})

    def __init__(self, folder):
        from openenv.validation.types import ProviderCapability

        self.capabilities = frozenset({ProviderCapability.IMAGE_BUILD})
        self.folder = folder

    def build(self, root, execution):
        assert (root / execution.dockerfile).is_file()
        return "sha256:" + "0" * 64

    def start(self, spec):
        self.server = Server(self.folder)
        self.base_url = self.server.url.replace("ws", "http")
        with urllib.request.urlopen(f"{self.base_url}/health", timeout=LIMIT_S) as answer:
            assert json.load(answer) == {"status": "healthy"}
        return self

    def inspect(self):
        return {}

    def stop(self):
        self.server.stop()


def test_the_validator_flies_the_server(tmp_path):
    from openenv.validation import Level, run_validation

    report = run_validation(PACKAGE, max_level=Level.RUNTIME, provider=HereProvider(tmp_path))
    by_status = {}
    for result in report.results:
        by_status.setdefault(result.status.value, {})[result.check_id] = result.evidence
    checked = {"static.manifest", "runtime.startup", *(f"runtime.{name}" for name in CHECKS)}
    assert set(by_status) == {"pass", "skip"} and set(by_status["pass"]) == checked, by_status


CHECKS = ["reward_well_formed", "observation_schema", "state_contract"]


def test_what_is_said_of_the_environment(url):
    def told(path):
        with urllib.request.urlopen(f"{url.replace('ws', 'http')}/{path}", timeout=LIMIT_S) as answer:
            return json.load(answer)

    assert told("metadata")["name"] == "crazyflie"
    schema = told("schema")
    assert sorted(schema["observation"]["properties"]) == sorted([*FIELDS, "terminated", "truncated", "done", "reward"])
    assert schema["action"]["properties"]["action"]["minItems"] == 4
