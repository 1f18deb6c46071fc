"""Train a hover policy by back-propagation through time: the gradient of a distance, through 2 s of the simulator.

    python examples/jax_hover_bptt.py

Flights are a `lax.scan` of `step_env`, with drag and late commands in the loop. What comes out flies against the
thesis's PID in the Rust core, on seeds that training has not seen: as a controller of one's own in Python.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np
import optax

import crazyflie_gym
import crazyflie_gym.jax
from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.policy import level, output, rotated
from crazyflie_gym.ppo import network
from crazyflie_gym.spaces import split

OPTIONS = {
    "effects": {"drag_linear": 0.3, "cmd_delay": 0.03},
    "task_options": {"start_radius_m": 0.8, "start_yaw_deg": 20.0},
}
ENVS, TICKS, TICK_S = 256, 100, 0.02
# position error, velocity, yaw error, roll, pitch, rates, last action from level: about what hovering takes of each
SCALES = np.repeat(np.float32([0.3, 0.5, 0.2, 0.1, 0.5, 0.3]), [3, 3, 1, 2, 3, 4])


def act(weights, rest, rows, before_m):
    """Return actions, and positions to remember: the velocity is their difference from tick to tick."""
    seen = split(rows)
    pos_m, yaw = seen["marker_pos_m"], seen["attitude_rad"][..., 2]
    turn = seen["setpoint"][..., 3] - yaw
    error = rotated(seen["setpoint"][..., :3] - pos_m, yaw)
    velocity = rotated((pos_m - before_m) / TICK_S, yaw)
    tilt, rates = seen["attitude_rad"][..., :2], seen["gyro_radps"]
    x = jnp.concatenate([error, velocity, turn[..., None], tilt, rates, seen["last_action"] - rest], -1) / SCALES
    return jnp.clip(rest + output(weights["layers"], weights["skip"], x), -1.0, 1.0), pos_m


def cost(weights, rest, env, key):
    """Return the mean distance of new flights from the set-point, where a radian counts as a metre, and what a change
    of the action costs.
    """
    rows, state = env.reset(key, num_envs=ENVS)

    def tick(carry, _):
        rows, state, before_m = carry
        last = split(rows)["last_action"]
        action, before_m = act(weights, rest, rows, before_m)
        rows, state, _, _, _ = env.step_env(key, state, action)
        true, setpoint = env.true_state(state), split(rows)["setpoint"]
        off = true["pos_m"] - setpoint[..., :3]
        square = (off**2).sum(-1) + (true["att_rad"][..., 2] - setpoint[..., 3]) ** 2
        # the root is smooth at the set-point, to a centimetre
        return (rows, state, before_m), jnp.sqrt(square + 1e-4) + 0.05 * ((action - last) ** 2).mean(-1)

    return jax.lax.scan(tick, (rows, state, split(rows)["marker_pos_m"]), length=TICKS)[1].mean()


def train(env, rest, iterations, seed=0):
    """Return weights before and after, and seconds of compiling and of training."""
    layers = network(np.random.default_rng(seed), [len(SCALES), 32, 4], 0.01)
    before = {"layers": layers, "skip": np.zeros((len(SCALES), 4), np.float32)}
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(optax.cosine_decay_schedule(1e-2, iterations)))

    def learn(weights, state, key):
        updates, state = optimiser.update(jax.grad(cost)(weights, rest, env, key), state)
        return optax.apply_updates(weights, updates), state

    start, weights, state = time.perf_counter(), before, optimiser.init(before)
    learned = jax.jit(learn).lower(weights, state, jax.random.key(0)).compile()
    compiling, start = time.perf_counter() - start, time.perf_counter()
    for key in jax.random.split(jax.random.key(seed + 1), iterations):
        weights, state = learned(weights, state, key)
    jax.block_until_ready(weights)
    return before, weights, compiling, time.perf_counter() - start


class Pilot:
    """Weights that fly where controllers do."""

    def __init__(self, weights, rest):
        self.answer = jax.jit(lambda rows, before_m: act(weights, rest, rows, before_m))
        self.fresh, self.before_m = True, 0.0

    def act(self, rows):
        """Return actions for measured rows."""
        before_m = np.where(self.fresh, split(rows)["marker_pos_m"], self.before_m)
        actions, self.before_m = self.answer(rows, before_m)
        self.fresh = False
        return np.asarray(actions)

    def reset(self, mask):
        """Forget where the vehicles of the mask were: they are taken to stand still."""
        self.fresh = mask[:, np.newaxis]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=150)
    args = parser.parse_args()
    env = crazyflie_gym.jax.make(
        "Crazyflie-v0", vertical="pwm", observation="measured", max_episode_steps=-1, **OPTIONS
    )
    rest = level(crazyflie_gym.CrazyflieVectorEnv(1, vertical="pwm").interface)
    before, after, compiling, seconds = train(env, rest, args.iterations)
    print(f"compiled in {compiling:.1f} s; {args.iterations} gradients of {ENVS} flights in {seconds:.1f} s")
    print("128 unseen seeds, Rust core   reward   RMS error   failed")
    flown = {"untrained": Pilot(before, rest), "trained": Pilot(after, rest), "thesis-pid": "thesis-pid"}
    for name, controller in flown.items():
        flights = fly(Work(Scenario(ticks=500, **OPTIONS), controller, first_seed=10**9, count=128))
        failed = sum(flight["failed"] for flight in flights)
        print(f"{name:26s} {median(flights, 'reward'):9.3f} {100 * median(flights, 'rmse_m'):8.1f} cm {failed:8d}")


if __name__ == "__main__":
    main()
