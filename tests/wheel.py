"""Uses what an installed wheel has, in an environment without anything else: environments, JAX, a server and its page,
simulated Crazyflies.

    python tests/wheel.py
"""

import contextlib
import subprocess
import sys
import urllib.request

import gymnasium
import jax
import jax.numpy as jnp

import crazyflie_gym
import crazyflie_gym.jax


@contextlib.contextmanager
def running(*words):
    """Run the program and give its first line; it is stopped afterwards."""
    command = [sys.executable, "-m", "crazyflie_gym", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline()
    finally:
        process.terminate()
        process.wait()


env = gymnasium.make("Crazyflie-v0")
pid = env.unwrapped.pid()
env.reset(seed=1)
total = 0.0
for _ in range(500):
    _, reward, terminated, _, _ = env.step(env.unwrapped.act(pid))
    total += float(reward)
assert total > 300 and not terminated, total

hover = crazyflie_gym.jax.make("Crazyflie-v0")
_, state = jax.jit(hover.reset)(jax.random.key(0))
_, state, _, done, _ = jax.jit(hover.step)(jax.random.key(1), state, jnp.zeros(4))
assert not done and float(hover.true_state(state)["pos_m"][2]) > 0.1

with running("serve", "--listen", "127.0.0.1:0", "--data", "bench.sqlite", "--log", "error") as line:
    address = line.split()[-1]
    with urllib.request.urlopen(f"http://{address}/", timeout=60) as page:
        assert b"<title>" in page.read()
    with urllib.request.urlopen(f"http://{address}/api/v1/scenarios", timeout=60) as scenarios:
        assert b"hover-aruco" in scenarios.read()

with running("cf2", "--port", "0") as line:
    assert "udp://127.0.0.1:" in line, line

print(f"crazyflie_gym {crazyflie_gym.__version__}: return {total:.0f} in an environment of its own")
