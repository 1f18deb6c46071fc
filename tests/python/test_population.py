"""The generator of flights in rotorpy's physics: its step is rotorpy's, its signs the thesis's, its cases repeat."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent))

from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from population import case, declared, derivative, effects, flight, vehicle
from population.firmware import ATTITUDE_S, Link
from population.sensors import Camera


def speeds_for(thrust_n, moment_nm):
    mixer = Multirotor(quad_params, control_abstraction="cmd_ctbm")
    return mixer.get_cmd_motor_speeds(None, {"cmd_thrust": thrust_n, "cmd_moment": np.array(moment_nm)})


def test_steps_are_those_of_rotorpy():
    own = vehicle.Vehicle({})
    body = Multirotor(quad_params, integrator_kwargs={"method": "RK45", "rtol": 1e-9, "atol": 1e-12})
    state = {
        "x": own.state[:3],
        "v": own.state[3:6],
        "q": own.state[6:10],
        "w": own.state[10:13],
        "wind": np.array([0.8, -0.4, 0.1]),
    }
    state = {key: value.copy() for key, value in state.items()} | {"rotor_speeds": own.state[16:].copy()}
    weight_n = vehicle.MASS_KG * vehicle.GRAVITY_MPS2
    for i in range(250):
        thrust_n = (1.0 + 0.2 * np.sin(0.05 * i)) * weight_n
        moment = [4e-5 * np.sin(0.04 * i), -5e-5 * np.cos(0.03 * i), 2e-6]
        own.step(i * vehicle.STEP_S, thrust_n, np.array(moment), vehicle.REFERENCE_V, [0.8, -0.4, 0.1])
        state = body.step(state, {"cmd_motor_speeds": speeds_for(thrust_n, moment)}, vehicle.STEP_S)
    assert abs(state["v"]).max() > 0.1, "it has moved"
    np.testing.assert_allclose(own.state[:3], state["x"], atol=1e-3)
    np.testing.assert_allclose(own.state[3:6], state["v"], atol=3e-3)
    np.testing.assert_allclose(own.state[10:13], state["w"], atol=1e-2)
    np.testing.assert_allclose(own.state[16:], state["rotor_speeds"], atol=3.0)


def test_the_compiled_derivative_is_that_of_rotorpy():
    rng = np.random.default_rng(8)
    for _ in range(200):
        params = dict(quad_params)
        for key in ("mass", "Ixx", "Iyy", "Izz", "k_eta", "k_m", "k_d", "k_z", "tau_m"):
            params[key] = quad_params[key] * rng.uniform(0.5, 2.0)
        for key, size in {"Ixy": 2e-6, "Ixz": 2e-6, "Iyz": 2e-6, "k_h": 1e-4, "k_flap": 1e-6}.items():
            params[key] = rng.uniform(-size, size)
        for axis in "xyz":
            params[f"c_D{axis}"] = rng.uniform(0.0, 0.03)
        params["rotor_pos"] = {k: v + rng.uniform(-0.01, 0.01, 3) for k, v in quad_params["rotor_pos"].items()}
        body = Multirotor(params)
        state = np.concatenate([rng.uniform(-2, 2, 16), rng.uniform(500, 2500, 4)])
        state[6:10] /= np.linalg.norm(state[6:10])
        speeds = rng.uniform(0, 2500, 4)
        np.testing.assert_allclose(
            derivative.Constants(body).slope(state, speeds, body.k_eta),
            body._s_dot_fn(0.0, state, speeds),
            rtol=1e-9,
            atol=1e-9,
        )


def test_a_derivative_that_is_not_rotorpys_ends_the_flight():
    own = vehicle.Vehicle({})
    own.constants.rest[4] *= 1.001
    own.state[3] = 1.0
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        own.step(0.0, 0.3, np.zeros(3), vehicle.REFERENCE_V, [0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def plain():
    return flight.fly({}, "plain", "doublets", 12.0, "mocap", np.random.default_rng(4), 0.0015)


def test_signs_are_those_of_the_thesis(plain):
    roll, pitch = np.radians(plain.rows[:, 5]), np.radians(plain.rows[:, 6])
    acceleration = np.gradient(plain.truth[:, :2], flight.ROW_S, axis=0)
    assert np.corrcoef(plain.truth[:, 4], acceleration[:, 0])[0, 1] > 0.9, "+pitch accelerates to +x"
    assert np.corrcoef(plain.truth[:, 3], acceleration[:, 1])[0, 1] < -0.9, "+roll to -y"
    lag = 25
    assert (
        np.corrcoef(roll[:-lag], plain.truth[lag:, 3])[0, 1]
        > 0.5
        < np.corrcoef(pitch[:-lag], plain.truth[lag:, 4])[0, 1]
    )
    spin = flight.fly({}, "plain", "yawspin", 3.0, "mocap", np.random.default_rng(4), 0.0015)
    assert np.median(spin.truth[100:, 8]) == pytest.approx(-np.radians(np.median(spin.rows[100:, 7])), rel=0.02)


def test_the_declared_numbers_are_those_of_the_loop(plain):
    n0, d1, d0 = declared.fit_attitude([plain])
    # without an integrator a command of one degree ends in a tilt of one
    assert n0 / d0 == pytest.approx(1.0, abs=0.05) and 8 < d1 < 25
    hover_pwm, heave = declared.fit_height([plain])
    assert hover_pwm == pytest.approx(vehicle.HOVER_PWM, rel=0.01) and 0 <= heave < 0.6


def test_what_is_hidden_does_what_its_name_says():
    still = vehicle.Vehicle({})
    rate = {}
    for name, hidden in {"own": {}, "more": {"drag_linear": 0.6}}.items():
        body = vehicle.Vehicle(hidden).body
        state = still.state.copy()
        state[3] = 1.0
        rate[name] = -body._s_dot_fn(0.0, state, state[16:])[3]
    assert rate["own"] == pytest.approx(vehicle.drag_rate_ps(), rel=1e-6) and rate["more"] == pytest.approx(
        0.6, rel=1e-6
    )
    flapping = vehicle.Vehicle({"flap": 5.0}).body._s_dot_fn(0.0, state, state[16:])
    assert flapping[11] == pytest.approx(-5.0, rel=1e-6), "forward speed pitches it back"
    # a motor at the front right that pulls less drops this corner: +roll, +pitch
    weak = vehicle.Vehicle({"motor_eff": 0.9, "motor_index": 1})
    weak.step(0.0, vehicle.MASS_KG * vehicle.GRAVITY_MPS2, np.zeros(3), vehicle.REFERENCE_V, np.zeros(3))
    weak.step(0.0, vehicle.MASS_KG * vehicle.GRAVITY_MPS2, np.zeros(3), vehicle.REFERENCE_V, np.zeros(3))
    assert weak.state[10] > 0 and weak.state[11] > 0
    trim = vehicle.Vehicle({"com_roll": 2.0, "com_pitch": -1.0, "stiffness_ps2": 100.0}).body
    turn = trim._s_dot_fn(0.0, still.state, still.state[16:])[10:12]
    np.testing.assert_allclose(turn, 100.0 * np.radians([2.0, -1.0]), rtol=1e-6)


def test_a_link_delays_limits_and_plays():
    def answers(hidden, tilts_deg):
        link = Link(hidden, np.random.default_rng(0))
        out = []
        for tilt in tilts_deg:
            link.receive(np.array([tilt, 0.0, 0.0, 30000.0]))
            out.append(link.tilt_deg(link.deliver())[0])
        return out

    assert answers({"cmd_delay": 0.006}, [1, 2, 3, 4, 5]) == [0, 0, 0, 1, 2]
    assert answers({"backlash": 2.0}, [0, 3, 2, 1, -1]) == [0, 2, 2, 2, 0]
    assert answers({"rate_limit": 50.0}, [0, 1, 1, -1]) == pytest.approx([0, 0.5, 1.0, 0.5])
    assert answers({"cmd_deadband": 1.0}, [0.5, 3, -3]) == [0, 2, -2]


def test_a_camera_stamps_and_distorts():
    camera = Camera({"cam_latency": 0.04, "lens_pm2": 0.1, "cam_scale": 0.9}, 1.0, "mocap", np.random.default_rng(0))
    camera.errors[:] = 0.0
    state = np.zeros(20)
    state[:3] = 1.0, 0.0, 0.5
    camera.shoot(0.0, state, (0.0, 0.0, 0.0))
    assert not list(camera.arrived(0.08))
    ((place, stamp_s),) = camera.arrived(0.09)
    np.testing.assert_allclose(place, [0.9 * 1.1, 0.0, 0.45])
    assert stamp_s == pytest.approx(0.04)


NUMBERS = {"n0": 90.0, "d1": 15.0, "d0": 90.0, "hover_pwm": 33600.0, "heave": 0.15, "k": 10.0}


class Options:
    lost = 0.0
    gap = 0.0
    seed, noise, effects, seconds = 3, None, None, 4.0


@pytest.mark.parametrize("group", case.GROUPS)
def test_cases_are_drawn_alike_and_say_what_is_true(group):
    drawn = [case.draw(5, group, Options) for _ in range(2)]
    assert drawn[0] == drawn[1] != case.draw(6, group, Options)
    table = effects.OUTSIDE if group == "outside" else effects.EFFECTS
    for name, values in drawn[0]["effects"]:
        assert set(table[name].ranges) <= set(values)
        weaker = effects.weakened(values)
        assert all(abs(weaker[key]) <= abs(values[key]) for key in values if key not in effects.NEUTRAL)
    truth = case.documents(drawn[0], NUMBERS, 0.0)["d0005.answer.json"]
    assert truth["group"] == group and len(truth["effects"]) == {"null": 0, "compound": 2}.get(group, 1)


def test_a_delay_is_what_every_axis_sees():
    rng = np.random.default_rng(0)
    delays_s = [effects.EFFECTS["cmd_delay"].draw(rng)["cmd_delay"] for _ in range(50)]
    delays_s += [effects.weakened({"cmd_delay": delay_s})["cmd_delay"] for delay_s in delays_s]
    # thrust is asked for in every step, angles when the attitude loop looks
    looks = np.array(delays_s) / ATTITUDE_S
    assert min(looks) > 0.5 and len(set(delays_s)) > 4
    np.testing.assert_allclose(looks, np.round(looks), atol=1e-9)


def test_files_are_the_same_each_time(tmp_path):
    cases = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        cases.append(case.make(case.draw(1, "single", Options), {inner: NUMBERS for inner in case.INNER_LOOPS}, folder))
    assert cases[0] == cases[1] and "skipped" not in cases[0]
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["d0001.answer.json", "d0001.json", "d0001_a.csv.gz", "d0001_b.csv.gz"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_rows_are_lost_where_it_is_asked():
    whole = {"seconds": 20.0, "seed": 3, "number": 1, "lost": 0.0, "gap_s": 0.0}
    assert case.kept_rows(whole, "a").all()
    kept = case.kept_rows(whole | {"lost": 0.1, "gap_s": 2.0}, "a")
    assert len(kept) == 2000 and not kept[900:1100].any()
    assert 0.05 < 1 - kept[:900].mean() < 0.15
