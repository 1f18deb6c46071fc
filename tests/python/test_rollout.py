"""Several steps at once are the steps one after the other, to the bit."""

import gymnasium as gym
import numpy as np
import pytest

from common import FIVE, actions_for

STEPS = 30


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
    rows = one._rows
    for _ in range(2):
        rewards = []
        for _ in range(STEPS):
            actions = pilot.act(rows)
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
    with pytest.raises(ValueError, match="in Python answers for the whole batch.*`step`"):
        envs.rollout(envs.controller(Still()), STEPS)
    with pytest.raises(TypeError):
        envs.rollout(Still(), STEPS)
    for own in ({"reward": lambda dist: -dist}, {"termination": lambda dist: dist > 1.0}):
        called = make("Crazyflie-v0", **own)
        before = called.sim.get_state()
        with pytest.raises(ValueError, match=f"{next(iter(own))}: a rollout.*expression"):
            called.rollout(actions)
        with pytest.raises(ValueError, match="a rollout.*expression"):
            called.rollout("thesis-pid", STEPS)
        assert called.sim.get_state() == before


def test_an_expression_that_gives_no_number_is_told_after_the_steps():
    envs = make("Crazyflie-v0", effects={}, reward="sqrt(0.01 - dist)")
    with pytest.raises(ValueError, match="sqrt.*environment 0.*step 1 "):
        envs.rollout(np.zeros((STEPS, 21, 4), np.float32))
    # the last observations are those of the last step
    assert np.array_equal(envs._rows[:, :3], envs.sim.measured(envs._rows)[:, :3])
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
        (make("Crazyflie-v0", envs=9).controller(), {"steps": 3}, "expected|observations"),
    ]:
        with pytest.raises(ValueError, match=words):
            envs.rollout(given, **options)
    assert envs.sim.get_state() == before
    with pytest.raises(RuntimeError, match="reset"):
        gym.make_vec("Crazyflie-v0", num_envs=21).unwrapped.rollout(actions)
