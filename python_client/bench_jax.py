"""Environment steps per second of `crazyflie_gym.jax`, beside the Rust core in the same run.

    python python_client/bench_jax.py                  # the whole table
    python python_client/bench_jax.py --quick          # fewer and shorter repeats
    python python_client/bench_jax.py --accelerator    # three sizes, scan and kernel, in under six minutes
    python python_client/bench_jax.py --crazyflow ENV/bin/python    # and crazyflow, of an environment that has it

A row is the median of the repeats, by the clock on the wall; repeats of the simulators take turns, so that all meet
the same load. All flights go on: observations, rewards, ends and automatic resets are computed in every step. Kernels
and bytes are read from the compiled program, see `program_cost.py`; operations are those of the program as it is
written. Needs the extra `jax`.
"""

import argparse
import functools
import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import jax
import jax.numpy as jnp
from bench import FIVE, LIMIT, hover_actions, load, processor
from program_cost import program_cost

import crazyflie_gym.jax

OPTIONS: dict[str, dict[str, Any]] = {"no effects": {}, "five effects": {"effects": FIVE, "vertical": "pwm"}}
TICK_S = 0.02
THREADS = 2
SWEPT_BYTES = 1 << 28
SWEEPS = 10
SIZES = (65536, 262144, 1048576)


class Flight(NamedTuple):
    """A function that flies all environments some ticks on, and what its program costs a step."""

    once: Callable[[], None]
    compiling_s: float
    kernels: float
    moved: float
    operations: float


def compiled(function, *arguments, **options):
    """Return the compiled function, and the seconds that it took."""
    start = time.perf_counter()
    made = jax.jit(function, **options).lower(*arguments).compile()
    return made, time.perf_counter() - start


def recorded_flight(kwargs, envs, ticks, fused):
    """Return the flight of a recorded environment: the kernel's with a table of actions, or one of steps."""
    env = crazyflie_gym.jax.make("Crazyflie-v0", max_episode_steps=LIMIT, **kwargs)
    interface = gym.make("Crazyflie-v0", **kwargs).unwrapped.interface
    actions = jnp.asarray(hover_actions(interface, envs))
    key = jax.random.key(1)
    begin, _ = compiled(functools.partial(env.reset, num_envs=envs), jax.random.key(0))
    observation, state = begin(jax.random.key(0))

    def by_steps(carry, actions):
        def tick(carry, _):
            state, _, paid = carry
            observation, state, reward, _, _ = env.step(key, state, actions)
            # the observation is carried: what nobody takes, XLA does not compute
            return (state, observation, paid + reward), None

        return jax.lax.scan(tick, carry, None, length=ticks)[0]

    def by_kernel(carry, actions):
        state, observation, paid = carry
        observation, state, rewards, _ = env.fly(key, observation, state, actions, fused=True)
        return state, observation, paid + rewards

    carry = (state, observation, jnp.zeros(envs))
    given = jnp.broadcast_to(actions, (ticks, *actions.shape)) + 0 if fused else actions
    flight, seconds = compiled(by_kernel if fused else by_steps, carry, given, donate_argnums=0)
    cost = program_cost(flight)
    step = jax.jit(env.step).lower(key, state, actions).cost_analysis() or {}
    at = [carry]

    def once():
        at[0] = jax.block_until_ready(flight(at[0], given))

    steps = ticks * envs
    return Flight(once, seconds, cost.kernels / ticks, cost.moved / steps, step.get("flops", 0) / envs)


def core_flight(kwargs, envs, ticks):
    """Return a function that flies the Rust core's environments so many ticks on."""
    made = gym.make_vec("Crazyflie-v0", envs, copy=False, threads=THREADS, max_episode_steps=LIMIT, **kwargs)
    made.reset(seed=0)
    actions = hover_actions(made.unwrapped.interface, envs)

    def once():
        for _ in range(ticks):
            made.step(actions)

    return once


def seconds_of(function):
    """Return how long a call takes."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def best_rate(function, start, amount, repeats):
    """Return the amount per second of the best call; each takes what the last one returned."""
    call, _ = compiled(function, start, donate_argnums=0)
    seconds = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        start = jax.block_until_ready(call(start))
        seconds.append(time.perf_counter() - begin)
    return amount / min(seconds)


def copy_bandwidth(repeats):
    """Return bytes read and written per second in sweeps over more than a cache holds."""
    # in place: new pages would have to be fetched from the system first
    sweep = functools.partial(jax.lax.fori_loop, 0, SWEEPS, lambda _, x: x + 1)
    return best_rate(sweep, jnp.zeros(SWEPT_BYTES // 4), 2 * SWEPT_BYTES * SWEEPS, repeats)


def compute_rate(repeats):
    """Return additions and multiplications per second, as many of each, in chains that need no memory."""
    length, count, side_by_side = 32, SWEPT_BYTES // 64, 8

    def chains(_, x):
        row = [x + i for i in range(side_by_side)]
        for _ in range(length):
            row = [x * 0.5 + 0.25 for x in row]
        return sum(row)

    sweep = functools.partial(jax.lax.fori_loop, 0, SWEEPS, chains)
    return best_rate(sweep, jnp.zeros(count), 2 * length * side_by_side * count * SWEEPS, repeats)


def compare(label, kwargs, sizes, repeats, bounds, kernel):
    """Print the rows of both simulators, the kernel's where it is compiled, and return the best of their rates."""
    envs, ticks = sizes
    flights = {"JAX, steps": recorded_flight(kwargs, envs, ticks, fused=False)}
    if kernel:
        flights["JAX, one kernel"] = recorded_flight(kwargs, envs, ticks, fused=True)
    calls = {name: flight.once for name, flight in flights.items()}
    calls[f"Rust, {THREADS} threads"] = core_flight(kwargs, envs, ticks)
    # until episodes end at all times
    for call in calls.values():
        for _ in range(LIMIT // ticks + 1):
            call()
    rounds = [[seconds_of(call) for call in calls.values()] for _ in range(repeats)]
    rates = {
        name: [envs * ticks / seconds for seconds in own]
        for name, own in zip(calls, zip(*rounds, strict=True), strict=True)
    }
    for name, own in rates.items():
        middle = statistics.median(own)
        spread = 50 * (max(own) - min(own)) / middle
        print(f"{label:13s} {name:16s} {middle / 1e6:9.2f} M steps/s +-{spread:3.0f} %,", end=" ")
        print(f"{TICK_S * middle / 1e6:.3f} M simulated s/s", flush=True)
    for name, flight in flights.items():
        rate, (bandwidth, computing) = statistics.median(rates[name]), bounds
        ratio = statistics.median(a / b for a, b in zip(rates[name], list(rates.values())[-1], strict=True))
        print(f"{label:13s} {name:16s} {ratio:.2f} of Rust; compiled in {flight.compiling_s:.1f} s;", end=" ")
        print(f"{flight.kernels:.2f} kernels and {flight.moved:.0f} bytes a step,", end=" ")
        print(f"{100 * rate * flight.moved / bandwidth:.0f} % of what memory carries;", end=" ")
        print(f"{flight.operations:.0f} operations, {100 * rate * flight.operations / computing:.0f} % of the most")
    print(flush=True)
    return max(statistics.median(own) for own in rates.values())


# the attitude part of its `benchmark/main.py`: first principles, 500 Hz; one call for many steps is its fastest way
CRAZYFLOW = """
import json, sys, time
from importlib.metadata import version
import jax, jax.numpy as jnp
from crazyflow.sim import Sim
worlds, steps, calls = (int(word) for word in sys.argv[1:])
sim = Sim(n_worlds=worlds, n_drones=1, dynamics="first_principles", control="attitude", freq=500, attitude_freq=500,
          device=jax.devices()[0].platform)
command = jnp.zeros((worlds, 1, 4)).at[:, 0, 0].set(1)
def fly():
    start = time.perf_counter()
    sim.attitude_control(command)
    sim.step(steps)
    jax.block_until_ready(sim.data)
    return time.perf_counter() - start
sim.reset()
compiling = fly()
fly()
seconds = sorted(fly() for _ in range(calls))[calls // 2]
print(json.dumps({"version": version("crazyflow"), "compiling": compiling, "rate": worlds * steps / seconds,
                  "tick_s": 1 / sim.freq}))
"""


def crazyflow(python, envs, steps, calls, ours):
    """Print the rate of crazyflow in another environment, and how it compares with the best of ours."""
    if python is None:
        print("crazyflow is left out; --crazyflow ENV/bin/python flies it where `pip install crazyflow` was run")
        return
    # MuJoCo leaves a log where it runs
    with tempfile.TemporaryDirectory() as folder:
        # by a path that holds from another folder too
        place = os.path.abspath(shutil.which(python) or python)
        command = [place, "-c", CRAZYFLOW, *(str(number) for number in (envs, steps, calls))]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        print(f"crazyflow did not run: {done.stderr.strip().splitlines()[-1]}")
        return
    told = json.loads(done.stdout.splitlines()[-1])
    rate, tick_s = told["rate"], told["tick_s"]
    print(f"crazyflow {told['version']}, first principles, attitude, {steps} steps a call, {envs} worlds:", end=" ")
    print(f"{rate / 1e6:.2f} M steps/s of {1000 * tick_s:g} ms, {rate * tick_s / 1e6:.3f} M simulated s/s;", end=" ")
    print(f"first call {told['compiling']:.1f} s")
    print(f"ours, of it: {ours / rate:.2f} of the steps, {ours * TICK_S / (rate * tick_s):.1f} of the simulated time\n")


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--accelerator", action="store_true")
    parser.add_argument("--envs", type=int, default=SIZES[0])
    parser.add_argument("--crazyflow", metavar="PYTHON", help="of an environment that has crazyflow")
    args = parser.parse_args()
    ticks, repeats = (10, 3) if args.quick else (50, 9)
    device = jax.devices()[0]
    print(f"{device.device_kind}; {processor()}, {os.cpu_count()} logical cores; JAX {jax.__version__}, load {load()}")
    bounds = copy_bandwidth(repeats), compute_rate(repeats)
    print(f"memory reads and writes {bounds[0] / 1e9:.1f} GB/s, {bounds[1] / 1e12:.3f} T operations/s; steps of 20 ms")
    print(f"medians of {repeats} repeats of {ticks} steps\n")
    for envs in SIZES if args.accelerator else (args.envs,):
        print(f"{envs} environments")
        kernel = device.platform == "gpu"
        best = [compare(label, kwargs, (envs, ticks), repeats, bounds, kernel) for label, kwargs in OPTIONS.items()]
        crazyflow(args.crazyflow, envs, 10 * ticks, 3 if args.quick else 5, best[0])


if __name__ == "__main__":
    main()
