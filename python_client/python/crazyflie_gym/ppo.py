"""Proximal policy optimisation (Schulman et al. 2017) in one file: `python -m crazyflie_gym.ppo hover --out hover.safetensors`.

Written for two processor cores: the simulator hardly costs anything, so batches are large, networks small, and everything that learns is one
compiled function per iteration. The critic is asymmetric: it also sees the true state, which only the simulator knows. Needs the extra `train`.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import gymnasium as gym
import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray
from tqdm import tqdm

from crazyflie_gym.policy import SIGNALS, Layers, Policy, features, gains, level, mlp, normalised, rotated, width

LAB: dict[str, Any] = {
    "camera": 1,
    "camera_latency": 0.05,
    "camera_noise": {"xy_m": 0.005, "z_m": 0.01, "yaw_deg": 1.0},
    "ground_effect": 4.0,
}
"""The thesis's camera rig (`crazyflie fly --rig lab`), and the ground below."""

HOVER = ("Crazyflie-v0", {"start_radius_m": 1.0, "start_yaw_deg": 20.0})


@dataclasses.dataclass(frozen=True)
class Config:
    """What is flown, how long, and how it is learned. `flown` are ids with task options; each gets its share of the environments."""

    flown: tuple[tuple[str, dict[str, Any]], ...] = (HOVER,)
    effects: dict[str, Any] = dataclasses.field(default_factory=lambda: LAB)
    seed: int = 0
    iterations: int = 40
    envs: int = 2048
    ticks: int = 32
    minibatch: int = 4096
    epochs: int = 4
    width: int = 32
    taus_s: tuple[float, ...] = (0.1, 0.4)
    learning_rate: float = 4e-3
    # a second and a half: all that an action changes in the end
    discount: float = 0.97
    trace: float = 0.95
    clip: float = 0.2
    exploration: float = 0.37
    # a flight lasts so many rollouts in the mean
    rollouts: float = 8.0
    # taken from the reward of the task, per metre and per radian: it is flat far away from the set-point
    per_metre: float = 0.0
    per_radian: float = 0.0


TASKS = {
    "hover": Config(),
    "track": Config(
        flown=(HOVER, *(("CrazyflieTrack-v0", {"period_s": period_s}) for period_s in (8.0, 12.0, 16.0))),
        iterations=120,
        rollouts=16.0,
        per_metre=0.5,
        per_radian=0.1,
    ),
}


class Batches:
    """Environments of several tasks as one batch."""

    def __init__(self, config: Config) -> None:
        share = -(-config.envs // len(config.flown))
        counts = [min(share, config.envs - share * i) for i in range(len(config.flown))]
        given = {"vertical": "pwm", "effects": config.effects, "true_state": True, "autoreset_mode": "same_step"}
        self._parts = [
            gym.make_vec(id, num_envs=count, task_options=options, max_episode_steps=-1, **given)
            for (id, options), count in zip(config.flown, counts, strict=True)
        ]
        self._cuts = np.cumsum(counts)[:-1]
        self.sim: Any = self._parts[0].unwrapped.sim  # type: ignore[attr-defined]

    def reset(self, seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Begin the first flights; returns observations and true states."""
        made = [part.reset(seed=seed + (i << 32)) for i, part in enumerate(self._parts)]
        return np.concatenate([o for o, _ in made]), np.concatenate([info["true_state"] for _, info in made])

    def restart(self, mask: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Begin new flights where the mask says so."""
        rows, states = [], []
        for part, chosen in zip(self._parts, np.split(mask, self._cuts), strict=True):
            # a mask without any True is a mistake to Gymnasium
            chosen[np.argmax(chosen)] = True
            o, info = part.reset(options={"reset_mask": chosen})
            rows.append(o)
            states.append(info["true_state"])
        return np.concatenate(rows), np.concatenate(states)

    def step(self, actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """Fly a tick; returns observations, true states, rewards and ends. Where a flight ended, the next has begun."""
        made = [part.step(a) for part, a in zip(self._parts, np.split(actions, self._cuts), strict=True)]
        observations, rewards, ends, _, infos = zip(*made, strict=True)
        states = [info["true_state"] for info in infos]
        return tuple(np.concatenate(part) for part in (observations, states, rewards, ends))


class Rollout(NamedTuple):
    """Ticks of all environments, arrays (ticks, envs, ...): features, critic's view, drawn outputs, rewards, ends."""

    features: Any
    seen: Any
    drawn: Any
    rewards: Any
    ends: Any


def critic_view(x: Any, observations: Any, states: Any) -> jax.Array:
    """Return features with, of the true state, position error, velocity, attitude and rates in the vehicle's heading."""
    yaw = states[..., 8]
    error, velocity = observations[..., 16:19] - states[..., 0:3], states[..., 3:6]
    return jnp.concatenate([x, rotated(error, yaw), rotated(velocity, yaw), states[..., 6:12]], -1)


def network(rng: np.random.Generator, sizes: list[int], last: float) -> Layers:
    """Return orthogonal weights, those of the last layer scaled by `last`, and zero biases."""
    layers: Layers = []
    for i, (inputs, outputs) in enumerate(zip(sizes, sizes[1:], strict=False)):
        square = np.linalg.qr(rng.standard_normal([max(inputs, outputs)] * 2))[0]
        scale = last if i == len(sizes) - 2 else np.sqrt(2)
        layers.append(((scale * square[:inputs, :outputs]).astype(np.float32), np.zeros(outputs, np.float32)))
    return layers


def log_density(mean: Any, log_std: Any, drawn: Any) -> jax.Array:
    """Return the logarithm of a normal density, less a constant."""
    return jnp.sum(-0.5 * ((drawn - mean) / jnp.exp(log_std)) ** 2 - log_std, -1)


def advantages(values: Any, rewards: Any, ends: Any, config: Config) -> jax.Array:
    """Generalised advantage estimation (Schulman et al. 2016): values (ticks + 1, envs) to advantages (ticks, envs)."""

    def back(later: jax.Array, tick: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
        value, after, reward, end = tick
        on = config.discount * (1 - end)
        now = reward + on * after - value + config.trace * on * later
        return now, now

    zero = jnp.zeros_like(values[0])
    return jax.lax.scan(back, zero, (values[:-1], values[1:], rewards, ends), reverse=True)[1]


def losses(params: Any, batch: Any, clip: float) -> jax.Array:
    """Return the clipped surrogate and the squared error of the critic, whose parameters are apart."""
    x, seen, drawn, before, gain, target = batch
    ratio = jnp.exp(log_density(mlp(params["actor"], x), params["log_std"], drawn) - before)
    gain = (gain - gain.mean()) / (gain.std() + 1e-8)
    surrogate = jnp.minimum(ratio * gain, jnp.clip(ratio, 1 - clip, 1 + clip) * gain).mean()
    return 0.5 * ((mlp(params["critic"], seen)[:, 0] - target) ** 2).mean() - surrogate


def learner(config: Config, optimiser: Any, scales: Any) -> Callable[..., Any]:
    """Return the function of one iteration: parameters, optimiser's state, rollout, last view, order of samples."""

    def learn(params: Any, state: Any, rollout: Rollout, last: Any, order: Any) -> Any:
        count = config.envs * config.ticks
        x = normalised(rollout.features, *scales["actor"])
        seen = normalised(jnp.concatenate([rollout.seen, last[None]]), *scales["critic"])
        values = mlp(params["critic"], seen)[..., 0]
        gain = advantages(values, rollout.rewards, rollout.ends, config)
        before = log_density(mlp(params["actor"], x), params["log_std"], rollout.drawn)
        whole = (x, seen[:-1], rollout.drawn, before, gain, gain + values[:-1])
        whole = jax.tree.map(lambda a: a.reshape(count, *a.shape[2:]), whole)

        def minibatch(carry: Any, chosen: Any) -> Any:
            params, state = carry
            slopes = jax.grad(losses)(params, jax.tree.map(lambda a: a[chosen], whole), config.clip)
            updates, state = optimiser.update(slopes, state, params)
            return (optax.apply_updates(params, updates), state), None

        return jax.lax.scan(minibatch, (params, state), order)[0]

    return jax.jit(learn)


def actor(config: Config, scales: Any, rest: Any, tick_s: float) -> Callable[..., Any]:
    """Return the function of one tick: log std and layers, observations, memory, noise; to actions, view, memory."""
    pull = gains(config.taus_s, tick_s)

    def act(params: Any, o: Any, states: Any, averages: Any, fresh: Any, noise: Any) -> Any:
        x, averages = features(o, averages, fresh, pull, rest)
        drawn = mlp(params["actor"], normalised(x, *scales["actor"])) + jnp.exp(params["log_std"]) * noise
        return jnp.clip(rest + drawn, -1, 1), drawn, x, critic_view(x, o, states), averages

    return jax.jit(act)


class Trained(NamedTuple):
    """A policy, the seconds that went into each part of its training, and the reward per tick of each rollout."""

    policy: Policy
    seconds: dict[str, float]
    rewards: list[float]


class Trainer:
    """Flies, collects, learns."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.seconds: dict[str, float] = defaultdict(float)
        self.batches = Batches(config)
        self.rng = np.random.default_rng(config.seed)
        self.rest, self.tick_s = level(self.batches.sim.interface), self.batches.sim.tick_s
        inputs, w = width(len(config.taus_s)), config.width
        self.params: Any = {
            "actor": network(self.rng, [inputs, w, w, 4], 0.01),
            "critic": network(self.rng, [inputs + 12, w, w, 1], 0.01),
            "log_std": np.full(4, np.log(config.exploration), np.float32),
        }
        self.observations, self.states = self.batches.reset(int(self.rng.integers(1 << 40)))
        self.averages: Any = np.zeros((config.envs, len(config.taus_s), SIGNALS), np.float32)
        self.fresh = np.ones(config.envs, np.bool_)
        self.use({"actor": (0.0, 1.0), "critic": (0.0, 1.0)})

    def use(self, scales: Any) -> None:
        """Normalise with these means and standard deviations from now on."""
        self.scales = scales
        self.act = actor(self.config, scales, self.rest, self.tick_s)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Add the time of a block to that of a part."""
        start = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - start

    def reward(self, rewards: NDArray[np.float32], ends: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Return what is learned from: the task's reward, less the shaping, as shares of a discounted return."""
        c, off = self.config, self.states[:, 0:3] - self.observations[:, 16:19]
        turn = np.abs(self.states[:, 8] - self.observations[:, 19])
        shaping = c.per_metre * np.sqrt((off**2).sum(1)) + c.per_radian * turn
        return (1 - c.discount) * (rewards - np.where(ends, 0, shaping))

    def view(self, noise: NDArray[np.float32]) -> Any:
        """Return what the policy makes of the present, see `actor`."""
        return self.act(self.params, self.observations, self.states, self.averages, self.fresh, noise)

    def rollout(self) -> tuple[Rollout, Any, float]:
        """Fly; returns the rollout, the critic's view of what came after it, and the mean reward of the task."""
        c, ticks, paid = self.config, [], 0.0
        noise = self.rng.standard_normal((c.ticks, c.envs, 4), np.float32)
        for tick in range(c.ticks):
            with self.timed("network"):
                actions, drawn, x, seen, self.averages = self.view(noise[tick])
                actions = np.asarray(actions)
            with self.timed("simulation"):
                self.observations, self.states, rewards, self.fresh = self.batches.step(actions)
            ticks.append(Rollout(x, seen, drawn, self.reward(rewards, self.fresh), self.fresh))
            paid += float(rewards.mean()) / c.ticks
        with self.timed("network"):
            last = np.asarray(self.view(noise[0])[3])
            return Rollout(*(np.stack(part) for part in zip(*ticks, strict=True))), last, paid

    def restart(self) -> None:
        """Begin new flights here and there. A rollout ends with the critic's estimate, so nothing need be known of it."""
        chosen = self.rng.random(self.config.envs) < 1 / self.config.rollouts
        with self.timed("simulation"):
            self.observations, self.states = self.batches.restart(chosen)
        self.fresh = self.fresh | chosen

    def train(self, progress: bool = False) -> Trained:
        """Train from scratch; the first rollout, by a policy that knows nothing, decides how features are normalised."""
        c, rewards = self.config, []
        rollout, _, _ = self.rollout()
        pairs = {"actor": rollout.features, "critic": rollout.seen}
        self.use({name: (x.mean((0, 1)), np.maximum(x.std((0, 1)), 1e-2)) for name, x in pairs.items()})
        count = c.envs * c.ticks // c.minibatch
        steps = (c.iterations - 1) * c.epochs * count
        optimiser = optax.adam(optax.linear_schedule(c.learning_rate, 0.05 * c.learning_rate, steps), eps=1e-5)
        learn, state = learner(c, optimiser, self.scales), optimiser.init(self.params)
        for _ in tqdm(range(c.iterations - 1), unit="rollout", disable=not progress):
            self.restart()
            rollout, last, paid = self.rollout()
            rewards.append(paid)
            with self.timed("learning"):
                order = np.stack([self.rng.permutation(c.envs * c.ticks).astype(np.int32) for _ in range(c.epochs)])
                made = learn(self.params, state, rollout, last, order.reshape(-1, c.minibatch))
                self.params, state = jax.block_until_ready(made)
        layers = [(np.asarray(w), np.asarray(b)) for w, b in self.params["actor"]]
        return Trained(Policy(layers, *self.scales["actor"], c.taus_s, self.tick_s), dict(self.seconds), rewards)
