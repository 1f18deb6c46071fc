#!/bin/sh
# The core alone, built without its optional parts and put into an environment of its own: it flies, it trains, and it
# says which part is missing. Takes the folder of the virtual environment, and a folder for the wheel.
set -eu
BIN=$1
OUT=$2
SOURCE=$(pwd)
rm -rf "$OUT"
"$BIN/maturin" build --quiet --profile dev --no-default-features --out "$OUT"
"$BIN/python" -m venv "$OUT/core"
"$BIN/uv" pip install --quiet --python "$OUT/core/bin/python" "$(ls "$OUT"/*.whl)[train]"
cd "$OUT"
core/bin/python - << 'PYTHON'
import dataclasses
import importlib

import gymnasium
import numpy as np

import crazyflie_gym
from crazyflie_gym._native import PARTS
from crazyflie_gym.ppo import TASKS, Trainer, comparison

assert not any(dict(PARTS).values()), PARTS
env = gymnasium.make("Crazyflie-v0")
pid = env.unwrapped.pid()
row, _ = env.reset(seed=1)
total = 0.0
for _ in range(500):
    row, reward, terminated, truncated, _ = env.step(pid.act(row))
    total += float(reward)
assert total > 300 and not terminated, total
trained = Trainer(dataclasses.replace(TASKS["hover"], iterations=8, envs=512)).train(progress=False)
assert np.isfinite(trained.rewards).all(), trained.rewards
trained.policy.save("hover.safetensors")


def missing(part, use):
    """Asserts that a use of what is left out names the part, and how to get it."""
    try:
        use()
    except ImportError as error:
        assert f"without the part '{part}'" in str(error) and "pip install" in str(error), error
    else:
        raise AssertionError(f"{part} is here")


for module, part in {"benchmark": "bench", "deploy": "crazyflies", "jax": "jax"}.items():
    missing(part, lambda module=module: importlib.import_module(f"crazyflie_gym.{module}"))
missing("bench", lambda: comparison("hover", "hover.safetensors"))
print(f"crazyflie_gym {crazyflie_gym.__version__}, the core alone: return {total:.0f}, reward {trained.rewards[-1]:.2f}")
PYTHON
core/bin/crazyflie fly --task hover --controller policy:hover.safetensors --runs 4
core/bin/crazyflie --help > help.txt
for verb in bench cf2 deploy export; do
    if grep -qE "^  (crazyflie )?$verb " help.txt; then echo "crazyflie --help lists $verb"; exit 1; fi
    if core/bin/crazyflie "$verb" 2> said.txt; then echo "crazyflie $verb runs"; exit 1; fi
    grep -q "unrecognized subcommand" said.txt
done
if core/bin/crazyflie replay "$SOURCE/logs/tests/data/nanobench_start.csv.gz" 2> said.txt; then echo "a reader of a lab is here"; exit 1; fi
grep -q "build with the feature labs" said.txt
