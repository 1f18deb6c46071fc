"""Environment steps per CPU-second through Python, beside Gymnasium's CartPole and, where it is installed, EnvPool's.

    python python_client/bench.py            # the whole table
    python python_client/bench.py --quick    # fewer and shorter repeats

CPU time, because it is what a step costs also while others use the machine; everything runs in one thread. A row is
the median of the repeats; its last column says how far the repeats lie apart. A step includes the automatic
resets, and returns new arrays unless the row says "buffers reused".
"""

import argparse
import os
import platform
import statistics
import time

import gymnasium as gym
import numpy as np

import crazyflie_gym

# the five of env/benches/step.rs
FIVE = {
    "camera_noise": {"xy_m": 0.004, "z_m": 0.008, "yaw_deg": 0.5},
    "ground_effect": 1.0,
    "drag_linear": 0.3,
    "cmd_delay": 0.03,
    "battery_sag": {"exponent": 1.0, "resistance_ohm": 0.1},
}
SIZES = (1024, 4096, 16384, 65536)
LIMIT = 500


def measure(name, step, envs, repeats, seconds):
    """Print the rate of a step function without arguments."""
    per_call = 1
    while True:  # so many calls between two looks at the clock that looking costs nothing
        start = time.process_time()
        for _ in range(per_call):
            step()
        if time.process_time() - start > 0.02:
            break
        per_call *= 2
    rates = []
    for _ in range(repeats):
        calls, start = 0, time.process_time()
        while (took := time.process_time() - start) < seconds:
            for _ in range(per_call):
                step()
            calls += per_call
        rates.append(calls * envs / took)
    spread = (max(rates) - min(rates)) / statistics.median(rates)
    print(f"{name:52s} {envs:6d} {statistics.median(rates) / 1e6:10.3f} M/s  +-{50 * spread:3.0f} %", flush=True)


def hover_actions(interface, count):
    """Small tilts to all sides with the weight carried: flights last, and still end at all times."""
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (count, 4)).astype(np.float32)
    pwm = interface.hover_lift > 0
    actions[:, 3] = 2 * interface.hover_lift / interface.lift_max - 1 if pwm else 2 * 0.7 / interface.lift_max - 1
    return actions


def resetting(env, action):
    """A step of a single environment that begins the next episode when one has ended."""
    step, reset = env.step, env.reset

    def one():
        _, _, terminated, truncated, _ = step(action)
        if terminated or truncated:
            reset()

    return one


def crazyflies(options):
    """Measure this package."""
    for label, kwargs in (("no effects", {}), ("five effects", {"effects": FIVE, "vertical": "pwm"})):
        made = gym.make("Crazyflie-v0", **kwargs)
        unchecked = gym.make("Crazyflie-v0", disable_env_checker=True, **kwargs)
        action = hover_actions(made.unwrapped.interface, 1)[0]
        singles = [("unwrapped", unchecked.unwrapped), ("make, no checker", unchecked), ("make", made)]
        for name, env in singles:
            env.reset(seed=0)
            measure(f"Crazyflie-v0, {label}, {name}", resetting(env, action), 1, *options)
    for label, kwargs in (("no effects", {}), ("five effects", {"effects": FIVE, "vertical": "pwm"})):
        for copy in (True, False):
            for count in SIZES:
                envs = gym.make_vec("Crazyflie-v0", count, copy=copy, max_episode_steps=LIMIT, **kwargs)
                envs.reset(seed=0)
                actions = hover_actions(envs.unwrapped.interface, count)
                for _ in range(LIMIT + 100):
                    envs.step(actions)
                name = f"Crazyflie-v0, {label}{'' if copy else ', buffers reused'}"
                measure(name, lambda envs=envs, actions=actions: envs.step(actions), count, *options)


def cart_poles(options):
    """Measure CartPole in the same run."""
    env = gym.make("CartPole-v1", disable_env_checker=True)
    for name, single in (("unwrapped", env.unwrapped), ("make, no checker", env)):
        env.reset(seed=0)
        measure(f"Gymnasium CartPole-v1, {name}", resetting(single, 1), 1, *options)
    for count in (1024, 16384):
        envs = gym.make_vec("CartPole-v1", count, vectorization_mode="vector_entry_point")
        envs.reset(seed=0)
        actions = np.arange(count) % 2
        measure(
            "Gymnasium CartPole-v1, make_vec", lambda envs=envs, actions=actions: envs.step(actions), count, *options
        )
    try:
        import envpool
    except (ImportError, OSError) as error:
        print(f'EnvPool ({error}) is left out; pip install "crazyflie-gym[bench]" brings it')
        return
    for count in (1, 1024, 16384):
        envs = envpool.make_gymnasium("CartPole-v1", num_envs=count, num_threads=1)
        envs.reset()
        actions = (np.arange(count) % 2).astype(np.int32)
        measure("EnvPool CartPole-v1, 1 thread", lambda envs=envs, actions=actions: envs.step(actions), count, *options)


def processor():
    """The processor's name."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            return next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    options = (3, 0.1) if parser.parse_args().quick else (7, 0.5)
    isa = crazyflie_gym.CrazyflieEnv().sim.isa
    print(f"{processor()}, {os.cpu_count()} logical cores, {platform.system()}, Python {platform.python_version()}")
    print(f"numpy {np.__version__}, gymnasium {gym.__version__}, instruction set {isa}, 1 thread, load {load()}")
    print(f"medians of {options[0]} repeats of {options[1]} s\n")
    print(f"{'':52s} {'envs':>6s} {'env steps':>10s} / CPU-s")
    crazyflies(options)
    cart_poles(options)


def load():
    """How busy the machine is."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


if __name__ == "__main__":
    main()
