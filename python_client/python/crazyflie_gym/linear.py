"""The model and its loops for control engineers: what scipy and python-control take, and plots.

    from crazyflie_gym import linear

    num, den = linear.transfer_function("x")       # scipy.signal.TransferFunction(num, den)
    A, B, C, D = linear.state_space()              # control.ss(A, B, C, D)
    linear.save_mat("cf2.mat")                     # for MATLAB
    linear.plot("loops.pdf", "z", vertical="thrust")
    linear.loop("z", vertical="thrust")["margins"]

`model` is the name of a vehicle, or the path of a model file; the thesis's unless given. `vertical` is height, pwm or
thrust; the form that controllers command unless given.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym import _native
from crazyflie_gym.options import Model, model_source

STATES = ("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")
"""States of `state_space`, SI units. A first-order form keeps the lag of a push in the place of its rate."""
INPUTS = ("roll", "pitch", "yaw_rate", "lift")
"""Inputs of `state_space`: radians, rad/s, and metres or PWM counts above the input at rest."""
OUTPUTS = ("z", "roll", "pitch", "yaw", "vx", "vy", "vz")
"""Outputs of `state_space`, SI units."""

Path_ = str | os.PathLike[str]


class TransferFunction(NamedTuple):
    """numerator(s) / denominator(s), coefficients with the highest power of s first."""

    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]


class StateSpace(NamedTuple):
    """x' = A x + B u, y = C x + D u: shapes (12, 12), (12, 4), (7, 12) and (7, 4)."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


def _text(model: Model) -> str | None:
    return model_source(model)[0]


def transfer_function(channel: str, *, model: Model = None, vertical: str | None = None) -> TransferFunction:
    """Return the transfer function from the command of a channel to its output, SI units.

    Channels: x (by pitch), y (by roll), z (by height or thrust), yaw (by yaw rate), roll, pitch. Source: thesis
    4.10, 5.1 to 5.5, or the model file.

    Raises:
        ValueError: for an unknown channel or form, with a proposal, and a model file that is wrong.
        FileNotFoundError: if there is no such model file.
    """
    numerator, denominator = _native.transfer_function(channel, _text(model), vertical)
    return TransferFunction(np.array(numerator), np.array(denominator))


def state_space(*, model: Model = None, vertical: str | None = None) -> StateSpace:
    """Return the linear model as matrices; `STATES`, `INPUTS` and `OUTPUTS` name their rows and columns.

    Source: thesis 4.14 and 4.15.

    Raises:
        ValueError: for an unknown form, with a proposal, and a model file that is wrong.
        FileNotFoundError: if there is no such model file.
    """
    return StateSpace(*_native.state_space(_text(model), vertical))


def save_mat(file: Path_, *, model: Model = None, vertical: str | None = None) -> None:
    """Write the linear model for MATLAB: matrices A, B, C, D, and cell arrays of names for `ss`'s properties.

    In MATLAB: `s = load("cf2.mat"); sys = ss(s.A, s.B, s.C, s.D, "StateName", s.StateName);` and so on.

    Raises:
        ValueError: as `state_space`.
        ModuleNotFoundError: without SciPy (extra `mat`).
        OSError: if the file cannot be written.
    """
    from scipy.io import savemat

    names = {"StateName": STATES, "InputName": INPUTS, "OutputName": OUTPUTS}
    cells = {key: np.array(each, dtype=object)[:, None] for key, each in names.items()}
    savemat(os.fspath(file), state_space(model=model, vertical=vertical)._asdict() | cells)


def loops(
    *,
    gains: Mapping[str, Any] | None = None,
    model: Model = None,
    vertical: str | None = None,
    sensors: str = "lab",
) -> list[dict[str, Any]]:
    """Return every loop of the PID as `loop` does."""
    text = None if gains is None else json.dumps(dict(gains))
    reports: list[dict[str, Any]] = json.loads(_native.loop_report(None, text, _text(model), vertical, sensors))
    return reports


def loop(
    name: str,
    *,
    gains: Mapping[str, Any] | None = None,
    model: Model = None,
    vertical: str | None = None,
    sensors: str = "lab",
) -> dict[str, Any]:
    """Return one loop of the PID: margins, frequency response, root locus, and the step response with its figures.

    `name` is x, y, z or yaw. `gains` has the keys of the file that `crazyflie tune` writes; table 7.1 unless given.
    `sensors` is lab, whose camera is late, or ideal.

    Raises:
        ValueError: for an unknown name or form, with a proposal, and gains or a model file that are wrong.
        FileNotFoundError: if there is no such model file.
    """
    text = None if gains is None else json.dumps(dict(gains))
    report: dict[str, Any] = json.loads(_native.loop_report(name, text, _text(model), vertical, sensors))[0]
    return report


def plot(
    file: Path_,
    name: str | None = None,
    *,
    gains: Mapping[str, Any] | None = None,
    model: Model = None,
    vertical: str | None = None,
    sensors: str = "lab",
) -> None:
    """Draw Bode, Nyquist and root-locus plots and the step response of one loop, or of all.

    The ending of `file` decides: svg, png or pdf. The other arguments are those of `loop`.

    Raises:
        ValueError: as `loop`, and for another ending.
        FileNotFoundError: if there is no such model file.
        OSError: if the file cannot be written.
    """
    text = None if gains is None else json.dumps(dict(gains))
    picture = _native.loop_plots(os.fspath(file), name, text, _text(model), vertical, sensors)
    Path(file).write_bytes(picture)
