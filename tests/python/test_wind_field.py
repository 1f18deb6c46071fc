"""Wind from place to place: sampled once, felt by what drags through the air."""

import pickle

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym

DRAG = {"drag_linear": 0.8}
WIND_MPS = (0.5, -0.25, 0.0)


def shear(pos_m):
    """East wind that grows with the height."""
    return np.stack([pos_m[..., 2], 0.0 * pos_m[..., 0], 0.0 * pos_m[..., 0]], axis=-1)


def states(env_id, ticks=25, envs=21, **options):
    batch = gym.make_vec(env_id, num_envs=envs, **options).unwrapped
    batch.reset(seed=3)
    flown = batch.rollout(np.zeros((ticks, *batch.action_space.shape), np.float32))
    assert np.isfinite(flown.returns).all()
    return batch.sim.states()


def test_a_function_is_sampled_at_the_points_of_a_grid():
    calls = []

    def function(pos_m):
        calls.append(pos_m)
        return shear(pos_m)

    field = crazyflie_gym.WindField.sample(function, [-1, -1, 0], [1, 1, 2], [0.5, 1.0, 0.4])
    assert len(calls) == 1 and field.velocity_mps.shape == (5, 3, 6, 3)
    assert np.allclose(calls[0][4, 2, 5], [1.0, 1.0, 2.0]) and np.allclose(
        field.velocity_mps[0, 0, :, 0], np.arange(6) * 0.4
    )


def test_an_even_wind_is_the_effect_of_its_drag(env_id):
    even = crazyflie_gym.WindField(0.0, 1.0, np.full((1, 1, 1, 3), WIND_MPS))
    pushed = {"wind": {"x_mps2": 0.8 * WIND_MPS[0], "y_mps2": 0.8 * WIND_MPS[1]}}
    blown = states(env_id, effects=DRAG, wind_field=even)
    assert np.allclose(blown, states(env_id, effects=DRAG | pushed), atol=2e-5)
    assert np.abs(blown - states(env_id, effects=DRAG)).max() > 1e-2


def test_threads_and_single_environments_feel_the_same(env_id):
    field = crazyflie_gym.WindField.sample(shear, [-2, -2, 0], [2, 2, 2], 0.5)
    options = {"effects": DRAG, "wind_field": field}
    batch = states(env_id, **options)
    assert np.array_equal(batch, states(env_id, threads=2, isa="baseline", **options))
    assert np.array_equal(batch[:5], states(env_id, envs=5, **options))


def test_it_is_part_of_a_task_and_of_a_state():
    field = crazyflie_gym.WindField.sample(shear, [-2, -2, 0], [2, 2, 2], 0.5)
    table = {"name": "breeze", "effects": DRAG, "wind_field": field}
    env, other = crazyflie_gym.make_task(table).unwrapped, crazyflie_gym.make_task(table).unwrapped
    env.reset(seed=0)
    other.sim = pickle.loads(pickle.dumps(env.sim))
    for batch in (env, other):
        batch.sim.step_one(np.zeros(4, np.float32))
    assert np.array_equal(env.sim.states(), other.sim.states())
    calm = gym.make("Crazyflie-v0", effects=DRAG, disable_env_checker=True).unwrapped
    with pytest.raises(ValueError, match="other models, options or size"):
        calm.sim.set_state(env.sim.get_state())


def test_mistakes_are_named():
    with pytest.raises(ValueError, match=r"expected shape \(nx, ny, nz, 3\), got \(3,\)"):
        crazyflie_gym.WindField(0.0, 1.0, WIND_MPS)
    with pytest.raises(ValueError, match=r"velocity_mps\[0\]\[0\]\[0\]\[1\] is nan"):
        crazyflie_gym.WindField(0.0, 1.0, [[[[0.0, np.nan, 0.0]]]])
    with pytest.raises(ValueError, match="spacing_m"):
        crazyflie_gym.WindField.sample(shear, 0.0, 1.0, -1.0)
    with pytest.raises(ValueError, match=r"function: expected velocities of shape \(3, 3, 3, 3\), got \(3, 3, 3\)"):
        crazyflie_gym.WindField.sample(lambda pos_m: pos_m[..., 0], 0.0, 1.0, 0.5)
    even = crazyflie_gym.WindField(0.0, 1.0, np.full((1, 1, 1, 3), WIND_MPS))
    with pytest.raises(ValueError, match=r"nothing feels the air.*drag_linear"):
        gym.make("Crazyflie-v0", wind_field=even)
    fast = crazyflie_gym.WindField(0.0, 1.0, np.full((1, 1, 1, 3), 99.0))
    with pytest.raises(ValueError, match=r"velocity_mps\[0\]\[0\]\[0\]\[0\] is 99"):
        gym.make("Crazyflie-v0", effects=DRAG, wind_field=fast)
