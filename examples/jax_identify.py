"""Identify drag and delay of a real flight by gradient, and judge them on flights that the fit has not seen.

    python examples/jax_identify.py [--data FOLDER]

The flights are NanoBench's (Ullah and Baca 2026, arXiv 2603.09908), a Crazyflie 2.1 under motion capture, of which the
tests keep cuts. From the measured state of an instant the logged tilt commands drive a data sheet's model for a second;
Adam follows the gradient of what is missed. Clocks of motion capture and vehicle differ by tens of milliseconds in
these logs: a delay that is found is the clocks' and the vehicle's together.
"""

import argparse
import gzip
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

import crazyflie_gym
import crazyflie_gym.jax

ROOT = Path(__file__).resolve().parents[1]
FIT, HELD_OUT = ("B3_figure8_fast_rep1", "B8_star_fast_rep1"), ("B3_figure8_slow_rep1", "B8_star_medium_rep1")
TILT_MAX_DEG, TICK_S = 40.0, 0.02
# the delay's memory is filled by so many ticks before the second that is predicted
BEFORE, AHEAD, WINDOWS = 8, 50, 64
EFFECTS = {"drag_linear": {"rate_ps": 0.0}, "cmd_delay": {"delay_s": 0.0}, "attitude_gain": {"gain": 1.0}}
# drag, delay and gain; roll and pitch that level markers show; roll and pitch that are commanded when level
START = np.float32([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
LOW, HIGH = np.float32([0.0, 0.0, 0.2, *[-0.1] * 4]), np.float32([3.0, 0.14, 3.0, *[0.1] * 4])
SCALES = np.float32([1.0, 0.1, 1.0, *[0.1] * 4])


def read_flight(path):
    """Return position, velocity, attitude, rates and tilt commands at 50 Hz, (ticks, 14), of the flight above 50 cm."""
    with gzip.open(path, "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True)[::2]
    table = table[table["pz"] > 0.5]
    angles = [np.unwrap(table[name]) for name in ("roll", "pitch", "yaw")]
    # pitch is inverted in the firmware
    commands = [np.radians(table["pid_controller_roll"]), -np.radians(table["pid_controller_pitch"])]
    motion = [table[name] for name in ("px", "py", "pz", "vx", "vy", "vz")] + angles
    return np.stack([*motion, *(np.gradient(angle, TICK_S) for angle in angles), *commands], -1)


def cut_windows(folder, names):
    """Return windows (ticks, WINDOWS, 14) that lie evenly over flights."""
    rows = []
    for flight in [read_flight(folder / f"{name}.csv.gz") for name in names]:
        middles = np.linspace(BEFORE, len(flight) - AHEAD - 1, WINDOWS // len(names)).astype(int)
        rows += [flight[at - BEFORE : at + AHEAD + 1] for at in middles]
    return jnp.asarray(np.stack(rows, 1), jnp.float32)


def predict_errors(env, numbers, windows):
    """Return errors of x, y, vx, vy, roll and pitch, (AHEAD, WINDOWS, 6)."""
    params = env.default_params
    for number, (effect, values) in zip(numbers, EFFECTS.items(), strict=False):
        changed = getattr(params, effect)._replace(**dict.fromkeys(values, number))
        params = params._replace(**{effect: changed})
    windows = windows.at[..., 6:8].add(-numbers[3:5]).at[..., 12:14].add(-numbers[5:7])
    begun = np.tile(np.float32([0, 0, 1, 0, 0, 0, 1] + [0] * 9), (WINDOWS, 1))
    _, state = env.begin(np.zeros((WINDOWS, 1, 2), np.uint32), begun, params)

    def tick(state, at):
        i, row = at
        pos, vel, att, rate = (tuple(row[:, j : j + 3].T) for j in (0, 3, 6, 9))
        measured = state._replace(pos_m=pos, vel_mps=vel, att_rad=att, rate_radps=rate)
        state = jax.tree.map(lambda seen, flown: jnp.where(i <= BEFORE, seen, flown), measured, state)
        # no yaw rate; the thrust moves nothing sideways
        action = jnp.concatenate([row[:, 12:14] / np.radians(TILT_MAX_DEG), jnp.zeros((WINDOWS, 2))], -1)
        state = env.step_env(jax.random.key(0), state, action, params)[1]
        true = env.true_state(state)
        return state, jnp.concatenate([true[name][:, :2] for name in ("pos_m", "vel_mps", "att_rad")], -1)

    predicted = jax.lax.scan(tick, state, (jnp.arange(len(windows) - 1), windows[:-1]))[1]
    return (predicted - windows[1:, :, np.array([0, 1, 3, 4, 6, 7])])[BEFORE:]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=ROOT / "tests/data/nanobench")
    parser.add_argument("--iterations", type=int, default=150)
    args = parser.parse_args()
    if missing := [name for name in [*FIT, *HELD_OUT] if not (args.data / f"{name}.csv.gz").exists()]:
        parser.error(f"{args.data}: expected recordings there, but it lacks {', '.join(missing)}")
    sheet = (ROOT / "examples/crazyflie_datasheet.toml").read_text() + f"[limits]\ntilt_max_deg = {TILT_MAX_DEG}\n"
    model = crazyflie_gym.model_from_datasheet(sheet)
    env = crazyflie_gym.jax.make("hover", model=model, vertical="thrust", effects=EFFECTS, max_episode_steps=-1)
    fitted, held_out = (cut_windows(args.data, names) for names in (FIT, HELD_OUT))

    def cost(numbers, windows):
        errors = predict_errors(env, numbers, windows)
        # 1 rad counts as the 3 m/s that it makes in 0.3 s
        return (errors[..., 2:4] ** 2).mean() + 9 * (errors[..., 4:] ** 2).mean(), errors

    begin = time.perf_counter()
    slopes = jax.jit(jax.grad(cost, has_aux=True)).lower(START, fitted).compile()
    print(f"compiled in {time.perf_counter() - begin:.1f} s; errors after 1 s, held-out flights:")
    numbers = jnp.asarray(START)
    for name, free in (("data sheet", np.zeros(7)), ("and offsets", np.arange(7) >= 3), ("and effects", np.ones(7))):
        begin, optimiser = time.perf_counter(), optax.adam(optax.cosine_decay_schedule(0.05, args.iterations))
        # the search for a delay begins at one tick
        numbers, state = numbers.at[1].set(TICK_S * free[1]), optimiser.init(numbers)
        for _ in range(args.iterations if free.any() else 0):
            step, state = optimiser.update(slopes(numbers, fitted)[0] * SCALES * free, state)
            numbers = jnp.clip(numbers + SCALES * step, LOW, HIGH)
        last = slopes(numbers, held_out)[1][-1]
        pos_m, vel_mps, tilt_rad = (float(jnp.sqrt((last[:, i : i + 2] ** 2).sum(-1).mean())) for i in (0, 2, 4))
        spent = f"fitted in {time.perf_counter() - begin:.1f} s"
        print(f"{name:12s} position {pos_m:.3f} m, velocity {vel_mps:.3f} m/s, tilt {tilt_rad:.3f} rad; {spent}")
    print(f"drag {numbers[0]:.3f} 1/s, delay {1e3 * numbers[1]:.1f} ms, attitude gain {numbers[2]:.3f}")


if __name__ == "__main__":
    main()
