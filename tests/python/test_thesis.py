"""The thesis's experiments, flown and identified again by the scripts of examples/thesis.

That docs/thesis.md holds their figures is tested with the other pages that come from the code.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples/thesis"))

import identify  # noqa: E402
import scorecard  # noqa: E402


@pytest.fixture(scope="module")
def rows():
    return scorecard.scorecard()


def test_what_the_equations_fix_agrees_exactly(rows):
    exact = [row.as_json() for row in rows if " by 5." in row.claim]
    assert len(exact) == 6
    for row in exact:
        assert abs(row["ideal"]["deviation"]) < 1e-4 * abs(row["ideal"]["value"]), row
    assert all(row.why for row in rows if "differs" in row.mark()), "a deviation without a reason"
    json.dumps([row.as_json() for row in rows], allow_nan=False)


def test_figures_of_a_known_curve():
    z_m = np.array([0.0, 0.5, 0.9, 0.7, 0.6, 0.72, 0.7])
    assert scorecard.overshoot(z_m, 0.7) == pytest.approx(0.2)
    assert scorecard.swing_after_peak(z_m, 0.7) == pytest.approx(0.1)
    assert scorecard.swing_after_peak(z_m[:2], 0.7) == 0.0
    assert scorecard.stable_s(z_m, 0.7, 0.05, 1.0) == 5.0
    assert scorecard.stable_s(z_m[:3], 0.7, 0.05, 1.0) == math.inf


@pytest.mark.parametrize(
    ("figure", "most", "ideal", "rig", "mark"),
    [
        (50.0, False, 60.0, 70.0, "ideal agrees"),
        (50.0, False, 70.0, 60.0, "rig agrees"),
        (50.0, False, None, 70.0, "differs"),
        (10.0, True, 4.0, None, "agrees"),
        (10.0, True, math.inf, 4.0, "rig agrees"),
        (None, False, 1.0, 1.0, "not comparable"),
    ],
)
def test_agreement(figure, most, ideal, rig, mark):
    row = scorecard.Row("7.3", "flight", "old", "overshoot", "cm", 1, "words", figure, most, "", ideal, rig)
    assert row.mark() == mark
    assert row.cell(math.inf) == "never" and row.cell(None) == ""


def test_pictures_are_drawn(tmp_path):
    pytest.importorskip("matplotlib").use("agg")
    scorecard.draw(tmp_path)
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == {"fly-80cm.svg", "takeoff.svg", "takeoff-thrust.svg", "hover.svg"}
    assert all("new gains" in path.read_text() for path in tmp_path.iterdir())


def test_the_equations_come_back(tmp_path):
    """Without noise what is left is the recording's 32-bit rounding; through the camera, what one step can give."""
    found = identify.recover([], 0, tmp_path)
    assert {line["equation"] for line in found} == {"5.1", "5.2", "5.3", "5.4", "5.5", "4.15"}
    assert len(found) == 51
    camera = {"5.1": 0.2, "5.2": 0.03, "5.5": 0.5, "4.15": 0.35}
    for line in found:
        estimate, true = line["estimate"], line["true"]
        off, whole = abs(estimate["value"] - true), line["equation"] == "4.15"
        scale = abs(true) or 1.0
        assert len(identify.cells(line)) == 10
        if line["sensors"] == "ideal":
            assert off < (0.01 if whole else 2e-3) * scale, line
            assert whole or line["fit_percent"] > 99.9, line
        else:
            assert off < camera.get(line["equation"], 0.35) * scale, line
            assert whole or off < 4.0 * estimate["standard_error"], line
