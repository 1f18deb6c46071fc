"""Evaluation is a pure function; results are in the store once, whichever machine died meanwhile."""

import sqlite3
from collections import Counter

import gymnasium as gym
import numpy as np
import pytest

from cluster import losing_a_node
from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.sweep import Store, run, split

SCENARIO = Scenario(ticks=150, effects={"camera": 1, "camera_noise": {"xy_m": 0.01}, "gust": 0.5})


def test_a_flight_does_not_depend_on_how_seeds_are_split():
    whole = fly(Work.of(SCENARIO, "thesis-pid", 0, 40))
    parts = fly(Work.of(SCENARIO, "thesis-pid", 0, 17)) + fly(Work.of(SCENARIO, "thesis-pid", 17, 23))
    assert whole == parts and [flight["seed"] for flight in whole] == list(range(40))
    assert len({flight["rmse_m"] for flight in whole}) == 40


def test_figures_are_those_of_a_flight():
    """FlightOutcome once more by Gymnasium's single environment, and counted by hand."""
    flight = fly(Work.of(SCENARIO, "thesis-pid", 5, 1))[0]
    options = {"vertical": "pwm", "effects": SCENARIO.effects, "true_state": True, "max_episode_steps": -1}
    env = gym.make("Crazyflie-v0", form="dict", **options)
    pid = env.unwrapped.pid()
    seen, info = env.reset(seed=5)
    rewards, squares, travel = [], [], 0.0
    for _ in range(SCENARIO.ticks):
        squares.append(np.sum((info["true_state"][:3] - seen["setpoint"][:3]).astype(float) ** 2))
        before, action = seen["last_action"], env.unwrapped.act(pid)
        travel += np.abs(action[:2] - before[:2]).sum()
        seen, reward, _, _, info = env.step(action)
        rewards.append(reward)
    assert np.isclose(flight["reward"], np.mean(rewards)) and np.isclose(flight["rmse_m"], np.sqrt(np.mean(squares)))
    assert np.isclose(flight["travel_degps"], 10 * travel / (SCENARIO.ticks * 0.02)) and not flight["failed"]


def test_an_early_end_counts_as_failed():
    away = Scenario(ticks=300, task_options={"start_m": [2.3, 0.0, 0.7]})
    flights = fly(Work.of(away, "random", 0, 8))
    assert all(flight["failed"] for flight in flights) and median(flights, "reward") < 0.1


def test_a_key_is_of_what_is_flown(tmp_path):
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    one.write_text("{}"), two.write_text("{ }")
    works = [
        Work.of(SCENARIO, "thesis-pid", 0, 8),
        Work.of(SCENARIO, "thesis-pid", 0, 9),
        Work.of(SCENARIO, "thesis-pid", 1, 8),
        Work.of(SCENARIO, "stock-pid", 0, 8),
        Work.of(Scenario(ticks=151, effects=SCENARIO.effects), "thesis-pid", 0, 8),
        Work.of(SCENARIO, f"pid:{one}", 0, 8),
        Work.of(SCENARIO, f"pid:{two}", 0, 8),
        Work.of(SCENARIO, "lqr", 0, 8),
        Work.of(SCENARIO, "lqr", 0, 8, reach_m=0.5),
    ]
    assert len({work.key() for work in works}) == len(works)
    (tmp_path / "elsewhere.json").write_text("{}")
    assert Work.of(SCENARIO, f"pid:{tmp_path / 'elsewhere.json'}", 0, 8).key() == works[5].key()


def test_a_run_goes_on_where_it_was(tmp_path):
    works = split(SCENARIO, "thesis-pid", 600)
    assert [work.count for work in works] == [256, 256, 88]
    with Store(tmp_path / "results.sqlite") as store:
        first = run(works[:2], store, progress=False)
        # stored results are not flown again: a second flight would overwrite the mark
        marked = store.get(works[0].key())
        with sqlite3.connect(tmp_path / "results.sqlite") as db:
            db.execute("UPDATE result SET flights = '[]' WHERE key = ?", (works[0].key(),))
        whole = run([*works, works[1]], store, progress=False)
        assert len(store) == 3 and marked == first[:256]
        assert whole[:256] == first[256:] and len(whole) == 256 + 88 + 256
        with pytest.raises(RuntimeError, match="gave two results"):
            store.add(works[0].key(), first)
        assert store.add(works[1].key(), first[256:]) is False


def test_a_cluster_that_loses_a_node_gives_what_one_process_gives(tmp_path):
    works = [Work.of(Scenario(ticks=2000), "thesis-pid", 1000 * i, 256) for i in range(12)]
    with Store(tmp_path / "serial.sqlite") as store:
        expected = run(works, store, progress=False)
    with losing_a_node(tmp_path / "cluster.sqlite", after=4) as (address, store):
        flights = run(works, store, address, progress=False)
        assert len(store) == len(works)
    assert flights == expected and len(flights) == 12 * 256
    assert store.came == Counter(work.key() for work in works)
