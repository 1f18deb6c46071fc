"""The rope of `carry` along the logged path of a vehicle, against the logged path of its load: `make recorded`.

`stateEstimateZ.p*` of crazyswarm2 is the load, 5 g on a thread of 0.51 m, as the motion capture saw it.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared/data/crazyswarm2"
sys.path.insert(0, str(ROOT / "examples/simulators"))

from motor_flights import columns, read_micro_sd  # noqa: E402
from real_flights import resample  # noqa: E402

TICK_S, ROPE_M, LOAD_KG = 0.004, 0.51, 0.005


def paths(name):
    """Position and velocity of the vehicle (n, 6), and position of the load (n, 3), on the clock of the ticks."""
    rows = read_micro_sd(DATA / name)
    time_s = (rows["t"] - rows["t"][0]) * 1e-6
    at_s = np.arange(0.1, time_s[-1], TICK_S)
    vehicle, load = (
        columns(rows, *(f"stateEstimateZ.{part}{axis}" for part in parts for axis in "xyz"))
        for parts in (("", "v"), "p")
    )
    return resample(at_s, time_s, vehicle), resample(at_s, time_s, load)


def swings(vehicle, starts):
    """Paths (starts, n, 3) of loads on the rope of a vehicle that is led; starts are position and velocity below it."""
    jax = pytest.importorskip("jax")
    import crazyflie_gym.jax

    env = crazyflie_gym.jax.make(
        "CrazyflieCarry-v0", model=crazyflie_gym.model_text("cf21", control_hz=1.0 / TICK_S), drones=1, starts=1,
        max_episode_steps=-1, task_options={"rope_m": ROPE_M, "load_kg": LOAD_KG, "ring_m": 0.0},
    )  # fmt: skip
    key = jax.random.key(0)
    _, state = env.reset(key, num_envs=len(starts))
    hover = jax.numpy.stack(state.last_action, -1)

    def tick(state, row):
        each = [jax.numpy.full(len(starts), value) for value in row]
        # the climb is kept in the first lag
        led = state._replace(pos_m=tuple(each[:3]), vel_mps=tuple(each[3:]), lag=(each[5], 0.0 * each[5]))
        state = env.step_env(key, led, hover)[1]
        return state, jax.numpy.stack(state.load_pos_m, -1)

    rows = jax.numpy.asarray(vehicle, "float32")
    first = [
        tuple(jax.numpy.asarray(vehicle[0, part] + starts[:, part], "float32").T) for part in (slice(3), slice(3, 6))
    ]
    state = state._replace(load_pos_m=first[0], load_vel_mps=first[1])
    return np.moveaxis(np.asarray(jax.lax.scan(tick, state, rows)[1], float), 0, 1)


def rms(path):
    return np.sqrt((path[:, :2] ** 2).sum(-1).mean())


@pytest.mark.parametrize(("name", "most"), [("log201", 0.6), ("log204", 0.5)])
def test_the_load_of_carry_swings_as_a_real_one_did(name, most):
    """Its start is fitted: logged velocities are noisy, and nothing damps the swing. The bounds were set afterwards."""
    vehicle, load = paths(name)
    below = load - vehicle[:, :3]
    assert np.linalg.norm(below, axis=1) == pytest.approx(ROPE_M, abs=0.005)
    starts = np.zeros((5, 6))
    starts[:, 2] = -ROPE_M
    starts[[1, 2, 3, 4], [0, 1, 3, 4]] = 0.01
    hangs, *moved = swings(vehicle, starts)
    known = np.stack([(one - hangs)[:, :2].ravel() for one in moved], -1)
    missing = (load - hangs)[:, :2]
    found = np.linalg.lstsq(known, missing.ravel(), rcond=None)[0]
    left = missing - (known @ found).reshape(missing.shape)
    swing_m = rms(below - below.mean(0))
    print(f"{name}: {1e3 * rms(left):.1f} mm of {1e3 * swing_m:.1f} mm; hanging first {1e3 * rms(missing):.1f} mm")
    assert rms(left) < most * swing_m
