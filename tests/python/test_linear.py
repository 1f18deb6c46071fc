"""The model and its loops as scipy takes them, and their plots."""

import numpy as np
import pytest

from crazyflie_gym import linear

signal = pytest.importorskip("scipy.signal", reason="the matrices are not held against scipy: pip install scipy")
scipy_io = pytest.importorskip("scipy.io")
CHANNELS = {
    "x": ("pitch", "x"),
    "y": ("roll", "y"),
    "z": ("lift", "z"),
    "yaw": ("yaw_rate", "yaw"),
    "roll": ("roll", "roll"),
    "pitch": ("pitch", "pitch"),
}
OMEGA_RADPS = np.array([0.3, 1.0, 7.0, 40.0])


@pytest.mark.parametrize("vertical", ["height", "pwm", "thrust", "motors"])
@pytest.mark.parametrize("channel", sorted(CHANNELS))
def test_the_transfer_function_is_that_of_the_matrices(channel, vertical):
    command, state = CHANNELS[channel]
    A, B, C, D = linear.state_space(vertical=vertical)
    assert (A.shape, B.shape, C.shape, D.shape) == ((12, 12), (12, 4), (7, 12), (7, 4))
    row, column = linear.STATES.index(state), B[:, linear.INPUTS.index(command)]
    # scipy turns the twelve states into one polynomial first, which costs digits: the resolvent keeps them
    expected = [np.linalg.solve(1j * omega * np.eye(12) - A, column)[row] for omega in OMEGA_RADPS]
    num, den = linear.transfer_function(channel, vertical=vertical)
    _, found = signal.freqresp(signal.TransferFunction(num, den), OMEGA_RADPS)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_climb_rate_of_a_first_order_form_answers_at_once():
    A, B, C, D = linear.state_space(vertical="pwm")
    vz, z = linear.OUTPUTS.index("vz"), linear.STATES.index("z")
    np.testing.assert_array_equal(D[vz], B[z])
    np.testing.assert_array_equal(C[vz], A[z])
    assert not linear.state_space(vertical="thrust").D.any()


def test_matlab_gets_the_matrices_and_their_names(tmp_path):
    linear.save_mat(tmp_path / "cf2.mat", vertical="thrust")
    loaded = scipy_io.loadmat(tmp_path / "cf2.mat")
    for name, matrix in linear.state_space(vertical="thrust")._asdict().items():
        np.testing.assert_array_equal(loaded[name], matrix)
    assert tuple(cell[0] for cell in loaded["StateName"][:, 0]) == linear.STATES
    assert loaded["InputName"].shape == (4, 1) and loaded["OutputName"].dtype == object


def test_margins_are_those_of_scipys_frequency_response():
    report = linear.loop("x", vertical="thrust")
    num, den = linear.transfer_function("x", vertical="thrust")
    gains, omega = report["gains"], report["margins"]["crossover_radps"]
    s = 1j * omega
    controller = np.pi / 180 * (gains["kp"] + gains["ki"] / s + gains["kd"] * s)
    value = controller * np.polyval(num, s) / np.polyval(den, s) * np.exp(-s * report["dead_time_s"])
    assert abs(value) == pytest.approx(1.0, abs=0.02)
    assert 180 + np.degrees(np.angle(value)) == pytest.approx(report["margins"]["phase_deg"], abs=1.0)


@pytest.mark.parametrize(("ending", "begins"), [("svg", b"<svg"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_every_loop_is_plotted_in_every_format(tmp_path, ending, begins):
    for name in [None, "x", "y", "z", "yaw"]:
        file = tmp_path / f"{name}.{ending}"
        linear.plot(file, name)
        assert file.read_bytes().startswith(begins)


def test_the_height_loop_of_a_height_command_is_left_out():
    assert [report["loop"] for report in linear.loops(vertical="height")] == ["yaw", "x", "y"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda path: linear.transfer_function("pich"), "did you mean"),
        (lambda path: linear.transfer_function("z", vertical="pmw"), "did you mean"),
        (lambda path: linear.state_space(vertical="x"), "vertical form"),
        (lambda path: linear.loop("zz"), "did you mean"),
        (lambda path: linear.loop("z", vertical="height"), "pwm or thrust"),
        (lambda path: linear.loop("x", gains={"x": 1}), "gains"),
        (lambda path: linear.loop("x", sensors="labs"), "lab"),
        (lambda path: linear.plot(path / "x.jpg"), ".svg, .png, .pdf"),
    ],
)
def test_bad_input_is_refused_in_words(tmp_path, call, words):
    with pytest.raises(ValueError, match=words):
        call(tmp_path)


def test_a_model_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        linear.state_space(model=tmp_path / "none.toml")
