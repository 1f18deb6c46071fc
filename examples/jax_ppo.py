"""PPO in one compiled function, as PureJaxRL has it: environments, networks and updates never leave the accelerator.

    python examples/jax_ppo.py

Flights see the lab's camera, late and noisy, and the Kalman filter's estimate of position and velocity. Learning and
networks are those of `crazyflie_gym.ppo`; nothing is imitated here. The policy that comes out is a file of the program,
and flies against the thesis's PID in the Rust core, on seeds that training has not seen.
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
from crazyflie_gym.policy import SIGNALS, Policy, level, width
from crazyflie_gym.ppo import Rollout, actor, learner, network
from crazyflie_gym.training import LAB, OBSERVED, Config

OPTIONS = {"effects": LAB, "task_options": {"start_radius_m": 0.8, "start_yaw_deg": 20.0}}
CONFIG = Config(iterations=80, learning_rate=3e-3, epochs=2)


def joined(true):
    """The true state as one array, as the critic reads it."""
    return jnp.concatenate([true[name] for name in ("pos_m", "vel_mps", "att_rad", "rate_radps")], -1)


def start(rng, inputs):
    """Parameters of policy and critic, and mean and variance of what they see."""
    sizes, w = {"actor": inputs, "critic": inputs + 12}, CONFIG.width
    params = {
        "actor": network(rng, [inputs, w, w, 4], 0.01),
        "critic": network(rng, [inputs + 12, w, w, 1], 0.01),
        "skip": np.zeros((inputs, 4), np.float32),
        "log_std": np.full(4, np.log(CONFIG.exploration), np.float32),
    }
    return params, {name: (jnp.zeros(size), jnp.ones(size)) for name, size in sizes.items()}


def trainer(env, rest):
    """Return a function that trains from a key, and is pure."""
    c, inputs = CONFIG, width(len(CONFIG.taus_s))
    act = actor(c, rest, env.tick_s)
    steps = c.iterations * c.epochs * (c.envs * c.ticks // c.minibatch)
    optimiser = optax.chain(
        optax.clip_by_global_norm(0.5),
        optax.adam(optax.linear_schedule(c.learning_rate, 0.05 * c.learning_rate, steps), eps=1e-5),
    )

    def tick(params, scales, carry, key):
        state, observation, averages, fresh = carry
        noise = jax.random.normal(key, (c.envs, 4))
        true = joined(env.true_state(state))
        action, drawn, x, seen, averages = act(params, scales, observation, true, averages, fresh, noise)
        observation, state, reward, done, _ = env.step(key, state, action)
        kept = Rollout(x, seen, drawn, (1 - c.discount) * reward, done.astype(jnp.float32))
        return (state, observation, averages, done), kept

    def restarted(key, flights):
        """New flights here and there: a rollout ends with the critic's estimate, whatever comes after it."""
        state, observation, averages, fresh = flights
        chosen = jax.random.uniform(key, (c.envs,)) < 1 / c.rollouts
        new_observation, new_state = env.reset(key, num_envs=c.envs)
        state = jax.tree.map(lambda new, old: jnp.where(chosen, new, old), new_state, state)
        return state, jnp.where(chosen[:, None], new_observation, observation), averages, fresh | chosen

    def iteration(carry, key):
        params, optimised, scales, moments, flights = carry
        key, again, *shuffles = jax.random.split(key, 2 + c.epochs)
        flights = restarted(again, flights)
        flights, rollout = jax.lax.scan(
            lambda carry, k: tick(params, scales, carry, k), flights, jax.random.split(key, c.ticks)
        )
        last = act(
            params, scales, flights[1], joined(env.true_state(flights[0])), *flights[2:], jnp.zeros((c.envs, 4))
        )[3]
        order = jnp.concatenate([shuffled(k) for k in shuffles])
        params, optimised = learn(params, optimised, scales, rollout, last, order)
        moments = {name: moved(moments[name], x) for name, x in (("actor", rollout.features), ("critic", rollout.seen))}
        scales = {
            name: (mean, jnp.maximum(jnp.sqrt(square - mean**2), 1e-2)) for name, (n, mean, square) in moments.items()
        }
        return (params, optimised, scales, moments, flights), rollout.rewards.mean() / (1 - c.discount)

    def moved(moment, x):
        n, mean, square = moment
        return n + 1, mean + (x.mean((0, 1)) - mean) / (n + 1), square + ((x**2).mean((0, 1)) - square) / (n + 1)

    def shuffled(key):
        """Minibatches of whole rollouts of some environments: to sort them costs nothing."""
        order = jax.random.permutation(key, c.envs) + c.envs * jnp.arange(c.ticks)[:, None]
        return order.reshape(c.ticks, -1, c.minibatch // c.ticks).swapaxes(0, 1).reshape(-1, c.minibatch)

    learn = learner(c, optimiser)

    def train(key):
        params, scales = start(np.random.default_rng(c.seed), inputs)
        observation, state = env.reset(key, num_envs=c.envs)
        flights = state, observation, jnp.zeros((c.envs, len(c.taus_s), SIGNALS)), jnp.ones(c.envs, bool)
        moments = {name: (0.0, mean, mean) for name, (mean, std) in scales.items()}
        carry = params, optimiser.init(params), scales, moments, flights
        carry, rewards = jax.lax.scan(iteration, carry, jax.random.split(key, c.iterations))
        return carry[0], carry[2], rewards

    return train


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--iterations", type=int, default=CONFIG.iterations)
    parser.add_argument("--out", default="jax_ppo.safetensors")
    args = parser.parse_args()
    env = crazyflie_gym.jax.make("Crazyflie-v0", vertical="pwm", observation=OBSERVED, max_episode_steps=-1, **OPTIONS)
    rest = level(crazyflie_gym.CrazyflieVectorEnv(1, vertical="pwm").interface)
    at = time.perf_counter()
    train = jax.jit(trainer(env, rest)).lower(jax.random.key(0)).compile()
    print(f"compiled in {time.perf_counter() - at:.1f} s")
    at = time.perf_counter()
    params, scales, rewards = jax.block_until_ready(train(jax.random.key(0)))
    print(f"trained {time.perf_counter() - at:.1f} s")
    print(np.asarray(rewards)[::10])
    layers = [(np.asarray(w), np.asarray(b)) for w, b in params["actor"]]
    mean, std = (np.asarray(x) for x in scales["actor"])
    Policy(layers, np.asarray(params["skip"]), mean, std, CONFIG.taus_s, env.tick_s).save(args.out)
    print(np.exp(params["log_std"]))
    for controller in ("thesis-pid", f"policy:{args.out}", "lqr"):
        flights = fly(Work.of(Scenario(ticks=500, **OPTIONS), controller, first_seed=10**9, count=128))
        failed = sum(flight["failed"] for flight in flights)
        print(
            f"{controller:26s} {median(flights, 'reward'):9.3f} {100 * median(flights, 'rmse_m'):8.1f} cm {failed:8d}"
        )


if __name__ == "__main__":
    main()
