"""Draws the thesis's graphs from the simulator as SVG, under their own numbers.

python examples/thesis/figures.py out/figures

Its sketches and block diagrams (5.1, 5.3, 5.6, 5.7, 5.9, 5.11, 5.14, 5.16) hold no data and are not drawn.
One picture has both of a pair that the thesis draws apart, with the old and the new gains (7.5 and 7.6, ...).
"""

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from flights import DRAG_MODEL, RIG, STEP_DEG, YAW_DEGPS, crazyflie, fly, recorded
from identify import SENSORS
from scorecard import GAINS, LEVEL, MARKER_M, SEEDS, fixes, numbers, second_order

LAB = SENSORS["camera rig"]
STEP_S = "time after the step (s)"
COLOURS = {"without drag": "#d55e00", "with drag": "#0072b2", "with drag, thrust form": "#009e73"}
COMMAND, MODEL, ERROR = {"color": "r", "drawstyle": "steps-post"}, {"color": "k", "ls": "--"}, {"color": "purple"}


def save(folder, number, title, panels, reach_m=None):
    """Draw panels side by side: each is a title, labels of x and y, and curves (x, y, label, style).

    Panels of one quantity share their axes. A reach in y, or in x and y with the marker, cuts off a diverging flight.
    """
    size, share = (4.5 * len(panels) + 2.5, 5.2), len({y for _, _, y, _ in panels}) == 1
    figure, axes = plt.subplots(
        1, len(panels), figsize=size, layout="compressed", squeeze=False, sharex=share, sharey=share
    )
    handles = {}
    for axis, (name, x, y, curves) in zip(axes[0], panels, strict=True):
        for at, values, label, style in curves:
            handles[label] = axis.plot(at, values, **style)[0]
        axis.set(title=name, xlabel=x, ylabel=y)
        axis.grid(alpha=0.3)
        if reach_m:
            *reach_x, reach_y = reach_m
            axis.set(ylim=(-reach_y, reach_y))
            if reach_x:
                side_m = 2.0 * MARKER_M
                marker = plt.Rectangle((-MARKER_M, -MARKER_M), side_m, side_m, fill=False, lw=2)
                handles["marker"] = axis.add_patch(marker)
                axis.set(xlim=(-reach_x[0], reach_x[0]), aspect="equal")
        if share:
            axis.label_outer()
    figure.suptitle(f"Figure{'s' * (' ' in number)} {number}: {title}")
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=4)
    figure.savefig(folder / f"figure_{number.replace(' and ', '_').replace('.', '_')}.svg")
    plt.close(figure)


def angles(folder, tilt):
    """5.2, 5.4, 5.5, 5.8: commanded angles and the IMU's."""
    for i, axis in enumerate(["roll", "pitch"]):
        flight = recorded(1.2, "pwm", LAB, before_s=0.5, tilt=i)
        t_s = flight["t_s"]
        imu = (t_s, flight[f"imu_{axis}_deg"], f"{axis} by the IMU", {})
        command = (t_s, flight[f"cmd_{axis}_deg"], "command", COMMAND)
        exact = (t_s, STEP_DEG * second_order(tilt, np.maximum(t_s, 0.0))[0], "by 5.1", MODEL)
        drawn = {"5.5": ("roll, and the pitch's transfer function 5.1 for it", [imu, exact])}
        if axis == "pitch":
            drawn = {"5.2": ("pitch command of 7.5 degrees and pitch", [imu, command])}
            drawn["5.4"] = ("pitch and its simulation by 5.1", [imu, exact])
        for number, (title, curves) in drawn.items():
            save(folder, number, title, [("", STEP_S, "angle (deg)", curves)])
    flight = recorded(10.0, "pwm", LAB, before_s=0.5, tilt=2)
    t_s, yaw_deg = flight["t_s"], np.degrees(np.unwrap(np.radians(flight["imu_yaw_deg"])))
    exact_deg = -YAW_DEGPS * np.maximum(t_s, 0.0)
    curves = [(t_s, yaw_deg, "yaw by the IMU", {}), (t_s, exact_deg, "by 5.2", MODEL)]
    panels = [("", STEP_S, "yaw (deg)", curves)]
    panels.append(("", STEP_S, "error (deg)", [(t_s, yaw_deg - exact_deg, "error", ERROR)]))
    save(folder, "5.8", "yaw at 36 deg/s and its simulation by 5.2", panels)


def marker_height(flight):
    """Return the curve of the marker's heights, one point per frame."""
    seen = np.isfinite(flight["marker_z_m"])
    return flight["marker_t_s"][seen], flight["marker_z_m"][seen], "by the marker", {"marker": ".", "lw": 0.8}


def heights(folder, height, pwm):
    """5.10, 5.12, 5.13, 5.15: 70 to 80 cm, by the height command and by the PID's PWM."""
    gain, pole = height
    flight = recorded(6.0, "height", RIG, before_s=2.0, lifts=[0.7, 0.8])
    t_s, seen = flight["t_s"], marker_height(flight)
    exact_m = (0.8 - 0.1 * np.exp(-pole * np.maximum(t_s, 0.0))) * gain / pole
    error_cm = 100.0 * (seen[1] - np.interp(seen[0], t_s, exact_m))
    command = (t_s, np.where(t_s < 0.0, 0.7, 0.8), "command", COMMAND)
    save(folder, "5.10", "height command and height", [("", STEP_S, "height (m)", [seen, command])])
    panels = [("", STEP_S, "height (m)", [seen, (t_s, exact_m, "by 5.3", MODEL)])]
    panels.append(("", STEP_S, "error (cm)", [(seen[0], error_cm, "error", ERROR)]))
    save(folder, "5.12", "height and its simulation by 5.3", panels)
    gain, pole, offset = pwm
    flight = recorded(6.0, "pwm", RIG, before_s=2.0, height_m=0.8)
    t_s, command = flight["t_s"], flight["cmd_thrust_pwm"]
    curves = [(t_s, command, "PWM", {"drawstyle": "steps-post"})]
    save(folder, "5.13", "PWM of the PID from 70 to 80 cm", [("", STEP_S, "thrust PWM", curves)])
    kept, exact_m = np.exp(-pole * np.diff(t_s)), [flight["true_z_m"][0]]
    for share, value in zip(kept, command[:-1], strict=True):
        exact_m.append(share * exact_m[-1] + (1.0 - share) * gain / pole * (value - offset))
    curves = [marker_height(flight), (t_s, exact_m, "by 5.4", MODEL)]
    save(folder, "5.15", "height and its simulation by 5.4", [("", STEP_S, "height (m)", curves)])


def speeds(folder, tilt, gravity):
    """5.17: speed at 7.5 degrees, by the marker's derivative, until the marker is lost."""
    curves, effects = [], RIG | {"camera_fov": {"diagonal_deg": 120.0}}
    for label, file in ("without drag", None), ("with drag", DRAG_MODEL):
        t_s, x_m = fixes(recorded(2.0, "height", effects, model=file, tilt=1, lifts=LEVEL), "x")
        middle_s = 0.5 * (t_s[1:] + t_s[:-1])
        speed_mps = np.diff(x_m) / np.diff(t_s)
        curves.append((middle_s, speed_mps, f"marker's derivative, {label}", {"color": COLOURS[label]}))
    exact_mps = gravity * np.radians(STEP_DEG) * second_order(tilt, middle_s)[1]
    curves.append((middle_s, exact_mps, "by 5.5", MODEL))
    save(folder, "5.17", "speed at 7.5 degrees of pitch", [("", STEP_S, "speed (m/s)", curves)])


def flown(name, gains, axes):
    """Return curves of a flight through the camera, seed 0: one axis over time, or the second over the first."""
    forms = {"without drag": ("pwm", None), "with drag": ("pwm", DRAG_MODEL)}
    if axes == "z":
        forms["with drag, thrust form"] = ("thrust", DRAG_MODEL)
    curves = []
    for label, (vertical, file) in forms.items():
        flight = fly(name, GAINS[gains], vertical, SEEDS, True, file)[0]
        columns = [flight.pos_m[:, "xyz".index(axis)] for axis in axes]
        if len(axes) == 1:
            columns.insert(0, np.arange(len(flight.pos_m)) * flight.tick_s)
        curves.append((*columns, label, {"color": COLOURS[label]}))
    return curves


def closed_loop(folder):
    """7.4 to 7.14: the flights of section 7.3, old gains against new."""

    def compare(number, title, name, axes, reach_m=None):
        x, y = ["time (s)", *(f"{axis} (m)" for axis in axes)][-2:]
        panels = [(f"{gains} gains", x, y, flown(name, gains, axes)) for gains in GAINS]
        save(folder, number, title, panels, reach_m)

    for i, name, title, (reach_x, reach_y) in (
        (4, "fly-80cm", "80 cm to the marker", (0.9, 0.5)),
        (10, "hover-70cm", "hover at 70 cm", (0.3, 0.2)),
    ):
        compare(f"7.{i}", f"{title}, path from above", name, "xy", (reach_x, reach_y))
        compare(f"7.{i + 1} and 7.{i + 2}", f"{title}, x", name, "x", (reach_x,))
        compare(f"7.{i + 3} and 7.{i + 4}", f"{title}, y", name, "y", (reach_y,))
    compare("7.9", "take-off to 70 cm", "takeoff-70cm", "z")


def draw(folder):
    """Draw all figures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    model = json.loads(crazyflie("model", "--json"))
    tilt, vertical = numbers(model["pitch"], "gain", "damping", "stiffness"), model["vertical"]
    angles(folder, tilt)
    heights(folder, numbers(vertical["height"], "gain", "pole"), numbers(vertical["pwm"], "gain", "pole", "offset"))
    speeds(folder, tilt, *numbers(model["lateral"], "gravity"))
    path = folder / "figure_7_3.svg"
    crazyflie("fly", "--task", "whole-flight", "--sensors", "lab", "--model", DRAG_MODEL, "--picture3d", path)
    path.write_text(path.read_text().replace("whole-flight,", "Figure 7.3: whole flight with drag,"))
    closed_loop(folder)


def main():
    """Draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    draw(parser.parse_args().folder)


if __name__ == "__main__":
    main()
