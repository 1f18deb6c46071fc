"""A mission of one's own at every door, and rewards over the other drones."""

import json
import pathlib
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from crazyflie_gym.swarm import METRICS, CrazyflieSwarm
from served import Server

EXAMPLE = pathlib.Path(__file__).parents[2] / "examples/tasks/station.toml"
COLLISIONS, ERROR = METRICS.index("collisions"), METRICS.index("rms_error_m")


@pytest.fixture(scope="module")
def station():
    return crazyflie_gym.register_task(EXAMPLE)


def flown(envs, steps=500):
    """The metrics of worlds that the thesis's PID has flown, and their last true places."""
    pid = envs.controller("thesis-pid")
    envs.reset(seed=1)
    for _ in range(steps):
        info = envs.step(envs.act(pid))[4]
    return info["metrics"]


def test_a_task_file_is_an_id_of_worlds(station):
    assert station == "crazyflie/station-v0"
    envs = gymnasium.make_vec(station, 2)
    swarm = CrazyflieSwarm(2, station)
    assert envs.unwrapped.sim.num_drones == swarm.num_drones == 3
    np.testing.assert_array_equal(envs.reset(seed=3)[0], swarm.reset(seed=3)[0])
    metrics = flown(swarm)
    assert (metrics[:, COLLISIONS] == 0).all() and (metrics[:, ERROR] < 0.5).all(), metrics
    first, _, third = np.moveaxis(swarm.states()[..., :3], 1, 0)
    assert (np.linalg.norm(first - third - [0.6, 0, -0.2], axis=1) < 0.35).all()
    # options beside the id override those of the file
    assert CrazyflieSwarm(1, station, max_episode_steps=5).sim.num_drones == 3


def test_agents_and_a_single_world_fly_it(station):
    parallel = pytest.importorskip("crazyflie_gym.parallel")
    team, world = parallel.parallel_env(station), gymnasium.make(station)
    rows, _ = team.reset(seed=3)
    np.testing.assert_array_equal(np.stack(list(rows.values())), world.reset(seed=3)[0])
    actions = {agent: np.zeros(4, np.float32) for agent in team.agents}
    rewards = team.step(actions)[1]
    assert np.mean(list(rewards.values())) == pytest.approx(world.step(np.zeros((3, 4), np.float32))[1])


def test_a_server_flies_the_same_bits(station, tmp_path):
    pytest.importorskip("crazyflie_gym.remote")
    server = Server(tmp_path)
    try:
        here, there = CrazyflieSwarm(2, station), CrazyflieSwarm(2, station, remote=server.url)
        np.testing.assert_array_equal(here.reset(seed=5)[0], there.reset(seed=5)[0])
        for action in np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2, 3, 4)).astype(np.float32):
            for local, remote in zip(here.step(action)[:4], there.step(action)[:4], strict=True):
                np.testing.assert_array_equal(local, remote)
        there.close()
        client = crazyflie_gym.remote.Client(server.url)
        roles = {"drones": 2, "task_options": {"roles": [{"track": {}}, {"beside": 0, "offset_m": [0, 1, 0]}]}}
        assert client.ask("world", name="own", mission="own", options=roles)["drones"] == 2
        client.close()
    finally:
        server.stop()


def test_the_program_flies_it():
    command = [sys.executable, "-m", "crazyflie_gym", "fly", "--task", EXAMPLE, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)


def test_functions_read_the_other_drones():
    kept = {}

    def reward(nearest_m, min_separation_m, others_mean_m, load_pos_m, pos_m):
        kept.update(locals())
        return nearest_m - np.abs(load_pos_m[..., 2] - 0.5)

    swarm = CrazyflieSwarm(4, "carry", reward=reward, cost="norm(others_mean_m)")
    swarm.reset(seed=0)
    for _ in range(10):
        _, rewards, _, _, info = swarm.step(np.zeros((4, 3, 4), np.float32))
    pos_m = swarm.states()[..., :3]
    others = np.stack([pos_m[:, [j for j in range(3) if j != i]].mean(axis=1) for i in range(3)], axis=1)
    gaps = np.linalg.norm(pos_m[:, :, None] - pos_m[:, None], axis=-1) + 10 * np.eye(3)
    np.testing.assert_allclose(kept["others_mean_m"], others, atol=1e-6)
    np.testing.assert_allclose(kept["nearest_m"], gaps.min(axis=2), atol=1e-6)
    np.testing.assert_allclose(kept["load_pos_m"][:, 0], swarm.loads(), atol=1e-6)
    np.testing.assert_allclose(info["cost"], np.linalg.norm(others, axis=-1), atol=1e-5)
    np.testing.assert_array_equal(kept["min_separation_m"][:, 0], info["metrics"][:, METRICS.index("min_separation_m")])
    assert rewards.shape == (4, 3)
    with pytest.raises(ValueError, match="nearest_m needs other drones, and one flies in this task hover"):
        gymnasium.make("Crazyflie-v0", reward="nearest_m")
    with pytest.raises(ValueError, match=r"roles\[0\]: expected one of track, race and beside"):
        CrazyflieSwarm(1, "own", drones=1, task_options={"roles": [{}]})
