"""Environment steps per second of `crazyflie_gym.jax`, beside the Rust core in the same run.

    python python_client/bench_jax.py            # the whole table
    python python_client/bench_jax.py --quick    # fewer and shorter repeats
    python python_client/bench_jax.py --crazyflow ENV/bin/python    # and crazyflow, of an environment that has it

A row is the median of the repeats, by the clock on the wall; repeats of both simulators take turns, so that both meet
the same load. All flights go on: observations, rewards, ends and automatic resets are computed in every step. Needs
the extra `jax`.
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

import gymnasium as gym
import jax
import jax.numpy as jnp
from bench import FIVE, LIMIT, hover_actions, load, processor

import crazyflie_gym.jax

OPTIONS = {"no effects": {}, "five effects": {"effects": FIVE, "vertical": "pwm"}}
THREADS = 2
SWEPT_BYTES = 1 << 28


def compiled(function, *arguments):
    """Return the compiled function, and the seconds that it took."""
    start = time.perf_counter()
    made = jax.jit(function).lower(*arguments).compile()
    return made, time.perf_counter() - start


def recorded_flight(kwargs, envs, ticks):
    """Return a function that flies all environments some ticks on, the seconds of compiling, and bytes per step."""
    env = crazyflie_gym.jax.make("Crazyflie-v0", max_episode_steps=LIMIT, **kwargs)
    interface = gym.make("Crazyflie-v0", **kwargs).unwrapped.interface
    actions = jnp.asarray(hover_actions(interface, envs))
    key = jax.random.key(1)
    begin, _ = compiled(functools.partial(env.reset, num_envs=envs), jax.random.key(0))
    observation, state = begin(jax.random.key(0))

    def fly(carry):
        def tick(carry, _):
            state, _, paid = carry
            observation, state, reward, _, _ = env.step(key, state, actions)
            # the observation is carried: what nobody takes, XLA does not compute
            return (state, observation, paid + reward), None

        return jax.lax.scan(tick, carry, None, length=ticks)[0]

    carry = (state, observation, jnp.zeros(envs))
    flight, seconds = compiled(fly, carry)
    state_bytes = sum(leaf.nbytes for leaf in jax.tree.leaves(carry))
    # state and sum are read and written, actions read, the observation written
    moved = 2 * state_bytes - observation.nbytes + actions.nbytes
    at = [carry]

    def once():
        at[0] = jax.block_until_ready(flight(at[0]))

    return once, seconds, moved / envs


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


def copy_bandwidth(repeats):
    """Return bytes read and written per second by the best of some sweeps over more than a cache holds."""
    numbers = jnp.zeros(SWEPT_BYTES // 4)
    # in place: new pages would have to be fetched from the system first
    sweep = jax.jit(lambda x: x + 1, donate_argnums=0)
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        numbers = jax.block_until_ready(sweep(numbers))
        seconds.append(time.perf_counter() - start)
    return 2 * SWEPT_BYTES / min(seconds)


def compare(label, kwargs, envs, ticks, repeats, bandwidth):
    """Print the rows of both simulators."""
    ours, compiling, moved = recorded_flight(kwargs, envs, ticks)
    core = core_flight(kwargs, envs, ticks)
    # until episodes end at all times
    for _ in range(LIMIT // ticks + 1):
        ours()
        core()
    pairs = [(seconds_of(ours), seconds_of(core)) for _ in range(repeats)]
    rates = [[envs * ticks / seconds for seconds in side] for side in zip(*pairs, strict=True)]
    for name, side in zip(("JAX", f"Rust, {THREADS} threads"), rates, strict=True):
        middle = statistics.median(side)
        spread = 50 * (max(side) - min(side)) / middle
        print(f"{label:13s} {name:16s} {middle / 1e6:9.2f} M steps/s  +-{spread:3.0f} %", flush=True)
    ratio = statistics.median(a / b for a, b in zip(*rates, strict=True))
    share = statistics.median(rates[0]) * moved / bandwidth
    print(f"{label:13s} JAX over Rust {ratio:.2f}; compiled in {compiling:.1f} s;", end=" ")
    print(f"{moved:.0f} bytes per step, {100 * share:.0f} % of what memory carries\n", flush=True)


# as the attitude part of its `benchmark/main.py` flies it: first principles, 500 Hz, one call for each step
CRAZYFLOW = """
import json, sys, time
from importlib.metadata import version
import jax, jax.numpy as jnp
from crazyflow.sim import Sim
worlds, steps = int(sys.argv[1]), int(sys.argv[2])
sim = Sim(n_worlds=worlds, n_drones=1, dynamics="first_principles", control="attitude", freq=500, attitude_freq=500,
          device=jax.devices()[0].platform)
command = jnp.zeros((worlds, 1, 4)).at[0, 0, 0].set(1)
def fly():
    start = time.perf_counter()
    sim.attitude_control(command)
    sim.step(sim.freq // sim.control_freq)
    jax.block_until_ready(sim.data)
    return time.perf_counter() - start
sim.reset()
compiling = fly()
seconds = sum(fly() for _ in range(steps))
print(json.dumps({"version": version("crazyflow"), "compiling": compiling, "rate": worlds * steps / seconds,
                  "tick_s": 1 / sim.control_freq}))
"""


def crazyflow(python, envs, steps):
    """Print the rate of crazyflow in another environment."""
    if python is None:
        print("crazyflow is left out; --crazyflow ENV/bin/python flies it where `pip install crazyflow` was run")
        return
    # MuJoCo leaves a log where it runs
    with tempfile.TemporaryDirectory() as folder:
        # by a path that holds from another folder too
        command = [os.path.abspath(shutil.which(python) or python), "-c", CRAZYFLOW, str(envs), str(steps)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        print(f"crazyflow did not run: {done.stderr.strip().splitlines()[-1]}")
        return
    told = json.loads(done.stdout.splitlines()[-1])
    rate, tick_s = told["rate"], told["tick_s"]
    print(
        f"crazyflow {told['version']}, first principles, attitude: {rate / 1e6:.2f} M steps/s of {1000 * tick_s:g} ms,"
    )
    print(f"{rate * tick_s / 1e6:.3f} M simulated s/s; first call {told['compiling']:.1f} s")


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--envs", type=int, default=65536)
    parser.add_argument("--crazyflow", metavar="PYTHON", help="of an environment that has crazyflow")
    args = parser.parse_args()
    ticks, repeats = (10, 3) if args.quick else (50, 9)
    device = jax.devices()[0]
    print(f"{device.device_kind}; {processor()}, {os.cpu_count()} logical cores; JAX {jax.__version__}, load {load()}")
    bandwidth = copy_bandwidth(repeats)
    print(f"a sweep reads and writes {bandwidth / 1e9:.1f} GB/s; {args.envs} environments, steps of 20 ms")
    print(f"medians of {repeats} repeats of {ticks} steps\n")
    for label, kwargs in OPTIONS.items():
        compare(label, kwargs, args.envs, ticks, repeats, bandwidth)
    crazyflow(args.crazyflow, args.envs, 10 if args.quick else 100)


if __name__ == "__main__":
    main()
