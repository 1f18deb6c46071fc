"""Parquet files become CSVs that a mapping reads, and flights files of MATLAB."""

import csv
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat

from crazyflie_gym.logs import convert, main


def test_columns_survive_and_times_are_nanoseconds(tmp_path):
    source, target = tmp_path / "flight.parquet", tmp_path / "flight.csv"
    stamps = pa.array([1_500_000, 2_500_000], pa.timestamp("us"))
    motor = pa.array([3, 4], pa.uint16())
    columns = {"stamp": stamps, "x": [0.1, None], "m1": motor, "note": ["a", "b"], "on": [True, False]}
    pq.write_table(pa.table(columns), source)
    assert main(["convert", str(source), str(target)]) == 0
    with target.open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["stamp", "x", "m1", "on"]
    assert [float(cell) if cell else None for cell in rows[1]] == [1_500_000_000, 0.1, 3, 1]
    assert [float(cell) if cell else None for cell in rows[2]] == [2_500_000_000, None, 4, 0]


def test_what_is_no_parquet_or_holds_no_numbers_is_said(tmp_path, capsys):
    source = tmp_path / "flight.parquet"
    source.write_bytes(b"t,x\n0,1\n")
    assert main(["convert", str(source), str(tmp_path / "flight.csv")]) == 1
    assert "flight.parquet" in capsys.readouterr().err
    pq.write_table(pa.table({"name": ["a"]}), source)
    with pytest.raises(ValueError, match="no column holds numbers"):
        convert(source, tmp_path / "flight.csv")


def test_a_flight_goes_to_matlab(tmp_path):
    flight, target = tmp_path / "flight.csv", tmp_path / "flight.mat"
    words = ["fly", "--task", "hover", "--sensors", "lab", "--csv", str(flight)]
    subprocess.run([sys.executable, "-m", "crazyflie_gym", *words], check=True, capture_output=True)
    names = convert(flight, target)
    loaded = loadmat(target)
    with flight.open() as file:
        rows = list(csv.DictReader(file))
    assert {"t_s", "marker_x_m", "true_x_m"} <= set(names) <= set(rows[0])
    for name in ("t_s", "marker_x_m"):
        wanted = [float(row[name]) if row[name] else np.nan for row in rows]
        np.testing.assert_array_equal(loaded[name][:, 0], wanted)
    assert np.isnan(loaded["marker_x_m"]).any()
    odd = tmp_path / "odd.csv"
    odd.write_text("stateEstimate.x,1st\n1.5,2\n")
    convert(odd, target)
    assert {"stateEstimate_x", "x1st"} <= set(loadmat(target))
    odd.write_text("a.b,a_b\n1.5,2\n")
    with pytest.raises(ValueError, match=r"same name in MATLAB: a\.b, a_b"):
        convert(odd, target)
