"""Several steps at once are the steps one after the other, to the bit."""

import importlib
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from common import FIVE, actions_for

STEPS = 30
# mass of the thesis's model
MASS_KG = 0.0368


def make(env_id, envs=21, **extra):
    extra = {"autoreset_mode": "next_step", "max_episode_steps": 13, "effects": FIVE} | extra
    batch = gym.make_vec(env_id, num_envs=envs, **extra).unwrapped
    batch.reset(seed=5)
    return batch


def drone_rewards(step):
    """The rewards of a step as a rollout keeps them."""
    return step[4].get("drone_rewards", step[1])


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_a_rollout_is_its_steps(env_id, mode):
    one, other = make(env_id, autoreset_mode=mode, history=2), make(env_id, autoreset_mode=mode, history=2, threads=2)
    actions = 0.3 * actions_for(one.action_space, STEPS)
    for _ in range(2):
        steps = [one.step(tick) for tick in actions]
        flown = other.rollout(actions, keep=["rewards", "terminated", "truncated", "observations"])
        assert np.array_equal(flown.observations, np.stack([step[0] for step in steps]))
        assert np.array_equal(flown.last_observation, steps[-1][0])
        rewards = np.stack([drone_rewards(step) for step in steps])
        assert np.array_equal(flown.rewards, rewards)
        over = flown.terminated | flown.truncated
        counts = np.cumsum(np.cumsum(over, 0), 0) <= 1
        assert np.allclose(flown.returns, (rewards * counts).sum(0), atol=1e-4)
    assert one.sim.get_state() == other.sim.get_state()
    assert np.array_equal(one.step(actions[0])[0], other.step(actions[0])[0])


def test_a_controller_flies_on_from_rollout_to_rollout(env_id):
    one, other = make(env_id, max_episode_steps=-1), make(env_id, max_episode_steps=-1, threads=2)
    pilot, crew = one.controller("thesis-pid"), other.controller("thesis-pid")
    for _ in range(2):
        rewards = []
        for _ in range(STEPS):
            actions = one.act(pilot)
            step = one.step(actions)
            rows = step[0]
            rewards.append(drone_rewards(step))
        flown = other.rollout(crew, STEPS)
        assert np.array_equal(flown.rewards, np.stack(rewards))
        assert np.array_equal(flown.last_observation, rows)
        assert np.array_equal(flown.last_actions, actions)


def test_a_controller_by_name_and_options(env_id):
    one, other = make(env_id), make(env_id)
    flown = one.rollout("kalman+thesis-pid", STEPS, options={"filter": {"xy_m": 0.01}}, keep=())
    assert flown.rewards is None and flown.terminated is None and flown.observations is None
    pilot = other.controller("kalman+thesis-pid", filter={"xy_m": 0.01})
    assert np.array_equal(flown.returns, other.rollout(pilot, STEPS).returns)


def test_the_caller_keeps_the_arrays():
    envs = make("Crazyflie-v0")
    actions = np.zeros((STEPS, 21, 4), np.float32)
    out = envs.rollout(actions)
    rewards, before = out.rewards, out.rewards.copy()
    assert envs.rollout(actions, out=out) is out
    assert out.rewards is rewards and not np.array_equal(before, rewards)
    with pytest.raises(ValueError, match=r"rewards: expected shape \(29, 21\), got \(30, 21\)"):
        envs.rollout(actions[1:], out=out)


def test_without_resets_what_has_ended_stands_still(env_id):
    envs = make(env_id, autoreset_mode="disabled")
    flown = envs.rollout(np.zeros((STEPS, *envs.action_space.shape), np.float32))
    assert (flown.terminated | flown.truncated).any(0).all()
    assert not flown.rewards[13:].any() and not (flown.terminated | flown.truncated)[13:].any()
    with pytest.raises(RuntimeError, match="ended"):
        envs.rollout(np.zeros((1, *envs.action_space.shape), np.float32))


def test_what_python_decides_in_every_step_is_refused():
    actions = np.zeros((STEPS, 21, 4), np.float32)

    class Still:
        def act(self, rows):
            return np.zeros((len(rows), 4), np.float32)

    envs = make("Crazyflie-v0")
    with pytest.raises(ValueError, match=r"in Python answers for the whole batch.*`step`"):
        envs.rollout(envs.controller(Still()), STEPS)
    with pytest.raises(TypeError):
        envs.rollout(Still(), STEPS)
    for own in ({"reward": lambda dist: -dist}, {"termination": lambda dist: dist > 1.0}):
        called = make("Crazyflie-v0", **own)
        before = called.sim.get_state()
        with pytest.raises(ValueError, match=f"{next(iter(own))}: a rollout.*expression"):
            called.rollout(actions)
        with pytest.raises(ValueError, match=r"a rollout.*expression"):
            called.rollout("thesis-pid", STEPS)
        assert called.sim.get_state() == before


def test_an_expression_that_gives_no_number_is_told_after_the_steps():
    envs, other = make("Crazyflie-v0", effects={}, reward="sqrt(0.0001 - dist**2)"), make("Crazyflie-v0", effects={})
    actions = np.zeros((STEPS, 21, 4), np.float32)
    with pytest.raises(ValueError, match=r"sqrt.*environment 0.*step 1 "):
        envs.rollout(actions)
    # the next controller reads the observations of the last step
    assert np.array_equal(envs._rows, other.rollout(actions).last_observation)
    with pytest.raises(ValueError, match="sqrt"):
        envs.rollout("thesis-pid", 3)


def test_mistakes_are_named():
    envs = make("Crazyflie-v0")
    actions = np.zeros((STEPS, 21, 4), np.float32)
    before = envs.sim.get_state()
    bad = actions.copy()
    bad[7, 3, 2] = np.nan
    for given, options, words in [
        (bad, {}, r"actions\[3\]\[2\] is NaN"),
        (actions[0], {}, r"expected shape \(ticks, 21, 4\)"),
        (actions[:0], {}, "at least one tick"),
        (actions, {"steps": 3}, "those of 30 steps, got 3"),
        (actions, {"keep": ["reward"]}, "keep: 'reward' is unknown"),
        (actions, {"options": {}}, "for a controller that is named"),
        ("thesis-pid", {}, "steps: expected"),
        ("thesis-pit", {"steps": 3}, "did you mean"),
        (make("Crazyflie-v0", envs=9).controller(), {"steps": 3}, "made for another batch"),
    ]:
        with pytest.raises(ValueError, match=words):
            envs.rollout(given, **options)
    assert envs.sim.get_state() == before
    with pytest.raises(RuntimeError, match="reset"):
        gym.make_vec("Crazyflie-v0", num_envs=21).unwrapped.rollout(actions)


@pytest.mark.parametrize("extra", [{"observation": "measured"}, {"observation": "estimate", "history": 2}])
def test_every_copy_flies_on_as_its_source(env_id, extra):
    source = gym.make(env_id, effects=FIVE, disable_env_checker=True, **extra).unwrapped
    source.reset(seed=3)
    before, after = np.split(0.3 * actions_for(source.action_space, 30), [11])
    for action in before:
        source.step(action)
    state = source.sim.get_state()
    same = {"autoreset_mode": "disabled", "max_episode_steps": -1} | extra
    copies, others = make(env_id, envs=35, threads=2, **same), make(env_id, envs=35, **same)
    copies.copy_state(source)
    others.copy_state(source, seeds=100)
    assert source.sim.get_state() == state
    for batch in (copies, others):
        assert np.array_equal(batch.sim.states(), np.repeat(source.sim.states(), 35, axis=0))
    actions = np.repeat(after[:, np.newaxis], 35, axis=1)
    flown = copies.rollout(actions, keep=["observations"])
    other = others.rollout(actions, keep=["observations"]).observations
    rows = np.stack([source.step(action)[0] for action in after])
    assert np.array_equal(flown.observations, np.repeat(rows[:, np.newaxis], 35, axis=1))
    # from the same place on, in other noise
    assert not np.array_equal(other[:, 0], other[:, 34])


def test_a_state_of_another_environment_is_refused():
    source = gym.make("Crazyflie-v0", disable_env_checker=True).unwrapped
    source.reset(seed=0)
    with pytest.raises(ValueError, match="other models, options or size"):
        make("Crazyflie-v0").copy_state(source)
    plain = make("Crazyflie-v0", effects={}, autoreset_mode="disabled", max_episode_steps=-1)
    plain.copy_state(source)
    with pytest.raises(RuntimeError, match="copy_state"):
        plain.rollout("thesis-pid", 3)
    with pytest.raises(ValueError, match="seeds"):
        plain.copy_state(source, seeds=[1, 2])


def test_a_constant_force_is_the_wind(env_id):
    calm, windy = make(env_id, effects={}), make(env_id, effects={"wind": {"x_mps2": 0.5, "y_mps2": -0.25}})
    calm.set_force(MASS_KG * np.array([0.5, -0.25, 0.0]))
    actions = 0.1 * actions_for(calm.action_space, STEPS)
    pushed, blown = (
        calm.rollout(actions[:10], keep=["observations"]),
        windy.rollout(actions[:10], keep=["observations"]),
    )
    assert np.allclose(pushed.observations, blown.observations, atol=2e-5)
    still = make(env_id, effects={})
    assert np.abs(still.rollout(actions[:10], keep=["observations"]).observations - pushed.observations).max() > 1e-3
    calm.set_force(None)


def test_a_force_acts_on_its_drone_alone(env_id):
    one, other = make(env_id, envs=35, threads=2), make(env_id, envs=35)
    lead = one.rollout(np.zeros((1, *one.action_space.shape), np.float32)).returns.shape
    other.rollout(np.zeros((1, *one.action_space.shape), np.float32))
    force_n = np.zeros((*lead, 3), np.float32)
    force_n[20] = 0.02
    other.set_force(force_n)
    states = []
    for envs in (one, other):
        for _ in range(3):
            envs.step(np.zeros(envs.action_space.shape, np.float32))
        states.append(envs.sim.states().reshape(35, -1))
    differs = (states[0] != states[1]).any(1)
    assert differs.nonzero()[0].tolist() == [20]


def test_forces_that_are_none_are_named(env_id):
    single, envs = gym.make(env_id, disable_env_checker=True).unwrapped, make(env_id)
    for env in (single, envs):
        env.set_force([0.0, 0.0, 0.01])
        with pytest.raises(ValueError, match=r"force_n\[0\].*\[1\] is NaN, expected a finite number"):
            env.set_force([0.0, np.nan, 0.0])
        with pytest.raises(ValueError, match=r"force_n: expected shape \(3,\) or"):
            env.set_force([0.0, 0.0])


def test_the_planner_flies_better_than_the_pid():
    sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
    mppi = importlib.import_module("mppi")
    for env_id in mppi.TASKS.values():
        pid, planned, rate = mppi.compare(env_id, ticks=60, samples=256)
        assert planned > pid and rate > 0.0
