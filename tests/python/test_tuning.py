"""Tuned gains are better on unseen seeds; a cluster finds what one process finds, and nothing is flown twice."""

import json
import sqlite3
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest

pytest.importorskip("tqdm", reason="tqdm is not installed (extra ray): tuning is not tested")

from cluster import losing_a_node
from common import LIMIT_S
from crazyflie_gym import controllers
from crazyflie_gym.evaluation import Scenario, Work, fly, median
from crazyflie_gym.sweep import Store
from crazyflie_gym.training import LAB
from crazyflie_gym.tuning import UNSEEN, Search, cost, replaced, tune

QUICK = Search(Scenario(ticks=150, effects=LAB), seeds=16, judged_on=16, generations=4, population=6)


def found(search, path):
    with Store(path) as store:
        return tune(search, store, progress=False)


def test_tuned_gains_are_better_on_unseen_seeds(tmp_path):
    scenario = Scenario(ticks=500, effects=LAB, task_options={"start_radius_m": 0.8, "start_yaw_deg": 20.0})
    search = Search(scenario, seeds=32, judged_on=128, generations=12)
    with Store(tmp_path / "flights.sqlite") as store:
        tuned = tune(search, store, progress=False)
    before, after = tuned.before, tuned.after
    for name, flights in (("table 7.1", before), ("tuned", after)):
        cm = 100 * median(flights, "rmse_m")
        print(
            f"{name}: reward {median(flights, 'reward'):.3f}, {cm:.1f} cm, {sum(f['failed'] for f in flights)} failed"
        )
    better = sum(new["reward"] > old["reward"] for old, new in zip(before, after, strict=True))
    print(f"better in {better} of 128 flights; cost {tuned.costs[0]:.4f} to {tuned.costs[-1]:.4f}: {tuned.gains}")
    assert [flight["seed"] for flight in after] == list(range(UNSEEN, UNSEEN + 128))
    assert cost(after, "reward") < cost(before, "reward") and better > 96
    # the reported gains alone reproduce the result, and judging flights are not among the search's
    assert after == fly(Work.of(scenario, "thesis-pid", UNSEEN, 128, **tuned.options))
    assert before == fly(Work.of(scenario, "thesis-pid", UNSEEN, 128))


def test_a_cluster_that_loses_a_node_finds_what_one_process_finds(tmp_path):
    # long enough flights for work to be under way on the node that dies
    search = replace(QUICK, scenario=Scenario(ticks=1000, effects=LAB), seeds=150, generations=3)
    expected = found(search, tmp_path / "serial.sqlite")
    with losing_a_node(tmp_path / "cluster.sqlite", after=5) as (address, store):
        tuned = tune(search, store, address, progress=False)
    assert tuned == expected
    with sqlite3.connect(tmp_path / "serial.sqlite") as db:
        assert store.came == Counter(key for (key,) in db.execute("SELECT key FROM result"))


class Cut(Store):
    """A store that is cut short after so many results."""

    left = 10**9

    def add(self, key, flights):
        if self.left == 0:
            raise KeyboardInterrupt
        self.left -= 1
        return super().add(key, flights)


def test_a_tuning_that_was_cut_short_goes_on_where_it_was(tmp_path):
    whole, flown = found(QUICK, tmp_path / "whole.sqlite"), []
    for results in (10, 7, 10**9, 10**9):
        with Cut(tmp_path / "cut.sqlite") as store:
            store.left, before = results, len(store)
            try:
                tuned = tune(QUICK, store, progress=False)
            except KeyboardInterrupt:
                tuned = None
            flown.append(len(store) - before)
            # each result that was flown is a new one
            assert results - store.left == flown[-1]
    # the start, four generations of six, and two to judge; the last run only read
    assert tuned == whole and flown == [10, 7, 1 + 4 * 6 + 2 - 17, 0]


def test_a_search_is_of_what_it_was_told(tmp_path):
    path = tmp_path / "flights.sqlite"
    one = found(replace(QUICK, names=["x", "z.kp"], figure="rmse_m"), path)
    assert sorted(one.gains) == ["x.kd", "x.ki", "x.kp", "z.kp"] and one.gains["x.kp"][0] == 12.0
    # gains outside the search are unchanged
    table = json.loads(next(c["defaults"] for c in controllers() if c["name"] == "thesis-pid"))
    assert one.options == replaced(table, {name: new for name, (_, new) in one.gains.items()}) != table
    assert one.costs == sorted(one.costs, reverse=True) and one.costs[-1] < one.costs[0]
    assert found(replace(QUICK, seed=1), path).gains != found(QUICK, path).gains


def test_a_failed_flight_costs_its_reward_or_a_metre():
    away = fly(Work.of(Scenario(ticks=300, task_options={"start_m": [2.3, 0.0, 0.7]}), "random", 0, 4))
    assert all(flight["failed"] for flight in away)
    assert cost(away, "reward") > 0.9 and cost(away, "rmse_m") > 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"controller": "hover"}, "hover has no gains to tune"),
        ({"controller": "thesis-pit"}, 'did you mean "thesis-pid"'),
        ({"names": ["x.kq"]}, r"thesis-pid has no gain 'x.kq' .* x.kd, x.ki, x.kp"),
        ({"names": ["yaw.ki"]}, "that is not 0"),
        ({"figure": "speed"}, "unknown figure 'speed', expected one of reward, rmse_m"),
        ({"seeds": 0}, "seeds is 0, expected 2 to"),
        ({"options": {"w": 1}}, "unknown field `w`"),
        ({"scenario": Scenario(effects={"camera_nose": 1})}, 'did you mean "camera_noise"'),
    ],
)
def test_mistakes_are_named(change, words, tmp_path):
    with pytest.raises(ValueError, match=words):
        found(replace(QUICK, **change), tmp_path / "flights.sqlite")


def command(*args, cwd):
    call = [sys.executable, "-m", "crazyflie_gym.tuning", *args]
    return subprocess.run(call, capture_output=True, text=True, timeout=LIMIT_S, check=False, cwd=cwd)


def test_the_command_leaves_gains_that_fly(tmp_path):
    short = ["--ticks", "150", "--seeds", "8", "--generations", "2", "--population", "4", "--judged-on", "8"]
    done = command("thesis-pid", *short, "--out", "gains.json", "--picture", "tuned.png", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["options"] == json.loads((tmp_path / "gains.json").read_text()) and report["candidates"] == 8
    flights = fly(Work.of(Scenario(ticks=150, effects=LAB), f"pid:{tmp_path / 'gains.json'}", UNSEEN, 8))
    assert report["after"]["rmse_m"] == median(flights, "rmse_m")
    assert (tmp_path / "tuned.png").read_bytes().startswith(b"\x89PNG")
    # from a file, and for people
    again = command("kalman+pid:gains.json", *short, "--gains", "x.kp", cwd=tmp_path)
    assert again.returncode == 0 and "8 candidates on 8 seeds, judged on 8 others" in again.stdout, again.stderr
    for mistake, words in (("--gains=kp", "has no gain 'kp'"), ("--effects={", "{ is not JSON"), ("--id=X-v0", "X-v0")):
        refused = command("thesis-pid", mistake, cwd=tmp_path)
        assert refused.returncode == 2 and words in refused.stderr, refused.stderr
    assert command("pid:gone.json", cwd=tmp_path).returncode == 2
