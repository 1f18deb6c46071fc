"""The comparison of simulators, examples/simulators: its metrics are exact, and the true numbers win."""

import dataclasses
import math
import struct
import subprocess
import sys
import zlib
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
import identify_motors  # noqa: E402
import motor_flights as motors  # noqa: E402
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
    mark = report.MARK.format("stock")
    page = f"above\n{mark}\nold\n{mark}\nbelow\n"
    assert report.filled(page, "new", "stock") == page.replace("old", "new")
    with pytest.raises(ValueError, match="<!-- upgraded --> twice"):
        report.filled(page, "new", "upgraded")


def test_what_is_no_recording_is_told(tmp_path):
    import gzip

    path = tmp_path / "x.csv.gz"
    with gzip.open(path, "wt") as file:
        file.write("t,px\n0,0\n1,1\n")
    with pytest.raises(ValueError, match=r"x\.csv\.gz: no column .*pwr_pm_vbat"):
        flights.read_flight(path)


def test_every_set_of_recordings_judges_flights_that_it_does_not_fit():
    for name, kind in compare.RECORDINGS.items():
        assert kind.fit and kind.test and not set(kind.fit) & set(kind.test), name
        assert report.OURS in kind.simulators and "nothing moves on" in kind.simulators, name


@pytest.mark.parametrize("name", [name for name, entry in adapters.BY_MOTORS.items() if entry.model is None])
def test_motors_carry_and_turn_every_simulator_about_the_same_axes(name):
    """A quarter of the weight from each motor is a hover; the signs of all three torques are the firmware's."""
    try:
        simulator = adapters.BY_MOTORS[name].make(None)
    except ModuleNotFoundError as error:
        pytest.skip(str(error))
    level = np.zeros((4, 12))
    command = np.full((4, 50, 4), 0.25)
    command[1:] += 1e-4 * motors.SIGNS.T[:, np.newaxis]
    start = flights.Start(level, np.repeat(level[:, np.newaxis], 100, 1), np.full((4, 100, 4), 0.25))
    end = simulator.predict(start, command, flights.DT_S)[:, -1]
    assert np.abs(end[0]).max() < 2e-3
    if name != "nothing moves on":
        turned = end[1:, flights.RATE]
        assert (np.diag(turned) > 0.01).all() and np.abs(turned - np.diag(np.diag(turned))).max() < 1e-3, turned
        # the torque that it lacks is found
        lacked = motors.SIGNS @ [2e-3, -1e-3, 0.0]
        moved = dataclasses.replace(start, past_command=start.past_command + lacked)
        _, found = motors.trimmed(simulator, start, command, simulator.predict(moved, command + lacked, flights.DT_S))
        assert (found - command)[0, 0] == pytest.approx(lacked, abs=2e-5)


def micro_sd(path, seconds=6.0):
    """A log that commands a steady force and small torques, with a gap of 0.8 s at its beginning."""
    names = [f"stateEstimateZ.{part}{axis}(h)" for part in ("", "v") for axis in "xyz"]
    names += [f"ctrlLee.{part}{axis}(f)" for part in ("rpy", "omega") for axis in "xyz"]
    names += ["ctrlLee.thrustSI(f)", *(f"ctrlLee.torque{axis}(f)" for axis in "xyz")]
    head = b"".join([b"\xbc", struct.pack("<HHH", 2, 1, 0xFFFF), b"fixedFrequency\0", struct.pack("<H", len(names))])
    rows = [0, *range(200, round(250 * seconds))]
    body = b"".join(
        struct.pack("<HQ6h10f", 0xFFFF, 4000 * row, 0, 0, 1000, 500, 0, 0, *[0.0] * 6, 0.3, 1e-4, -2e-4, 3e-5)
        for row in rows
    )
    data = head + b"".join(name.encode() + b"\0" for name in names) + body
    path.write_bytes(data + zlib.crc32(data).to_bytes(4, "little"))


def test_force_and_torques_of_a_log_become_the_forces_of_four_motors(tmp_path):
    micro_sd(tmp_path / "log")
    flight = motors.read_motor_flight(tmp_path / "log")
    assert len(flight.state) == pytest.approx(5.2 / flights.DT_S, abs=2), "it begins after the gap"
    assert flight.state[0] == pytest.approx([0, 0, 1.0, 0.5, *[0] * 8])
    forces = flight.command[100]
    levers = [motors.SIDE_M, motors.SIDE_M, motors.YAW_LEVER_M]
    assert forces.sum() == pytest.approx(0.3) and forces @ motors.SIGNS * levers == pytest.approx([1e-4, -2e-4, 3e-5])
    start, command, _ = flights.cut_windows(flight, 2.0, 0.25)
    assert command.sum(-1) == pytest.approx(1.0) and start.past_command.shape[1:] == (100, 4)
    other = (tmp_path / "log").read_bytes()[:-500]
    for content in (other, b"t,x\n"):
        (tmp_path / "other").write_bytes(content)
        with pytest.raises(ValueError, match="other: the checksum is wrong"):
            motors.read_motor_flight(tmp_path / "other")


def test_numbers_of_a_made_flight_are_found():
    """A torque through a lag of 60 ms turns by 650 rad/s^2, the speed by 30 rad/(m s); a drag of 0.4 1/s slows."""
    rng = np.random.default_rng(3)
    n, dt_s = 2000, flights.DT_S
    wanted = np.repeat(rng.normal(0.0, 0.003, (n // 25, 2)), 25, 0)
    state, torque = np.zeros((n, 12)), np.zeros(2)
    state[:, 2] = 1.0
    command = np.full((n, 4), 0.25)
    for row in range(n - 1):
        now = state[row]
        front, left, _ = flights.rotation(now[flights.ATT]).T @ now[flights.VEL]
        # attitude and rates are held near zero, and the torque of flapping is balanced but for a tenth
        asked = wanted[row] - 0.05 * now[6:8] - 0.012 * now[9:11] - 0.9 * 30.0 / 650.0 * np.array([left, -front])
        command[row] += motors.SIGNS[:, :2] @ asked / 4.0
        before, torque = torque, torque + (1.0 - math.exp(-dt_s / 0.06)) * (asked - torque)
        turned = 650.0 * 0.5 * (before + torque) + 30.0 * np.array([left, -front])
        after = now.copy()
        after[9:11] += dt_s * turned
        after[6:8] += dt_s * after[9:11]
        up = flights.rotation(now[flights.ATT])[:, 2]
        after[3:5] += dt_s * (9.81 * up[:2] - 0.4 * now[3:5])
        after[:2] += dt_s * after[3:5]
        state[row + 1] = after
    found = identify_motors.identify([flights.Flight("made", state, command, 4, 1.0)])
    assert found["lag_s"] == pytest.approx(0.06, abs=0.01) and found["turn_radps2"] == pytest.approx(650.0, rel=0.1)
    assert found["flap_radpms"] == pytest.approx(30.0, rel=0.1) and found["drag_ps"] == pytest.approx(0.4, rel=0.1)


@pytest.mark.parametrize(
    "script",
    [
        *(f"simulators/{name}.py" for name in ("compare", "choose", "identify_motors")),
        *(f"thesis/{name}.py" for name in ("identify_cf21", "recorded")),
        "jax_identify.py --data",
    ],
)
def test_a_folder_without_the_recordings_is_one_sentence(script, tmp_path):
    """They ended in a traceback."""
    if "jax" in script:
        pytest.importorskip("jax")
    name, *option = script.split()
    path = ROOT / "examples" / name
    command = [sys.executable, path, *option, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 2 and "lacks" in done.stderr.splitlines()[-1], done.stderr


def test_a_model_that_is_not_there_is_one_sentence(tmp_path):
    """The thesis's script ended in a traceback behind the program's own words."""
    command = [sys.executable, ROOT / "examples/thesis/identify.py", tmp_path / "gone.toml"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 1 and "gone.toml" in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
