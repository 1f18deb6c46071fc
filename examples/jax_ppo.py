"""PPO in one compiled function, as PureJaxRL has it: environments, networks and updates never leave the accelerator.

    python examples/jax_ppo.py delayed-track

Flights see the lab's camera, late and noisy, and the Kalman filter's estimate of position and velocity; the critic sees
the true state too. Networks, losses and reward are those of `crazyflie_gym.ppo`, which first imitates a controller. The
policy is a file of the program. It flies against PID, velocity cascade, LQR and MPC in the Rust core, on seeds that
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
from crazyflie_gym.policy import SIGNALS, Policy
from crazyflie_gym.ppo import Rollout, Trainer, actor, learner, paired, paired_table, reward
from crazyflie_gym.spaces import STATE_FIELDS
from crazyflie_gym.training import OBSERVED, TASKS


class Flights(NamedTuple):
    """All environments at one tick; where `fresh`, a flight begins, and moving averages count for nothing."""

    observation: Any
    state: Any
    averages: Any
    fresh: Any


class Learner(NamedTuple):
    """What an iteration goes on from."""

    params: Any
    optimised: Any
    flights: Flights


def begin(env, c, optimiser, trainer):
    """Return the learner that begins as the trainer that has imitated a controller, at the start of all flights."""
    params = jax.tree.map(jnp.asarray, trainer.params)
    averages = jnp.zeros((c.envs, len(c.taus_s), SIGNALS))
    flights = Flights(*env.reset(jax.random.key(c.seed), num_envs=c.envs), averages, jnp.ones(c.envs, bool))
    return Learner(params, optimiser.init(params), flights)


def restart(env, c, flights, key):
    """Begin new flights here and there: a rollout ends with the critic's estimate, whatever comes after it."""
    chosen = jax.random.uniform(key, (c.envs,)) < 1 / c.rollouts
    observation, state = env.reset(key, num_envs=c.envs)
    state = jax.tree.map(lambda new, old: jnp.where(chosen, new, old), state, flights.state)
    observation = jnp.where(chosen[:, None], observation, flights.observation)
    return Flights(observation, state, flights.averages, flights.fresh | chosen)


def true_rows(env, state):
    """Return the true states (n, 12) in the order of `STATE_FIELDS`."""
    true = env.true_state(state)
    return jnp.concatenate([true[name] for name in STATE_FIELDS], -1)


def collect(env, c, act, scales, learner, key):
    """Return the flights some ticks later, the rollout, and what the critic sees then."""

    def see(flights, noise):
        states = true_rows(env, flights.state)
        return act(learner.params, scales, flights.observation, states, flights.averages, flights.fresh, noise)

    def tick(flights, key):
        action, drawn, x, seen, averages = see(flights, jax.random.normal(key, (c.envs, 4)))
        observation, state, _, done, _ = env.step(key, flights.state, action)
        ends = done.astype(jnp.float32)
        states = true_rows(env, state)
        kept = Rollout(x, seen, drawn, reward(c, observation, states, action, flights.observation, ends), ends)
        return Flights(observation, state, averages, done), kept

    flights, rollout = jax.lax.scan(tick, learner.flights, jax.random.split(key, c.ticks))
    return flights, rollout, see(flights, jnp.zeros((c.envs, 4)))[3]


def shuffle(c, key):
    """Return minibatches of an epoch: whole rollouts of some environments, which costs no sorting of samples."""
    samples = jax.random.permutation(key, c.envs) + c.envs * jnp.arange(c.ticks)[:, None]
    return samples.reshape(c.ticks, -1, c.minibatch // c.ticks).swapaxes(0, 1).reshape(-1, c.minibatch)


def training(env, trainer):
    """Return a pure function of a key, which returns the learner and the mean reward of each rollout."""
    c = trainer.config
    steps = c.iterations * c.epochs * (c.envs * c.ticks // c.minibatch)
    rate = optax.linear_schedule(c.learning_rate, 0.05 * c.learning_rate, steps)
    optimiser = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(rate, eps=1e-5))
    act, learn = actor(c, trainer.rest, env.tick_s), learner(c, optimiser)

    def iterate(now, key):
        again, fly_key, *epochs = jax.random.split(key, 2 + c.epochs)
        now = now._replace(flights=restart(env, c, now.flights, again))
        flights, rollout, last = collect(env, c, act, trainer.scales, now, fly_key)
        order = jnp.concatenate([shuffle(c, key) for key in epochs])
        params, optimised = learn(now.params, now.optimised, trainer.scales, rollout, last, order)
        return Learner(params, optimised, flights), rollout.rewards.mean() / (1 - c.discount)

    return lambda key: jax.lax.scan(iterate, begin(env, c, optimiser, trainer), jax.random.split(key, c.iterations))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", choices=["hover", "delayed-track"], nargs="?", default="hover")
    parser.add_argument("--iterations", type=int, help="rollouts")
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="jax_ppo.safetensors")
    args = parser.parse_args()
    config = dataclasses.replace(TASKS[args.task], envs=args.envs, seed=args.seed)
    config = dataclasses.replace(config, iterations=args.iterations or config.iterations)
    task, arguments = config.flown[0]
    given = {"vertical": "pwm", "observation": OBSERVED, "max_episode_steps": -1, "effects": config.effects}
    env = crazyflie_gym.jax.make(task, **given, **arguments)
    trainer = Trainer(config)
    trainer.imitate()
    start = time.perf_counter()
    train = jax.jit(training(env, trainer)).lower(jax.random.key(0)).compile()
    compiling, start = time.perf_counter() - start, time.perf_counter()
    learned, rewards = jax.block_until_ready(train(jax.random.key(config.seed)))
    seconds, ticks = time.perf_counter() - start, config.iterations * config.envs * config.ticks
    print(f"compiled in {compiling:.1f} s; trained in {seconds:.1f} s on {ticks / 1e6:.1f} M ticks:", end=" ")
    print(f"reward {rewards[0]:.3f} to {rewards[-1]:.3f}, exploration included")
    layers = [(np.asarray(w), np.asarray(b)) for w, b in learned.params["actor"]]
    mean, std = trainer.scales["actor"]
    Policy(layers, np.asarray(learned.params["skip"]), mean, std, config.taus_s, env.tick_s).save(args.out)
    print(paired_table(paired(config, args.out)))
    print(f"the policy is {args.out}: crazyflie fly --controller policy:{args.out}")


if __name__ == "__main__":
    main()
