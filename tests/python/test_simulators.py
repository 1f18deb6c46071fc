"""The comparison of simulators, examples/simulators: its metrics are exact, and the true numbers win."""

import math
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import crazyflie_gym  # noqa: F401, registers the environments
from common import LIMIT_S

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples/simulators"))

import adapters  # noqa: E402
import compare  # noqa: E402
import errors  # noqa: E402
import real_flights as flights  # noqa: E402
import report  # noqa: E402

TICK_S = 0.02


def flown(ticks=150, seed=4):
    """The built-in model by its own simulator: start, commands (1, ticks, 4) and states (1, ticks + 1, 12)."""
    env = gym.make(
        "Crazyflie-v0", vertical="thrust", true_state=True, task_options={"start_m": [0.1, -0.2, 1.2]}
    ).unwrapped
    _, info = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    hover = 2.0 * env.interface.hover_lift / env.interface.lift_max - 1.0
    states, commands = [info["true_state"][:12]], []
    for tick in range(ticks):
        if tick % 10 == 0:
            action = np.float32([*rng.uniform(-0.4, 0.4, 2), 0.0, hover + rng.uniform(-0.05, 0.05)])
        roll, pitch, _, lift = env.interface.command(list(map(float, action)))
        # a yaw that is commanded as it is needs no rate
        commands.append([roll, pitch, states[-1][8], lift / env.interface.hover_lift])
        info = env.step(action)[4]
        states.append(info["true_state"][:12])
    states, commands = np.array(states, float)[np.newaxis], np.array(commands, float)[np.newaxis]
    # the rates that the simulator tells are derivatives of its angles
    states[..., 9:] = flights.body_rates(states[..., 6:9], states[..., 9:])
    return flights.Start(states[:, 0], states[:, :1], commands[:, :1]), commands, states


def made(name, path=None):
    return adapters.SIMULATORS[name].make(path)


def test_the_true_numbers_predict_to_the_rounding_and_a_state_that_stays_does_not():
    start, command, states = flown()
    predicted = made("ours, thesis").predict(start, command, TICK_S)
    assert predicted.shape == states.shape
    # the simulator computes in single precision
    assert np.abs(predicted - states)[..., [0, 1, 2, 3, 4, 5, 6, 7, 9, 10]].max() < 2e-5
    stayed = made("nothing moves on").predict(start, command, TICK_S)
    true, naive = (errors.flight_errors(one, states, TICK_S) for one in (predicted, stayed))
    assert (true[:3] < 1e-3 * naive[:3]).all(), (true, naive)
    assert np.abs(states[0, -1, :3] - states[0, 0, :3]).max() > 0.5


def test_the_recorded_step_flies_as_the_matrices_do(tmp_path):
    pytest.importorskip("jax")
    path = tmp_path / "model.json"
    shown = [sys.executable, "-m", "crazyflie_gym", "model", "--show", "--json"]
    path.write_text(subprocess.run(shown, check=True, capture_output=True, text=True, timeout=LIMIT_S).stdout)
    rng = np.random.default_rng(1)
    past = np.zeros((3, 20, 12))
    past[..., 2] = 1.0
    state = np.concatenate([rng.uniform(-1, 1, (3, 6)), rng.uniform(-0.1, 0.1, (3, 6))], -1)
    # above the floor, and without the yaw that is not commanded
    state[:, 2] += 3.0
    state[:, [8, 11]] = 0.0
    command = np.concatenate([rng.uniform(-0.1, 0.1, (3, 100, 3)), rng.uniform(0.9, 1.1, (3, 100, 1))], -1)
    start = flights.Start(state, past, np.tile([0.0, 0.0, 0.0, 1.0], (3, 20, 1)))
    command[..., 2] = 0.0
    by_jax = adapters.WithEffects(path).predict(start, command, flights.DT_S)
    by_matrices = adapters.Linear().predict(start, command, flights.DT_S)
    assert np.abs(by_jax - by_matrices).max() < 2e-4
    with pytest.raises(ValueError, match=r"dt_s: expected 0\.01, got 0\.02"):
        adapters.WithEffects(path).predict(start, command, 0.02)


def test_distances_are_exact():
    measured = np.zeros(12)
    measured[8] = 0.7
    predicted = measured.copy()
    predicted[:3], predicted[3:6], predicted[9:] = [3, 0, 4], [0, -2, 0], [0, 0, math.pi]
    predicted[8] += math.radians(10)
    assert errors.distances(predicted, measured) == pytest.approx([5, 2, 10, 180], rel=1e-12)
    assert errors.distances(measured, measured) == pytest.approx([0, 0, 0, 0], abs=1e-12)


def test_errors_of_a_push_that_nobody_told_are_those_of_the_formula():
    """An acceleration a that is left out costs a t in velocity and a t^2 / 2 in position."""
    time_s = np.arange(201) * 0.01
    measured = np.zeros((5, 201, 12))
    measured[..., 0], measured[..., 3] = 0.5 * 0.3 * time_s**2, 0.3 * time_s
    found = errors.flight_errors(np.zeros_like(measured), measured, 0.01)
    assert found[0] == pytest.approx([0.0015, 0.0375, 0.6]) and found[1] == pytest.approx([0.03, 0.15, 0.6])
    with pytest.raises(ValueError, match="finite"):
        errors.flight_errors(np.full_like(measured, np.nan), measured, 0.01)
    with pytest.raises(ValueError, match="expected shape"):
        errors.flight_errors(measured[:, :-1], measured, 0.01)


def test_differences_are_those_of_student():
    """Gaps 1, 2, 3: mean 2, standard error 1 / sqrt(3), quantile 4.303 for two degrees of freedom."""
    gap = errors.difference(np.array([2.0, 4.0, 6.0]), np.array([1.0, 2.0, 3.0]))
    assert gap == pytest.approx((2.0, 2.0 - 4.303 / math.sqrt(3), 2.0 + 4.303 / math.sqrt(3)))
    assert gap.verdict == "" and errors.Difference(-2.0, -3.0, -1.0).verdict == "better"
    assert errors.difference(np.array([1.0]), np.array([0.5])).verdict == ""


def test_frames_turn_and_return():
    att = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    assert flights.angles(flights.rotation(att)) == pytest.approx(att)
    rate = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3))
    assert flights.body_rates(att, flights.euler_rates(att, rate)) == pytest.approx(rate)
    # +pitch leans forward, +roll to the right
    assert (flights.rotation(np.array([0.0, 0.1, 0.0])) @ [0, 0, 1])[0] > 0.0
    assert (flights.rotation(np.array([0.1, 0.0, 0.0])) @ [0, 0, 1])[1] < 0.0
    # a small turn of the attitude is the body rate times the time
    step = flights.rotation(att).swapaxes(-1, -2) @ flights.rotation(att + 1e-6 * flights.euler_rates(att, rate))
    assert np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], -1) == pytest.approx(
        1e-6 * rate, rel=1e-3, abs=1e-10
    )


def recorded(seconds=9.0, power=1.0):
    """A flight that hovers by a thrust of 0.6 in its own unit and then climbs."""
    n = round(seconds / flights.DT_S)
    state, command = np.zeros((n, 12)), np.zeros((n, 4))
    command[:, 3] = 0.6
    command[n // 2 :, 3] = 0.66
    state[:, 5] = np.cumsum(9.81 * (command[:, 3] / 0.6 - 1.0)) * flights.DT_S
    state[:, 2] = 1.0 + np.cumsum(state[:, 5]) * flights.DT_S
    return flights.Flight("made", state, command)


def test_the_thrust_counts_from_what_carried_the_weight_before():
    _, command, measured = flights.cut_windows(recorded(), 2.0, 0.25)
    assert command.shape[1:] == (200, 4) and measured.shape[1:] == (201, 12)
    # the first windows begin in hover, the last ones in the climb: its acceleration is known, and it is the same weight
    assert command[0, 0, 3] == pytest.approx(1.0) and command[-1, 0, 3] == pytest.approx(1.1, rel=1e-3)
    with pytest.raises(ValueError, match="made: shorter than"):
        flights.cut_windows(recorded(4.0), 2.0, 0.25)


def test_who_is_not_installed_is_listed_and_the_others_are_compared(monkeypatch):
    monkeypatch.setattr(adapters, "SIMULATORS", dict(adapters.SIMULATORS))

    @adapters.register("absent", "a peer that nobody has")
    class Absent:
        def __init__(self):
            import no_such_simulator  # noqa: F401

    entries = {name: adapters.SIMULATORS[name] for name in ("ours, thesis", "absent", "nothing moves on")}
    found = compare.compare([recorded()], entries)
    assert found["absent"] == {"missing": "no_such_simulator"}
    text = report.table(found, ours="ours, thesis")
    rows = {row.split("|")[1].strip(): row for row in text.splitlines()}
    assert "not installed: no_such_simulator" in rows["absent"] and len(rows) == 5
    assert text.splitlines()[0].count("|") == rows["absent"].count("|") == rows["ours, thesis"].count("|")
    back = report.read_json(report.as_json(found, ["made"], ours="ours, thesis"))
    assert list(back) == list(found) and back["absent"] == found["absent"]
    assert back["ours, thesis"]["errors"] == pytest.approx(found["ours, thesis"]["errors"], rel=1e-3)


def test_every_peer_is_made_or_said_to_be_absent():
    for name, entry in adapters.SIMULATORS.items():
        assert entry.about and (entry.model is None or entry.model in adapters.FITS), name
        if entry.model is None:
            try:
                simulator = entry.make(None)
            except ModuleNotFoundError as error:
                assert error.name
            else:
                assert callable(simulator.predict), name


@pytest.mark.parametrize("name", [name for name, entry in adapters.SIMULATORS.items() if entry.model is None])
def test_a_hover_stays_where_it_is(name):
    """One weight of thrust carries every simulator for a second; a pitch moves it forward, a roll to the right."""
    try:
        simulator = made(name)
    except ModuleNotFoundError as error:
        pytest.skip(str(error))
    level = np.zeros((1, 12))
    command = np.tile([0.0, 0.0, 0.0, 1.0], (1, 100, 1))
    start = flights.Start(level, np.repeat(level[:, np.newaxis], 300, 1), np.repeat(command, 3, 1))
    assert np.abs(simulator.predict(start, command, flights.DT_S)).max() < 2e-3
    if name != "nothing moves on":
        command[..., 0], command[..., 1] = 0.05, 0.05
        end = simulator.predict(start, command, flights.DT_S)[0, -1]
        assert end[0] > 0.1 and end[1] < -0.1, end
        command[..., 3] = 1.05
        assert simulator.predict(start, command, flights.DT_S)[0, -1, 2] > 0.1


def test_a_page_without_its_marks_is_told():
    page = f"above\n{report.MARK}\nold\n{report.MARK}\nbelow\n"
    assert report.filled(page, "new") == page.replace("old", "new")
    with pytest.raises(ValueError, match="twice"):
        report.filled("above", "new")


def test_what_is_no_recording_is_told(tmp_path):
    import gzip

    path = tmp_path / "x.csv.gz"
    with gzip.open(path, "wt") as file:
        file.write("t,px\n0,0\n1,1\n")
    with pytest.raises(ValueError, match=r"x\.csv\.gz: no column .*pwr_pm_vbat"):
        flights.read_flight(path)
