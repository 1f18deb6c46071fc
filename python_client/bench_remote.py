"""Environments on a server of this machine, over loopback: steps per second, round trips, many clients at once.

    python python_client/bench_remote.py            # the whole table
    python python_client/bench_remote.py --quick    # fewer and shorter repeats

Wall-clock time, with the server in a process of its own: both take part in it. Rates are medians of the repeats;
round trips are quantiles over all of them.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time

import gymnasium as gym
import numpy as np
from bench import hover_actions, load, processor

from crazyflie_gym.remote import Client

CLIENTS = 200
STEPS_OF_EACH = 100


class Server:
    """A server in a process of its own, with a database that is thrown away."""

    def __enter__(self):
        """Start it and learn its port."""
        self.folder = tempfile.TemporaryDirectory()
        command = [sys.executable, "-m", "crazyflie_gym", "serve", "--listen", "127.0.0.1:0", "--log", "warn"]
        command += ["--data", os.path.join(self.folder.name, "bench.sqlite")]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        return "ws://" + self.process.stdout.readline().split()[-1]

    def __exit__(self, *_):
        """Stop it."""
        self.process.terminate()
        self.process.communicate()
        self.folder.cleanup()


def rate(name, step, envs, repeats, seconds):
    """Print the rate of a step function without arguments."""
    rates = []
    for _ in range(repeats):
        calls, start = 0, time.perf_counter()
        while (took := time.perf_counter() - start) < seconds:
            step()
            calls += 1
        rates.append(calls * envs / took)
    spread = (max(rates) - min(rates)) / statistics.median(rates)
    print(f"{name:52s} {envs:6d} {statistics.median(rates) / 1e6:10.3f} M/s  +-{50 * spread:3.0f} %", flush=True)


def round_trips(name, step, repeats, seconds):
    """Print how long a step function without arguments takes."""
    times = []
    until = time.perf_counter() + repeats * seconds
    while (start := time.perf_counter()) < until:
        step()
        times.append(time.perf_counter() - start)
    median, p99, most = (1e6 * q for q in np.quantile(times, [0.5, 0.99, 1.0]))
    print(f"{name:52s} {median:9.0f} us median {p99:9.0f} us p99 {most:9.0f} us most of {len(times)}", flush=True)


def batches(url, options):
    """Measure batches in binary frames."""
    for count in (64, 1024, 4096):
        envs = gym.make_vec("Crazyflie-v0", count, remote=url)
        envs.reset(seed=0)
        actions = hover_actions(envs.unwrapped.interface, count)
        rate("binary", lambda envs=envs, actions=actions: envs.step(actions), count, *options)
        envs.close()
    envs = gym.make_vec("Crazyflie-v0", 64, remote=url).unwrapped
    envs.reset(seed=0)
    actions = np.repeat(hover_actions(envs.interface, 64)[np.newaxis], 32, axis=0)
    rate("binary, 64 envs, 32 ticks per frame", lambda: envs.step_many(actions), 64 * 32, *options)
    envs.close()


def singles(url, options):
    """Measure one environment, one step per frame, in binary and in JSON."""
    env = gym.make("Crazyflie-v0", remote=url, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    action = hover_actions(env.interface, 1)[0]

    def step():
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    round_trips("one environment, binary", step, *options)
    env.close()
    client = Client(url)
    client.ask("make", env="Crazyflie-v0")
    client.ask("reset", seed=0)
    row = action.tolist()
    round_trips("one environment, JSON", lambda: client.ask("step", action=row), *options)
    client.close()


def crowd(url):
    """Measure many clients with an environment each, all at the same time."""
    envs = [gym.make("Crazyflie-v0", remote=url, disable_env_checker=True).unwrapped for _ in range(CLIENTS)]
    ready, times, failures = threading.Barrier(CLIENTS + 1), [], []

    def fly(env, seed):
        action = hover_actions(env.interface, 1)[0]
        mine = []
        try:
            env.reset(seed=seed)
            ready.wait()
            for _ in range(STEPS_OF_EACH):
                start = time.perf_counter()
                _, _, terminated, truncated, _ = env.step(action)
                mine.append(time.perf_counter() - start)
                if terminated or truncated:
                    env.reset()
        except Exception as error:
            failures.append(error)
            ready.abort()
        times.extend(mine)

    threads = [threading.Thread(target=fly, args=(env, seed)) for seed, env in enumerate(envs)]
    for thread in threads:
        thread.start()
    ready.wait()
    start = time.perf_counter()
    for thread in threads:
        thread.join()
    took = time.perf_counter() - start
    for env in envs:
        env.close()
    median, p99 = (1e3 * q for q in np.quantile(times, [0.5, 0.99]))
    print(
        f"{CLIENTS} clients in as many threads: {len(times) / took:.0f} steps/s, "
        f"{median:.1f} ms median, {p99:.1f} ms p99, {len(failures)} errors {failures[:1] or ''}"
    )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    options = (3, 0.2) if parser.parse_args().quick else (7, 1.0)
    print(f"{processor()}, {os.cpu_count()} logical cores, load {load()}, loopback, no TLS")
    print(f"{options[0]} repeats of {options[1]} s; numpy {np.__version__}, gymnasium {gym.__version__}\n")
    with Server() as url:
        batches(url, options)
        singles(url, options)
        crowd(url)


if __name__ == "__main__":
    main()
