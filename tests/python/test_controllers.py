"""Controllers of the registry: all of them fly, alone as in a batch, and mistakes are named."""

import json
import warnings

import numpy as np
import pytest

import crazyflie_gym
from crazyflie_gym import Controller, CrazyflieEnv, CrazyflieSwarm, CrazyflieVectorEnv

BUILT_IN = [c["name"] for c in crazyflie_gym.controllers() if c["file"] is None]
EFFECTS = {"camera": 1, "camera_latency": 0.05, "camera_noise": {"xy_m": 0.005, "z_m": 0.01, "yaw_deg": 1}}


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_batch_is_flown_as_each_alone(name):
    envs = CrazyflieVectorEnv(20, effects=EFFECTS, vertical="pwm")
    one = CrazyflieEnv(effects=EFFECTS, vertical="pwm")
    place = 0 if name == "random" else 17  # dice are thrown by the place in the batch
    envs.reset(seed=5)
    one.reset(seed=5 + place)
    many, single = envs.controller(name), one.controller(name)
    for _ in range(100):
        actions, action = envs.act(many), one.act(single)
        np.testing.assert_array_equal(actions[place], action)
        rows = envs.step(actions)[0]
        row, _, terminated, truncated, _ = one.step(action)
        if terminated or truncated:  # random flights are short
            return
    np.testing.assert_array_equal(rows[place], row)


def unlike(observation):
    """Environments that see the same flights and observe something else."""
    return {"effects": EFFECTS, "vertical": "pwm", "observation": observation}


@pytest.mark.parametrize("observation", ["state", "estimate", ["error_m"]])
@pytest.mark.parametrize("name", ["thesis-pid", "kalman+thesis-pid"])
def test_an_environment_flies_a_controller_whatever_it_observes(name, observation):
    envs, measured = (CrazyflieVectorEnv(20, **unlike(seen)) for seen in (observation, "measured"))
    one = CrazyflieEnv(**unlike(observation))
    pilots = [batch.controller(name) for batch in (envs, measured, one)]
    envs.reset(seed=5)
    one.reset(seed=5 + 17)
    rows, _ = measured.reset(seed=5)
    for _ in range(30):
        actions, wanted, action = envs.act(pilots[0]), pilots[1].act(rows), one.act(pilots[2])
        np.testing.assert_array_equal(actions, wanted)
        np.testing.assert_array_equal(action, wanted[17])
        envs.step(actions)
        one.step(action)
        rows, *_ = measured.step(wanted)


def test_a_world_flies_a_crowd_whatever_its_drones_observe():
    crew = ["lqr", "thesis-pid", "velocity"]
    options = {"drones": 3, "vertical": "pwm"}
    measured = CrazyflieSwarm(1, "formation", observation="measured", **options)
    swarm = CrazyflieSwarm(1, "formation", **options)
    env = CrazyflieEnv("formation", **options)
    batch = CrazyflieVectorEnv(1, "formation", **options)
    pilots = [world.controller(crew, avoid=True) for world in (measured, swarm, env, batch)]
    rows, _ = measured.reset(seed=4)
    for world in (swarm, env, batch):
        world.reset(seed=4)
    for _ in range(30):
        wanted = pilots[0].act(rows)
        np.testing.assert_array_equal(swarm.act(pilots[1]), wanted)
        np.testing.assert_array_equal(env.act(pilots[2]), wanted[0])
        np.testing.assert_array_equal(batch.act(pilots[3]), wanted)
        rows, *_ = measured.step(wanted)
        swarm.step(wanted)
        env.step(wanted[0])
        batch.step(wanted)


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_agents_fly_a_crowd_whatever_they_observe(form):
    parallel_env = pytest.importorskip("crazyflie_gym.parallel").parallel_env
    env, measured = (
        parallel_env("swap", drones=3, form=form),
        CrazyflieSwarm(1, "swap", drones=3, observation="measured"),
    )
    team, crowd = env.controller("lqr"), measured.controller("lqr")
    observations, _ = env.reset(seed=2)
    rows, _ = measured.reset(seed=2)
    for _ in range(30):
        actions, wanted = team.act(observations), crowd.act(rows)[0]
        for agent, action in zip(env.possible_agents, wanted, strict=True):
            np.testing.assert_array_equal(actions[agent], action)
        observations, *_ = env.step(actions)
        rows, *_ = measured.step(wanted[None])
    with pytest.raises(KeyError, match="drone_9"):
        team.act({"drone_9": rows[0, 0]})


def test_rows_of_another_observation_are_refused_with_the_cure():
    cure = r"call `act\(controller\)` of the environment, or make it with observation=\"measured\""
    envs, worlds = CrazyflieVectorEnv(3), CrazyflieSwarm(2, "swap", drones=3)
    rows, several = envs.reset(seed=1)[0], worlds.reset(seed=1)[0]
    for refused in (envs.pid(), envs.controller("lqr")):
        with pytest.raises(ValueError, match=cure):
            refused.act(rows)
    with pytest.raises(ValueError, match=cure):
        worlds.controller().act(several)
    for fresh in (CrazyflieVectorEnv(3), CrazyflieEnv(), CrazyflieSwarm(2, "swap", drones=3)):
        with pytest.raises(RuntimeError, match=r"after the first reset\(\)"):
            fresh.act(fresh.controller())
    with pytest.raises(ValueError, match="made for another batch"):
        envs.act(CrazyflieVectorEnv(4).pid())
    with pytest.raises(TypeError, match="expected a Controller or a Crowd, got str"):
        envs.act("lqr")


def test_the_registry_is_the_command_lines():
    entries = {c["name"]: c for c in crazyflie_gym.controllers()}
    assert {"thesis-pid", "stock-pid", "hover", "random"} < set(entries)
    for entry in entries.values():
        assert entry["about"] and entry["source"]
        assert set(json.loads(entry["defaults"])) == set(entry["options"])


def test_a_pid_is_a_controller():
    env = CrazyflieEnv()
    assert isinstance(env.pid(), Controller)
    env.reset(seed=1)
    np.testing.assert_array_equal(env.act(env.pid()), env.act(env.controller("thesis")))


def test_mistakes_are_named():
    env = CrazyflieEnv()
    with pytest.raises(ValueError, match=r'unknown controller "random-pid"'):
        env.controller("random-pid")
    with pytest.raises(ValueError, match="controller random: options: unknown field `sed`"):
        env.controller("random", sed=1)
    with pytest.raises(ValueError, match="unknown controller mode"):
        env.controller(mode="hoover")
    with pytest.raises(ValueError, match=r"gone\.json"):
        env.controller("pid:gone.json")


def test_observations_of_double_precision_and_a_name_that_is_shown():
    envs = CrazyflieVectorEnv(3, observation="measured")
    rows, _ = envs.reset(seed=1)
    one, other = envs.controller("lqr"), envs.controller("lqr")
    np.testing.assert_array_equal(one.act(rows), other.act(rows.astype(np.float64)))
    assert repr(one) == 'Controller("lqr", num_envs=3)' and "attitude" in repr(envs.interface)


def test_a_controller_of_other_actions_warns():
    envs, other = CrazyflieVectorEnv(2, vertical="height"), CrazyflieVectorEnv(2, vertical="pwm")
    envs.reset(seed=0)
    pilot = other.controller("lqr")
    with pytest.warns(UserWarning, match=r"commands attitude with the vertical form pwm, and the .* form height"):
        envs.act(pilot)
    with pytest.warns(UserWarning, match="commands attitude with the vertical form pwm"):
        envs.rollout(pilot, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envs.act(envs.controller("lqr"))
