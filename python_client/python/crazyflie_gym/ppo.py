"""Proximal policy optimisation (Schulman et al. 2017) in one file.

    python -m crazyflie_gym.ppo hover --out hover.safetensors

A policy begins as a linear fit of a regulator and learns on from there; the program ends with a comparison on unseen
flights of the benchmark's scenarios. Written for two processor cores: the simulator hardly costs anything, so batches
are large, networks small, and all that learns is one compiled function per iteration. The critic is asymmetric (Pinto
et al. 2018): it also sees the true state, which only the simulator knows. Needs the extra `train`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray
from scipy.stats import wilcoxon
from tqdm import tqdm

from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.policy import (
    LAYOUT,
    SIGNALS,
    Layers,
    Policy,
    features,
    gains,
    level,
    mlp,
    normalised,
    output,
    rotated,
    width,
)  # fmt: skip
from crazyflie_gym.spaces import STATE_FIELDS
from crazyflie_gym.training import LAB, RANDOMISED, TASKS, Batches, Config

if TYPE_CHECKING:
    from crazyflie_gym.benchmark import RobustnessRow


class Rollout(NamedTuple):
    """Ticks of all environments, arrays (ticks, envs, ...): features, critic's view, drawn outputs, rewards, ends."""

    features: Any
    seen: Any
    drawn: Any
    rewards: Any
    ends: Any


def critic_view(x: Any, observations: Any, states: Any) -> jax.Array:
    """Return features and the true state: position error and velocity along the heading, attitude, rates."""
    pos, velocity, attitude, rate = (states[..., at] for at in STATE_FIELDS.values())
    error, yaw = LAYOUT.split(observations)["setpoint"][..., :3] - pos, attitude[..., 2]
    return jnp.concatenate([x, rotated(error, yaw), rotated(velocity, yaw), attitude, rate], -1)


def network(rng: np.random.Generator, sizes: list[int], last: float) -> Layers:
    """Return orthogonal weights, those of the last layer scaled by `last`, and zero biases."""
    layers: Layers = []
    for i, (inputs, outputs) in enumerate(pairwise(sizes)):
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
    ratio = jnp.exp(log_density(output(params["actor"], params["skip"], x), params["log_std"], drawn) - before)
    gain = (gain - gain.mean()) / (gain.std() + 1e-8)
    surrogate = jnp.minimum(ratio * gain, jnp.clip(ratio, 1 - clip, 1 + clip) * gain).mean()
    error: jax.Array = 0.5 * ((mlp(params["critic"], seen)[:, 0] - target) ** 2).mean() - surrogate
    return error


def learner(config: Config, optimiser: Any) -> Callable[..., Any]:
    """Return one iteration, which gives new parameters and a new state of the optimiser."""

    def learn(params: Any, state: Any, scales: Any, rollout: Rollout, last: Any, order: Any) -> Any:
        count = config.envs * config.ticks
        x = normalised(rollout.features, *scales["actor"])
        seen = normalised(jnp.concatenate([rollout.seen, last[None]]), *scales["critic"])
        values = mlp(params["critic"], seen)[..., 0]
        gain = advantages(values, rollout.rewards, rollout.ends, config)
        before = log_density(output(params["actor"], params["skip"], x), params["log_std"], rollout.drawn)
        whole = (x, seen[:-1], rollout.drawn, before, gain, gain + values[:-1])
        whole = jax.tree.map(lambda a: a.reshape(count, *a.shape[2:]), whole)

        def minibatch(carry: Any, chosen: Any) -> Any:
            params, state = carry
            slopes = jax.grad(losses)(params, jax.tree.map(lambda a: a[chosen], whole), config.clip)
            updates, state = optimiser.update(slopes, state, params)
            return (optax.apply_updates(params, updates), state), None

        return jax.lax.scan(minibatch, (params, state), order)[0]

    return jax.jit(learn)


def actor(config: Config, rest: Any, tick_s: float) -> Callable[..., Any]:
    """Return one tick, which gives actions, outputs drawn, features, the critic's view and new averages."""
    pull = gains(config.taus_s, tick_s)

    def act(params: Any, scales: Any, o: Any, states: Any, averages: Any, fresh: Any, noise: Any) -> Any:
        x, averages = features(o, averages, fresh, pull, rest)
        mean = output(params["actor"], params["skip"], normalised(x, *scales["actor"]))
        drawn = mean + jnp.exp(params["log_std"]) * noise
        return jnp.clip(rest + drawn, -1, 1), drawn, x, critic_view(x, o, states), averages

    return jax.jit(act)


def reward(config: Config, observations: Any, states: Any, actions: Any, before: Any, ends: Any) -> Any:
    """Return what is learned from, as shares of a discounted return: 1 less a tick's costs (arrays of NumPy or JAX).

    Args:
        config: has the costs.
        observations: after the tick.
        states: the true ones then.
        actions: what was flown.
        before: the observations that it answered.
        ends: where the flight ended: in training only by a crash or by leaving the room.
    """
    c, setpoint = config, LAYOUT.split(observations)["setpoint"]
    off = states[:, STATE_FIELDS["pos_m"]] - setpoint[:, :3]
    turn = states[:, STATE_FIELDS["att_rad"]][:, 2] - setpoint[:, 3]
    turn = turn - 2 * np.pi * (turn / (2 * np.pi)).round()
    travel = abs(actions[:, :2] - LAYOUT.split(before)["last_action"][:, :2]).sum(1)
    square = (off**2).sum(1)
    # squared near the set-point and in proportion far away, so that a far start does not drown what hovering costs
    cost = c.per_metre * square / (square**0.5 + c.near_m) + c.per_square_radian * turn**2 + c.per_travel * travel
    return (1 - c.discount) * ((1 - ends) * (1 - cost) - ends * c.per_crash)


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
            "skip": np.zeros((inputs, 4), np.float32),
            "log_std": np.full(4, np.log(config.exploration), np.float32),
        }
        self.scales: Any = {
            name: (np.zeros(size, np.float32), np.ones(size, np.float32))
            for name, size in (("actor", inputs), ("critic", inputs + 12))
        }
        self.observations: Any
        self.states: Any
        self.observations, self.states = self.batches.reset(int(self.rng.integers(1 << 40)))
        self.averages: Any = np.zeros((config.envs, len(config.taus_s), SIGNALS), np.float32)
        self.fresh: Any = np.ones(config.envs, np.bool_)
        with self.timed("compiling"):
            act = actor(config, self.rest, self.tick_s)
            self.act: Any = act.lower(*self.view(np.zeros((config.envs, 4), np.float32))).compile()  # type: ignore[attr-defined]

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Add the time of a block to that of a part."""
        start = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - start

    def view(self, noise: NDArray[np.float32]) -> tuple[Any, ...]:
        """Return what `act` is called with."""
        return self.params, self.scales, self.observations, self.states, self.averages, self.fresh, noise

    def rollout(self) -> tuple[Rollout, Any, float]:
        """Fly; returns the rollout, the critic's view of the time after it, and the mean reward of the task."""
        c, ticks, paid = self.config, [], 0.0
        noise = self.rng.standard_normal((c.ticks, c.envs, 4), np.float32)
        for tick in range(c.ticks):
            with self.timed("network"):
                actions, drawn, x, seen, self.averages = self.act(*self.view(noise[tick]))
                actions, before = np.asarray(actions), self.observations
            with self.timed("simulation"):
                self.observations, self.states, rewards, self.fresh = self.batches.step(actions)
            rewarded = reward(c, self.observations, self.states, actions, before, self.fresh.astype(np.float32))
            ticks.append(Rollout(x, seen, drawn, rewarded.astype(np.float32), self.fresh))
            paid += float(rewards.mean()) / c.ticks
        with self.timed("network"):
            last = np.asarray(self.act(*self.view(noise[0]))[3])
            return Rollout(*(np.stack(part) for part in zip(*ticks, strict=True))), last, paid

    def restart(self) -> None:
        """Begin new flights here and there: a rollout ends with the critic's estimate, whatever follows it."""
        chosen = self.rng.random(self.config.envs) < 1 / self.config.rollouts
        with self.timed("simulation"):
            self.observations, self.states = self.batches.restart(chosen)
        self.fresh = self.fresh | chosen

    def order(self) -> NDArray[np.int32]:
        """Return which samples make up each minibatch: every sample once in each epoch."""
        c = self.config
        epochs = [self.rng.permutation(c.envs * c.ticks).astype(np.int32) for _ in range(c.epochs)]
        return np.stack(epochs).reshape(-1, c.minibatch)

    def imitate(self) -> None:
        """Begin as the controller that the configuration names: fly it, scale the features by what it saw, and fit the
        linear function to its actions by least squares, without those that are cut off.
        """
        c, seen, view, wanted = self.config, [], [], []
        for _ in range(c.imitated_ticks):
            with self.timed("simulation"):
                actions = self.batches.imitated_actions(self.fresh)
            noise = self.rng.standard_normal(actions.shape, np.float32)
            with self.timed("network"):
                _, _, x, critic, self.averages = self.act(*self.view(noise))
            seen.append(np.asarray(x))
            view.append(np.asarray(critic))
            wanted.append(actions)
            flown = np.clip(actions + c.exploration * noise, -1, 1)
            with self.timed("simulation"):
                self.observations, self.states, _, self.fresh = self.batches.step(flown)
        pairs = {"actor": np.concatenate(seen), "critic": np.concatenate(view)}
        self.scales = {name: (x.mean(0), np.maximum(x.std(0), 1e-2)) for name, x in pairs.items()}
        x, want = np.asarray(normalised(jnp.asarray(pairs["actor"]), *self.scales["actor"])), np.concatenate(wanted)
        for i, layer in enumerate(want.T):
            inside = np.abs(layer) < 0.98
            if inside.sum() > 10 * x.shape[1]:
                rows = np.concatenate([x[inside], np.ones((inside.sum(), 1), np.float32)], 1)
                fit = np.linalg.lstsq(rows, layer[inside] - self.rest[i], rcond=1e-6)[0]
                self.params["skip"][:, i] = fit[:-1]
                self.params["actor"][-1][1][i] = fit[-1]

    def train(self, progress: bool = False) -> Trained:
        """Train: imitate, then learn from what is flown."""
        c, rewards = self.config, []
        self.imitate()
        rollout, last, _ = self.rollout()
        steps = (c.iterations - 1) * c.epochs * (c.envs * c.ticks // c.minibatch)
        optimiser = optax.adam(optax.linear_schedule(c.learning_rate, 0.05 * c.learning_rate, steps), eps=1e-5)
        state = optimiser.init(self.params)
        with self.timed("compiling"):
            made = (self.params, state, self.scales, rollout, last, self.order())
            learn = learner(c, optimiser).lower(*made).compile()  # type: ignore[attr-defined]
        # mean of the last parameters (Polyak and Juditsky 1992): the score of a single set depends more on the seed
        mean, averaged = self.params, 0
        for i in tqdm(range(c.iterations - 1), unit="rollout", disable=not progress or None):
            self.restart()
            rollout, last, paid = self.rollout()
            rewards.append(paid)
            with self.timed("learning"):
                made = learn(self.params, state, self.scales, rollout, last, self.order())
                self.params, state = jax.block_until_ready(made)  # type: ignore[no-untyped-call, unused-ignore]
            if i >= (1 - c.averaged) * (c.iterations - 1):
                averaged += 1
                mean = optax.incremental_update(self.params, mean, 1 / averaged)
        self.params = mean
        return Trained(self.policy(), dict(self.seconds), rewards)

    def policy(self) -> Policy:
        """Return the policy as it is now."""
        layers = [(np.asarray(w), np.asarray(b)) for w, b in self.params["actor"]]
        mean, std = self.scales["actor"]
        return Policy(layers, np.asarray(self.params["skip"]), mean, std, self.config.taus_s, self.tick_s)


RIVALS = ("thesis-pid", "velocity", "lqr")
SCENARIOS = {"hover": ("hover-aruco", "fly-80cm", "ground-landing"), "track": ("figure-eight",)}


def comparison(task: str, file: str, seeds: int = 128) -> list[RobustnessRow]:
    """Return what a policy's file and its rivals are worth in scenarios of the benchmark, on unseen seeds.

    Args:
        task: what the policy was trained for, one of `SCENARIOS`.
        file: where it is.
        seeds: flights of each.

    Raises:
        ImportError: where the benchmark is not built in.
    """
    from crazyflie_gym.benchmark import robustness

    flown = robustness([*RIVALS, f"policy:{file}"], SCENARIOS[task], seeds=seeds)
    return [row for row in flown if row["condition"] == "nominal"]


class PairedRow(TypedDict):
    """A controller on unseen flights: mean reward of a tick, median RMS error, flights that failed, and the p value of
    Wilcoxon's signed-rank test: how often equals would show as clear a lead of the policy; `None` for the policy."""

    controller: str
    reward: float
    rmse_m: float
    failed: int
    p_value: float | None


def paired(config: Config, file: str, first_seed: int = 2 * 10**9, seeds: int = 100) -> list[PairedRow]:
    """Return a policy and its rivals, each on the same unseen flights of the first task it was trained for.

    Args:
        config: of the training; the controller that it imitated is a rival with those options too.
        file: the policy.
        first_seed: of the flights.
        seeds: flights of each.
    """
    task, arguments = config.flown[0]
    scenario = Scenario(task, effects=config.effects, task_options=arguments["task_options"])
    imitated = (f"{config.imitated}, as imitated", config.imitated, config.imitated_options)
    rivals: list[tuple[str, str, dict[str, float]]] = [(name, name, {}) for name in (*RIVALS, "mpc")]
    ours: Any = None
    rows: list[PairedRow] = []
    for name, controller, options in [("policy", f"policy:{file}", {}), *rivals, imitated]:
        flights = fly(Work.of(scenario, controller, first_seed, seeds, **options))
        rewards = np.array([flight["reward"] for flight in flights])
        ours = rewards if ours is None else ours
        p_value = None if ours is rewards else float(wilcoxon(ours, rewards, alternative="greater").pvalue)
        failed = sum(flight["failed"] for flight in flights)
        rows.append(PairedRow(
            controller=name,
            reward=float(rewards.mean()),
            rmse_m=median(flights, "rmse_m"),
            failed=failed,
            p_value=p_value,
        ))  # fmt: skip
    return rows


def paired_table(rows: list[PairedRow]) -> str:
    """Return rows of `paired` as text."""
    lines = [f"{'unseen flights':24s} reward  RMS error, cm  failed  p"]
    for row in rows:
        p = "" if row["p_value"] is None else f"{row['p_value']:.1e}"
        lines.append(
            f"{row['controller']:24s} {row['reward']:6.3f} {100 * row['rmse_m']:14.1f} {row['failed']:7d}  {p}".rstrip()
        )
    return "\n".join(lines)


def compare_policy(task: str, config: Config, file: str) -> tuple[list[Any], str]:
    """Return rows that compare a policy on unseen flights, of the benchmark where it has the task, and their table."""
    if task not in SCENARIOS:
        rows = paired(config, file)
        return rows, paired_table(rows)
    try:
        scored = comparison(task, file)
    except ImportError as error:
        print(f"no comparison: {error}", file=sys.stderr)
        return [], ""
    lines = [f"{'unseen flights':16s} {'controller':24s} score  RMS error, cm  failed"]
    for row in scored:
        error_cm = "-" if row["rmse_m"] is None else f"{100 * row['rmse_m']:.1f}"
        figures = f"{row['score']:5.1f} {error_cm:>14s} {row['failed']:7d}"
        lines.append(f"{row['scenario']:16s} {row['controller']:24s} {figures}")
    return scored, "\n".join(lines)


def main() -> None:
    """Train, print the time of each part, and compare."""
    start = time.perf_counter()
    parser = argparse.ArgumentParser(description="Train a policy: crazyflie fly --controller policy:FILE flies it.")
    parser.add_argument(
        "task",
        choices=TASKS,
        help="hover over the marker, follow moving set-points too, or a fast figure eight by late commands",
    )
    parser.add_argument("--out", default="policy.safetensors", metavar="FILE")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--randomised", action="store_true", help="another vehicle on another day in every flight")
    parser.add_argument("--json", action="store_true", help="for machines")
    args = parser.parse_args()
    config = dataclasses.replace(TASKS[args.task], seed=args.seed)
    if args.randomised:
        # more to be learned takes longer
        own = {name: value for name, value in config.effects.items() if name not in LAB}
        config = dataclasses.replace(config, effects=RANDOMISED | own, iterations=2 * config.iterations)
    trained = Trainer(config).train(progress=not args.json)
    trained.policy.save(args.out, json.dumps(dataclasses.asdict(config)))
    whole = time.perf_counter() - start
    seconds = trained.seconds | {"rest": whole - sum(trained.seconds.values()), "whole": whole}
    ticks = config.iterations * config.envs * config.ticks
    rows, table = compare_policy(args.task, config, args.out)
    if args.json:
        print(json.dumps({"seconds": seconds, "ticks": ticks, "rewards": trained.rewards, "comparison": rows}))
        return
    print(f"{ticks / 1e6:.1f} M ticks, reward {trained.rewards[0]:.2f} to {trained.rewards[-1]:.2f}: {args.out}")
    print("seconds: " + ", ".join(f"{part} {spent:.1f}" for part, spent in seconds.items()))
    print(table)


if __name__ == "__main__":
    main()
