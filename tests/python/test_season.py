"""A season's archive, verified in this process and on a cluster that loses a machine."""

import json
import sqlite3
import subprocess
import sys

import pytest

from cluster import losing_a_node
from crazyflie_gym import season
from crazyflie_gym.sweep import Store
from test_shared import CRAZYFLIE

ATTEMPTS = 4


def crazyflie(*words):
    return subprocess.run([*CRAZYFLIE, *map(str, words)], check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("season")
    data, path = folder / "bench.sqlite", folder / "spring.jsonl"
    crazyflie("bench", "season", "new", "spring", "--scenarios", "hover-aruco", "--levels", "1,3", "--data", data)
    for i in range(ATTEMPTS):
        scenario = ["hover-aruco", "hover-aruco.3"][i % 2]
        crazyflie("bench", "submit", "--controller", "thesis-pid", "--scenario", scenario, "--data", data)
    crazyflie("bench", "season", "close", "spring", "--out", path, "--data", data)
    return path


def test_every_attempt_is_verified_on_a_cluster_that_loses_a_node(archive, tmp_path):
    with Store(tmp_path / "here.sqlite") as store:
        here = season.verify(archive, store, progress=False)
    assert [row["verdict"] for row in here] == ["confirmed"] * ATTEMPTS
    path = tmp_path / "cluster.sqlite"
    with losing_a_node(path, after=1) as (address, store):
        assert season.verify(archive, store, address, progress=False) == here
        assert all(count == 1 for count in store.came.values()) and len(store) == ATTEMPTS
    assert sqlite3.connect(path).execute("SELECT count(*) FROM result").fetchone()[0] == ATTEMPTS


def test_what_was_changed_or_taken_away_is_found(archive, tmp_path):
    head, *lines = archive.read_text().splitlines()
    changed = json.loads(lines[2])
    changed["actions"] = json.loads(lines[0])["actions"]
    forged = tmp_path / "forged.jsonl"
    forged.write_text("\n".join([head, *lines[:2], json.dumps(changed), *lines[3:]]) + "\n")
    with Store(tmp_path / "forged.sqlite") as store:
        found = season.verify(forged, store, progress=False)
    assert [row["verdict"] for row in found].count("wrong") == 1 and found[2]["verdict"] == "wrong"
    assert season.main([str(forged), "--store", str(tmp_path / "main.sqlite")]) == 1
    shorter = tmp_path / "shorter.jsonl"
    shorter.write_text("\n".join([head, *lines[:-1]]) + "\n")
    with Store(tmp_path / "shorter.sqlite") as store, pytest.raises(ValueError, match="missing"):
        season.verify(shorter, store, progress=False)
    assert season.main([str(archive), "--store", str(tmp_path / "good.sqlite")]) == 0


def test_a_verification_that_was_cut_short_goes_on(archive, tmp_path):
    path = tmp_path / "verdicts.sqlite"

    class Cut(Store):
        def add(self, key, found):
            if len(self) == 2:
                raise KeyboardInterrupt
            return super().add(key, found)

    with Cut(path) as store, pytest.raises(KeyboardInterrupt):
        season.verify(archive, store, progress=False)
    again = [sys.executable, "-m", "crazyflie_gym.season", str(archive), "--store", str(path), "--json"]
    found = json.loads(subprocess.run(again, check=True, capture_output=True, text=True).stdout)
    assert len(found) == ATTEMPTS and {row["verdict"] for row in found} == {"confirmed"}


def test_a_wrong_name_leaves_an_archive_as_it_is(archive):
    before, data = archive.read_bytes(), archive.with_name("bench.sqlite")
    with pytest.raises(subprocess.CalledProcessError):
        crazyflie("bench", "season", "close", "sprong", "--out", archive, "--data", data)
    assert archive.read_bytes() == before and not list(archive.parent.glob("*.partial"))
