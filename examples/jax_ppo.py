"""PPO in one compiled function, as PureJaxRL has it: environments, networks and updates never leave the accelerator.

    python examples/jax_ppo.py

Flights see the lab's camera, late and noisy, and the Kalman filter's estimate of position and velocity; the critic sees
the true state too. Networks and losses are those of `crazyflie_gym.ppo`; nothing is imitated, and the reward is the
task's own. What comes out is a file of the program. It flies against the thesis's PID in the Rust core, on seeds that
training has not seen.
"""

import argparse
import dataclasses
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

import crazyflie_gym
import crazyflie_gym.jax
from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.policy import SIGNALS, Policy, level, width
from crazyflie_gym.ppo import Rollout, actor, learner, network
from crazyflie_gym.spaces import STATE_FIELDS
from crazyflie_gym.training import LAB, OBSERVED, Config

FLOWN = {"effects": LAB, "task_options": {"start_radius_m": 0.8, "start_yaw_deg": 20.0}}
CONFIG = Config(iterations=70, epochs=2, learning_rate=3e-3)


class Flights(NamedTuple):
    """All environments at one tick; where `fresh`, a flight begins, and moving averages count for nothing."""

    observation: Any
    state: Any
    averages: Any
    fresh: Any


class Learner(NamedTuple):
    """What an iteration goes on from; moments are number, mean and mean square of what each network has seen."""

    params: Any
    optimised: Any
    moments: Any
    flights: Flights

    def scales(self):
        """Return mean and standard deviation of what each network sees."""
        spread = {
            name: jnp.sqrt(jnp.maximum(square - mean**2, 1e-4)) for name, (_, mean, square) in self.moments.items()
        }
        return {name: (self.moments[name][1], std) for name, std in spread.items()}


def begin(env, c, optimiser):
    """Return the learner that has seen nothing."""
    rng, w = np.random.default_rng(c.seed), c.width
    sizes = {"actor": width(len(c.taus_s)), "critic": width(len(c.taus_s)) + 12}
    params = {
        "actor": network(rng, [sizes["actor"], w, w, 4], 0.01),
        "critic": network(rng, [sizes["critic"], w, w, 1], 0.01),
        "skip": np.zeros((sizes["actor"], 4), np.float32),
        "log_std": np.full(4, np.log(c.exploration), np.float32),
    }
    moments = {name: (0.0, jnp.zeros(size), jnp.ones(size)) for name, size in sizes.items()}
    averages = jnp.zeros((c.envs, len(c.taus_s), SIGNALS))
    flights = Flights(*env.reset(jax.random.key(c.seed), num_envs=c.envs), averages, jnp.ones(c.envs, bool))
    return Learner(params, optimiser.init(params), moments, flights)


def restart(env, c, flights, key):
    """Begin new flights here and there: a rollout ends with the critic's estimate, whatever comes after it."""
    chosen = jax.random.uniform(key, (c.envs,)) < 1 / c.rollouts
    observation, state = env.reset(key, num_envs=c.envs)
    state = jax.tree.map(lambda new, old: jnp.where(chosen, new, old), state, flights.state)
    observation = jnp.where(chosen[:, None], observation, flights.observation)
    return Flights(observation, state, flights.averages, flights.fresh | chosen)


def collect(env, c, act, learner, key):
    """Return the flights some ticks later, the rollout, and what the critic sees then."""
    params, scales = learner.params, learner.scales()

    def see(flights, noise):
        true = env.true_state(flights.state)
        states = jnp.concatenate([true[name] for name in STATE_FIELDS], -1)
        return act(params, scales, flights.observation, states, flights.averages, flights.fresh, noise)

    def tick(flights, key):
        action, drawn, x, seen, averages = see(flights, jax.random.normal(key, (c.envs, 4)))
        observation, state, reward, done, _ = env.step(key, flights.state, action)
        kept = Rollout(x, seen, drawn, (1 - c.discount) * reward, done.astype(jnp.float32))
        return Flights(observation, state, averages, done), kept

    flights, rollout = jax.lax.scan(tick, learner.flights, jax.random.split(key, c.ticks))
    return flights, rollout, see(flights, jnp.zeros((c.envs, 4)))[3]


def shuffle(c, key):
    """Return minibatches of an epoch: whole rollouts of some environments, which costs no sorting of samples."""
    samples = jax.random.permutation(key, c.envs) + c.envs * jnp.arange(c.ticks)[:, None]
    return samples.reshape(c.ticks, -1, c.minibatch // c.ticks).swapaxes(0, 1).reshape(-1, c.minibatch)


def widen(moments, x):
    """Return number, mean and mean square with those of another rollout."""
    n, mean, square = moments
    pull = 1 / (n + 1)
    return n + 1, mean + pull * (x.mean((0, 1)) - mean), square + pull * ((x**2).mean((0, 1)) - square)


def trainer(env, rest, c):
    """Return a pure function of a key, which returns the learner and the mean reward of each rollout."""
    steps = c.iterations * c.epochs * (c.envs * c.ticks // c.minibatch)
    rate = optax.linear_schedule(c.learning_rate, 0.05 * c.learning_rate, steps)
    optimiser = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(rate, eps=1e-5))
    act, learn = actor(c, rest, env.tick_s), learner(c, optimiser)

    def iterate(now, key):
        again, fly_key, *epochs = jax.random.split(key, 2 + c.epochs)
        now = now._replace(flights=restart(env, c, now.flights, again))
        flights, rollout, last = collect(env, c, act, now, fly_key)
        order = jnp.concatenate([shuffle(c, key) for key in epochs])
        params, optimised = learn(now.params, now.optimised, now.scales(), rollout, last, order)
        seen = {"actor": rollout.features, "critic": rollout.seen}
        moments = {name: widen(now.moments[name], x) for name, x in seen.items()}
        return Learner(params, optimised, moments, flights), rollout.rewards.mean() / (1 - c.discount)

    return lambda key: jax.lax.scan(iterate, begin(env, c, optimiser), jax.random.split(key, c.iterations))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=CONFIG.iterations)
    parser.add_argument("--envs", type=int, default=CONFIG.envs)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="jax_ppo.safetensors")
    args = parser.parse_args()
    config = dataclasses.replace(CONFIG, iterations=args.iterations, envs=args.envs, seed=args.seed)
    env = crazyflie_gym.jax.make("Crazyflie-v0", vertical="pwm", observation=OBSERVED, max_episode_steps=-1, **FLOWN)
    rest = level(crazyflie_gym.CrazyflieVectorEnv(1, vertical="pwm").interface)
    start = time.perf_counter()
    train = jax.jit(trainer(env, rest, config)).lower(jax.random.key(0)).compile()
    compiling, start = time.perf_counter() - start, time.perf_counter()
    learned, rewards = jax.block_until_ready(train(jax.random.key(config.seed)))
    seconds, ticks = time.perf_counter() - start, config.iterations * config.envs * config.ticks
    print(f"compiled in {compiling:.1f} s; trained in {seconds:.1f} s on {ticks / 1e6:.1f} M ticks:", end=" ")
    print(f"reward {rewards[0]:.3f} to {rewards[-1]:.3f}, exploration included")
    layers = [(np.asarray(w), np.asarray(b)) for w, b in learned.params["actor"]]
    mean, std = (np.asarray(part) for part in learned.scales()["actor"])
    Policy(layers, np.asarray(learned.params["skip"]), mean, std, config.taus_s, env.tick_s).save(args.out)
    print("128 unseen seeds, Rust core   reward   RMS error   failed")
    for controller in ("thesis-pid", f"policy:{args.out}"):
        flights = fly(Work.of(Scenario(ticks=500, **FLOWN), controller, first_seed=10**9, count=128))
        failed = sum(flight["failed"] for flight in flights)
        figures = f"{median(flights, 'reward'):9.3f} {100 * median(flights, 'rmse_m'):8.1f} cm {failed:8d}"
        print(f"{controller.split(':')[0]:26s} {figures}")
    print(f"the policy is {args.out}: crazyflie fly --controller policy:{args.out}")


if __name__ == "__main__":
    main()
