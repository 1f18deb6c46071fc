"""The examples and the page of `crazyflie_gym.jax` run, and do what they say. Needs the extras `jax` and `train`."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from common import LIMIT_S

pytest.importorskip("jax", reason="JAX is not installed (extra jax): its examples are not tested")

ROOT = Path(__file__).parents[2]


def run(example, *options, cwd):
    """Run an example and return what it prints."""
    command = [sys.executable, str(ROOT / "examples" / example), *options]
    # little is flown: XLA compiles in half the time where it optimises less
    quick = os.environ | {"XLA_FLAGS": "--xla_backend_optimization_level=1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=2 * LIMIT_S, env=quick)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def figures(printed, row):
    """The numbers of a row of a table."""
    (line,) = [line for line in printed.splitlines() if line.startswith(row)]
    return [float(number) for number in re.findall(r"(?<![\w.])-?\d+\.?\d*", line.removeprefix(row))]


def test_the_gradient_of_a_distance_trains_a_policy(tmp_path):
    printed = run("jax_hover_bptt.py", "--iterations", "20", cwd=tmp_path)
    (before, far_cm, _), (after, near_cm, failed) = (figures(printed, name) for name in ("untrained", "trained"))
    # a seventh of the training; a vehicle that stays where it begins is 50 to 60 cm off
    assert after > 2 * before and near_cm < 0.6 * far_cm and failed == 0, printed


def test_drag_is_found_on_flights_that_the_fit_has_not_seen(tmp_path):
    printed = run("jax_identify.py", "--iterations", "80", cwd=tmp_path)
    (before_m, before_mps, _, _), (after_m, after_mps, _, _) = (
        figures(printed, name) for name in ("data sheet", "and effects")
    )
    # NaN fails as well
    assert after_mps < 0.5 * before_mps and after_m < 0.5 * before_m, printed
    drag_ps = float(re.search(r"^drag ([\d.]+) 1/s", printed, re.MULTILINE)[1])
    # least squares of the motion capture's accelerations over the same four flights give 0.34 to 0.53 1/s for each axis
    assert 0.3 < drag_ps < 0.6, printed


def test_ppo_is_one_function_whose_policy_the_core_flies(tmp_path):
    printed = run("jax_ppo.py", "hover", "--iterations", "2", "--envs", "512", cwd=tmp_path)
    assert (tmp_path / "jax_ppo.safetensors").exists()
    rows = {row[:24].strip(): row[24:].split() for row in printed.split("unseen flights")[1].splitlines()[1:7]}
    # two rollouts teach nothing: it is the regulator that it imitated; the table is of real flights
    assert float(rows["policy"][0]) == pytest.approx(float(rows["lqr, as imitated"][0]), abs=0.03), printed
    assert 0.7 < float(rows["thesis-pid"][0]) < 0.85 and float(rows["thesis-pid"][3]) < 0.01, printed


def test_the_code_of_the_page_runs(capsys):
    page = (ROOT / "docs/jax.md").read_text()
    blocks = [block.split("```")[0] for block in page.split("```python\n")[1:]]
    assert len(blocks) == 8
    names = {}
    for block in blocks:
        exec(compile(block, "docs/jax.md", "exec"), names)
    assert float(names["worst"]) < 1e-4
    assert abs(names["slopes"]).max() > 0
    assert "largest difference" in capsys.readouterr().out
