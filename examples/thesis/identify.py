"""Flies the thesis's identification flights, records and identifies them: its equations must come back.

python examples/thesis/identify.py [MODEL] [--seed 0] [--json]
"""

import argparse
import json
import tempfile
from pathlib import Path

from flights import RIG, crazyflie, record
from tables import number, plain

# the thesis gives no error of the angles; this is the scatter of a Crazyflie at hover
SENSORS = {"ideal": {}, "camera rig": RIG | {"gyro_bias": {"angle_noise_deg": 0.2}}}
# experiment, equation, channel, vertical form, seconds, step, and where the model has the numbers of the channel
# fmt: off
EXPERIMENTS = [
    ("pitch 7.5 deg (5.1.1)", "5.1", "pitch", "pwm", 1.2, {"tilt": 1}, "pitch"),
    ("roll 7.5 deg (5.1.1)", "5.1", "roll", "pwm", 1.2, {"tilt": 0}, "roll"),
    ("yaw 36 deg/s (5.1.2)", "5.2", "yaw", "pwm", 10.0, {"tilt": 2}, "yaw"),
    ("height 70 to 80 cm (5.1.3)", "5.3", "height", "height", 6.0, {"height_m": 0.8}, "vertical.height"),
    ("height by PWM (5.1.3)", "5.4", "pwm", "pwm", 6.0, {"height_m": 0.8}, "vertical.pwm"),
    # 5.5 is 5.1 times g / s
    ("speed at 7.5 deg (5.1.4)", "5.5", "command-vx", "pwm", 1.2, {"tilt": 1}, "pitch"),
]
# fmt: on
# of a part of the model, in the order of a channel's
NUMBERS = ("gain", "damping", "stiffness", "pole", "offset")
PWM_FLIGHTS = ("pitch", "roll", "yaw", "pwm")
# every number of the whole model starts 30 % off, an offset 10 %: one of 45500 would be above every command
WRONG, WRONG_OFFSET = 1.3, 0.9
HEADER = ["equation", "experiment", "sensors", "number", "true", "estimate", "s.e.", "off by", "in s.e.", "fit"]
LEGEND = """\
Each flight hovers at 70 cm by the thesis's PID for 10 s and then does what 5.1 says. Ideal: the controller and the log
have the true pose at 50 Hz. Camera rig: 30 Hz frames, 50 ms late, with 5 mm (x, y) and 10 mm (z) of noise, and angles
with 0.2 degrees. Fit: MATLAB's, of that flight. Without noise, what is left is the recording's 32-bit rounding, and
standard errors are below what it does.
"""


def entry(model, path):
    """Return the part of a model that holds a number, a dict with its value."""
    for name in path.split("."):
        model = model[name]
    return model


def recover(model_file, seed, folder):
    """Return every number that comes back from the flights, beside the one that they were flown with."""
    model, found = json.loads(crazyflie("model", *model_file, "--json")), []
    for sensors, effects in SENSORS.items():
        for experiment, equation, channel, vertical, seconds, step, part in EXPERIMENTS:
            log = folder / f"{channel}.csv"
            record(log, seconds, vertical, effects, seed, *model_file, **step)
            # a simulated flight needs no new start: nothing disturbs it
            options = ["--window", "whole", "--fit", log, "--json"]
            fitted = json.loads(crazyflie("identify", "--transfer", channel, *options))["transfer_functions"][0]
            known = entry(model, part)
            truths = [known[name]["value"] for name in NUMBERS if known.get(name)]
            truths[0] *= model["lateral"]["gravity"]["value"] if equation == "5.5" else 1.0
            about = {"equation": equation, "experiment": experiment, "sensors": sensors}
            about["fit_percent"] = fitted["fit"]["logs"][0]["windows"]["fit_percent"]
            estimates = zip(truths, fitted["parameters"], strict=True)
            found += [about | {"true": true, "estimate": estimate} for true, estimate in estimates]
        found += whole_model(
            model, sensors, [folder / f"{name}.csv" for name in ("pitch", "roll", "yaw", "pwm")], folder
        )
    return found


def whole_model(model, sensors, logs, folder):
    """Return the model's numbers, all at once from the flights that PWM commands, from numbers that are 30 % off."""
    start, options = folder / "start.json", ["--vertical", "pwm", "--json", "--fit", *logs]
    start.write_text(json.dumps(model))
    names = [p["name"] for p in json.loads(crazyflie("identify", start, *options))["parameters"]]
    wrong = json.loads(json.dumps(model))
    for path in names:
        entry(wrong, path)["value"] *= WRONG_OFFSET if path.endswith(".offset") else WRONG
    start.write_text(json.dumps(wrong))
    about = {"equation": "4.15", "experiment": "all PWM flights, all numbers", "sensors": sensors, "fit_percent": None}
    estimates = json.loads(crazyflie("identify", start, *options))["parameters"]
    return [about | {"true": entry(model, e["name"])["value"], "estimate": e} for e in estimates]


def cells(line):
    """Return what was recovered as text."""
    estimate, true, fit = line["estimate"], line["true"], line["fit_percent"]
    off, error = estimate["value"] - true, estimate["standard_error"]
    numbers = [f"{value:.5g}" for value in (true, estimate["value"], error)]
    by = f"{number(100.0 * abs(off / true), 2)} %" if true else f"{abs(off):.5g}"
    errors = "" if line["sensors"] == "ideal" else number(off / error, 1)
    about = [line["equation"], line["experiment"], line["sensors"], estimate["name"]]
    return [*about, *numbers, by, errors, "" if fit is None else f"{number(fit, 2)} %"]


def main():
    """Print what was recovered."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="*", help="model file that flies; the thesis's unless given")
    parser.add_argument("--seed", type=int, default=0, help="decides the noise")
    parser.add_argument("--json", action="store_true", help="for machines")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = recover(args.model[:1], args.seed, Path(folder))
    print(
        json.dumps(found, indent=2) if args.json else f"{plain(HEADER, list(map(cells, found)), (1, 2, 3))}\n{LEGEND}",
        end="",
    )


if __name__ == "__main__":
    main()
