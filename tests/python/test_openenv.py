"""The server speaks to the stock `openenv-core` client, unchanged."""

import numpy as np
import pytest

import crazyflie_gym
from crazyflie_gym import _native
from served import Server

openenv = pytest.importorskip("openenv.core", reason="openenv-core is not installed")

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
