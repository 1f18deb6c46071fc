"""Notebooks run, and environments, flights and rollouts show themselves in them."""

import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym
from common import LIMIT_S
from crazyflie_gym.evaluation import Scenario, Work, fly

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    # no folder of the user's is read or written
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    book = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in book.cells), "kept without outputs: they would go stale"
    nbclient.NotebookClient(
        book, timeout=LIMIT_S, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    shown = [output for cell in book.cells for output in cell.get("outputs", [])]
    pictures = sum("image/png" in output.get("data", {}) for output in shown)
    assert pictures >= 1 and shown, f"{path.name} shows no picture"


def test_an_environment_shows_its_task_and_its_picture():
    env = gym.make("Crazyflie-v0", effects={"drag_linear": 0.3}, render_mode="rgb_array").unwrapped
    assert env._repr_png_() is None and "img" not in env._repr_html_()
    env.reset(seed=0)
    assert env._repr_png_().startswith(b"\x89PNG")
    shown = env._repr_html_()
    assert "hover" in shown and "drag_linear" in shown and "data:image/png;base64," in shown
    assert "<script" not in shown


def test_what_is_shown_is_text_and_no_markup():
    env = crazyflie_gym.CrazyflieEnv(reward="1.0 if dist < 2 else 0.0")
    assert "dist &lt; 2" in env._repr_html_()


def test_a_batch_and_a_swarm_show_what_they_are():
    envs = gym.make_vec("Crazyflie-v0", num_envs=3, render_mode="rgb_array").unwrapped
    envs.reset(seed=0)
    assert ">3</td>" in envs._repr_html_() and envs._repr_png_().startswith(b"\x89PNG")
    plain = crazyflie_gym.CrazyflieVectorEnv(2)
    assert plain._repr_png_() is None and "CrazyflieVectorEnv" in plain._repr_html_()
    worlds = crazyflie_gym.CrazyflieSwarm(2, "swap")
    assert ">swap</td>" in worlds._repr_html_() and ">8</td>" in worlds._repr_html_()


def test_flights_and_rollouts_show_tables():
    flights = fly(Work(Scenario(ticks=20), "lqr", first_seed=0, count=5))
    assert isinstance(flights, list) and len(flights) == 5
    median = np.median([flight["rmse_m"] for flight in flights])
    shown = flights._repr_html_()
    assert f"{median:.4g}" in shown and "0 of 5" in shown
    assert "0 of 0" in type(flights)()._repr_html_()
    envs = crazyflie_gym.CrazyflieVectorEnv(6)
    envs.reset(seed=0)
    rollout = envs.rollout("lqr", 10)
    assert "10 steps of 6 flights" in rollout._repr_html_()
    assert f"{np.median(rollout.returns):.4g}" in rollout._repr_html_()
    assert "6 flights" in envs.rollout("lqr", 5, keep=())._repr_html_()


def test_the_version_is_that_of_the_distribution():
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", crazyflie_gym.__version__)
