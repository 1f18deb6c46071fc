"""Runs every experiment of the thesis on the simulator, and prints its figures beside ours, without drag and with it.

python examples/thesis/scorecard.py
python examples/thesis/scorecard.py --markdown    # the table that docs/thesis.md holds
"""

import argparse
import json
import math
import textwrap
from dataclasses import dataclass, replace

import numpy as np
from flights import DRAG_MODEL, RIG, STEP_DEG, YAW_DEGPS, crazyflie, fly, recorded
from tables import markdown, number

# the thesis reads most of its figures off plots, with words like "almost"
TOLERANCE = 0.25
GAINS = {"old": "stock-pid", "new": "thesis-pid"}
SEEDS = 15
# "over the marker": within half its side of 197 mm; the height counts as stable within 5 cm
MARKER_M, BAND_M = 0.0985, 0.05
LEVEL = [0.7, 0.7]
NEEDS_RECORDING = "the fit is to the lab's recording; ours is the simulator against the equation"
OURS = ["ideal", "camera", "ideal, drag", "camera, drag"]
HEADER = ["experiment", "thesis", "gains", "quantity", "thesis's figure", *OURS, "why"]
LEGEND = """\
Ideal: the controller knows the true position at every 50 Hz tick. Camera: 30 Hz frames, 50 ms late, with 5 mm (x, y)
and 10 mm (z) of noise at 70 cm; median over 15 seeds. Drag: {drag} 1/s, fitted by fit_drag.py to four figures of the
80 cm flights. "*" is within 25 % of the thesis's figure, about what its words and plots can be read to, "!" is not. A
row differs if it has no "*". Old gains: `crazyflie_ros` defaults, since the thesis does not print what it flew before
table 7.1. {rows} rows differ without drag, {rows_drag} with it. A take-off is flown in two vertical forms, of which
only 5.4 is the thesis's: no row meets {unmet} of the thesis's figures without drag, {unmet_drag} with it.
"""


@dataclass
class Row:
    """One line of the scorecard: our figures, ideal and through the camera, beside what the thesis says.

    `claim` are the thesis's words, `figure` the number that they state, if any, and `most` whether it is a limit.
    `drag` is the same row, flown with drag.
    """

    place: str
    experiment: str
    gains: str
    quantity: str
    unit: str
    decimals: int
    claim: str
    figure: float | None = None
    most: bool = False
    why: str = ""
    ideal: float | None = None
    rig: float | None = None
    drag: "Row | None" = None

    def compare(self, value):
        """Return a figure of ours for machines: how far it is from the thesis's, and whether the two agree."""
        if value is None:
            return None
        off = agrees = None
        if self.figure is not None:
            off = max(value - self.figure, 0.0) if self.most else value - self.figure
            agrees = bool(off <= 0.0 if self.most else abs(off) <= TOLERANCE * abs(self.figure))
        if not math.isfinite(value):
            value = off = None
        return {"value": value, "unit": self.unit, "deviation": off, "agrees": agrees}

    def mark(self):
        """Return which of our figures agree with the thesis's."""
        compared = {"ideal": self.compare(self.ideal), "rig": self.compare(self.rig)}
        agrees = {name: ours["agrees"] for name, ours in compared.items() if ours and ours["agrees"] is not None}
        if not agrees:
            return "not comparable"
        names = [name for name, good in agrees.items() if good]
        return "differs" if not names else "agrees" if len(names) == len(agrees) else f"{names[0]} agrees"

    def cell(self, value):
        """Return a figure of ours as text, marked if the thesis has one."""
        if value is None:
            return ""
        ours = self.compare(value)
        # three digits are enough, and those of an unstable flight mean little
        text = "never" if ours["value"] is None else number(value, 0 if abs(value) >= 99.995 else self.decimals)
        return text if ours["agrees"] is None else f"{text}{'*' if ours['agrees'] else '!'}"

    def cells(self):
        """Return quantity with unit, the thesis's words, and all figures of ours as text."""
        ours = [row.cell(value) for row in (self, self.drag) for value in (row.ideal, row.rig)]
        return [f"{self.quantity} ({self.unit})", self.claim, *ours]

    def reason(self):
        """Return why it differs, with drag first; none where its figure through the camera agrees."""
        return next(
            (r.why for r in (self.drag, self) if r.why and not (r.mark() == "agrees" and r.rig is not None)), ""
        )

    def as_json(self):
        """Return the row for machines."""
        ours = {"mark": self.mark(), "ideal": self.compare(self.ideal), "rig": self.compare(self.rig)}
        return {**vars(self), **ours, "drag": self.drag and self.drag.as_json()}


def fit_percent(measured, model):
    """Return MATLAB's fit: 100 is perfect, 0 is no better than the mean."""
    return 100.0 * (1.0 - np.linalg.norm(measured - model) / np.linalg.norm(measured - measured.mean()))


def second_order(tilt, t_s):
    """Return the step response of gain / (s^2 + damping s + stiffness), overdamped as 5.1 is, and its integral."""
    gain, damping, stiffness = tilt
    root = math.sqrt(0.25 * damping * damping - stiffness)
    slow, fast = 0.5 * damping - root, 0.5 * damping + root
    step = 1.0 - (fast * np.exp(-slow * t_s) - slow * np.exp(-fast * t_s)) / (fast - slow)
    parts = [(1.0 - np.exp(-pole * t_s)) / pole for pole in (slow, fast)]
    return gain / stiffness * step, gain / stiffness * (t_s - (fast * parts[0] - slow * parts[1]) / (fast - slow))


def fixes(flight, axis):
    """Return capture times after the step, and what the marker says of an axis then."""
    seen = flight["marker_t_s"] >= 0.0
    return flight["marker_t_s"][seen], flight[f"marker_{axis}_m"][seen]


def numbers(part, *names):
    """Return numbers of a part of the model."""
    return [part[name]["value"] for name in names]


def tilts(model, file):
    """5.1.1: 7.5 degrees of pitch, then of roll."""
    rows = []
    for axis, claim, place in ("pitch", 69.33, "5.1.1, fig. 5.2-5.4"), ("roll", 65.36, "5.1.1, fig. 5.5"):
        flight = recorded(1.2, "height", {}, model=file, tilt=["roll", "pitch"].index(axis), lifts=LEVEL)
        tilt, angle_deg = numbers(model[axis], "gain", "damping", "stiffness"), flight[f"true_{axis}_deg"]
        fit = fit_percent(angle_deg, STEP_DEG * second_order(tilt, flight["t_s"])[0])
        exact = STEP_DEG * second_order(tilt, 1.0)[0]
        about = (place, f"{axis} step of 7.5 deg", "")
        rows += [
            Row(*about, "fit of 5.1", "%", 2, f"fit {claim} %", why=NEEDS_RECORDING, ideal=fit),
            Row(*about, "angle after 1 s", "deg", 2, f"{exact:.2f} deg by 5.1", exact, ideal=angle_deg[50]),
        ]
    return rows


def yaw(_model, file):
    """5.1.2: 36 deg/s."""
    flight = recorded(10.0, "height", {}, model=file, tilt=2, lifts=LEVEL)
    turned_deg = flight["true_yaw_deg"]
    fit = fit_percent(turned_deg, -YAW_DEGPS * flight["t_s"])
    about = ("5.1.2, fig. 5.8", "yaw at 36 deg/s", "")
    return [
        Row(*about, "fit of 5.2", "%", 2, "by hand; automatic 20 %", why=NEEDS_RECORDING, ideal=fit),
        Row(*about, "turned in 10 s", "deg", 2, "-360 deg by 5.2", -360.0, ideal=turned_deg[-1]),
    ]


def height_step(file, vertical, lifts, before_m, after_m, pole):
    """Return the height 6 s after a step in cm, flown and exact, and the marker's times, heights and exact ones."""
    end_m = recorded(6.0, vertical, {}, model=file, lifts=lifts)["true_z_m"][-1]
    t_s, z_m = fixes(recorded(6.0, vertical, RIG, model=file, lifts=lifts), "z")
    exact_m = after_m - (after_m - before_m) * np.exp(-pole * np.append(t_s, 6.0))
    return 100.0 * end_m, 100.0 * exact_m[-1], z_m, exact_m[:-1]


def height(model, file):
    """5.1.3: the height command from 70 to 80 cm."""
    gain, pole = numbers(model["vertical"]["height"], "gain", "pole")
    ends_m = [z_m * gain / pole for z_m in (0.7, 0.8)]
    ours, exact, z_m, exact_m = height_step(file, "height", [0.7, 0.8], *ends_m, pole)
    largest, about = 100.0 * np.abs(z_m - exact_m).max(), ("5.1.3, fig. 5.12", "height 70 to 80 cm", "")
    record = "a fit needs the lab's recording: it grows with the span of the record, and ours is the 10 cm step alone"
    noise, fit = "our marker noise is white, 10 mm, without the lab's outliers of 10 cm", fit_percent(z_m, exact_m)
    return [
        Row(*about, "fit of 5.3 to the marker", "%", 2, "77.76 %", 77.76, why=record, rig=fit),
        Row(*about, "largest error of 5.3", "cm", 1, "about 10 cm", 10.0, why=noise, rig=largest),
        Row(*about, "height 6 s later", "cm", 1, f"{exact:.1f} cm by 5.3", exact, ideal=ours),
    ]


def pwm(model, file):
    """5.1.3: the same step by PWM."""
    gain, pole, offset = numbers(model["vertical"]["pwm"], "gain", "pole", "offset")
    lifts = [offset + pole * z_m / gain for z_m in (0.7, 0.8)]
    ours, exact, z_m, exact_m = height_step(file, "pwm", lifts, 0.7, 0.8, pole)
    fit, words = fit_percent(z_m, exact_m), '"not as accurate"'
    about = ("5.1.3, fig. 5.15", "height 70 to 80 cm by PWM", "")
    return [
        Row(*about, "fit of 5.4 to the marker", "%", 2, words, why=NEEDS_RECORDING, rig=fit),
        Row(*about, "height 6 s later", "cm", 1, f"{exact:.1f} cm by 5.4", exact, ideal=ours),
    ]


def angle_speed(model, file):
    """5.1.4: 7.5 degrees until the marker leaves the camera's field of view."""
    view = {"camera_fov": {"diagonal_deg": 120.0}}
    tilt, [gravity] = numbers(model["pitch"], "gain", "damping", "stiffness"), numbers(model["lateral"], "gravity")
    push_mps2 = gravity * math.radians(STEP_DEG)
    flight = recorded(2.0, "height", view, model=file, tilt=1, lifts=LEVEL)
    # the first frame without the marker
    lost = int(np.searchsorted(flight["t_s"], np.nanmax(flight["marker_t_s"]) + 1.0 / 30.0 - 1e-4))
    since_s = float(flight["t_s"][lost])
    t_s, x_m = fixes(recorded(since_s, "height", RIG | view, model=file, tilt=1, lifts=LEVEL), "x")
    middle_s, exact = 0.5 * (t_s[1:] + t_s[:-1]), push_mps2 * second_order(tilt, since_s)[1]
    fit = fit_percent(np.diff(x_m) / np.diff(t_s), push_mps2 * second_order(tilt, middle_s)[1])
    fov = "field of view of 120 degrees over the diagonal"
    poor = "poor there and here for the same reason: the derivative of a noisy position"
    slower = "5.5 has no drag: with it the vehicle is slower, and the marker stays in view for longer" if file else ""
    about, wanted = ("5.1.4, fig. 5.17", "pitch 7.5 deg until the marker is lost", ""), "not as good as wanted"
    way, speed = 100.0 * flight["true_x_m"][lost], flight["true_vx_mps"][lost]
    return [
        Row(*about, "marker lost after", "s", 2, "not given", why=fov, ideal=since_s),
        Row(*about, "way until then", "cm", 1, "not given", ideal=way),
        Row(*about, "speed then", "m/s", 3, f"{exact:.3f} m/s by 5.5", exact, why=slower, ideal=speed),
        Row(*about, "fit of 5.5 to the marker", "%", 2, f'"{wanted}"', why=poor, rig=fit),
    ]


def overshoot(values, target):
    """Return how far values that come from below go beyond the target."""
    return max(0.0, float(values.max() - target))


def swing_after_peak(values, target):
    """Return the largest deviation after the first peak, from the return to the target on."""
    above = np.flatnonzero(values > target)
    back = np.flatnonzero(values[above[0] :] <= target) if len(above) else above
    return float(np.abs(values[above[0] + back[0] :] - target).max()) if len(back) else 0.0


def stable_s(values, target, band, tick_s):
    """Return the seconds until the values stay within the band for good; infinite if they never do."""
    outside = np.flatnonzero(np.abs(values - target) > band)
    last = outside[-1] + 1 if len(outside) else 0
    return math.inf if last == len(values) else last * tick_s


def in_the_air(flight):
    """Return the height from lift-off on."""
    z_m = flight.pos_m[:, 2]
    return z_m[np.argmax(z_m > 0.01) :]


def off_centre_m(flight):
    """Return the root mean square distance from the marker."""
    return math.sqrt(np.square(flight.pos_m[:, :2]).sum(axis=1).mean())


def travel_degps(flight):
    """Return how far the pitch command travels per second."""
    return np.abs(np.diff(flight.pitch_command_deg)).sum() / (len(flight.pitch_command_deg) * flight.tick_s)


# quantity, unit, decimals, and what it is of a flight
LEAVES = ("leaves the room", "% of flights", 0, lambda f: 100.0 * f.left_room)
BEYOND = ("overshoot", "cm", 1, lambda f: 100.0 * overshoot(-f.pos_m[:, 0], 0.0))
OVER = ("over the marker after", "s", 1, lambda f: stable_s(f.pos_m[:, 0], 0.0, MARKER_M, f.tick_s))
RISE = ("overshoot", "cm", 1, lambda f: 100.0 * overshoot(in_the_air(f), 0.7))
SWING = ("fluctuation after it", "cm", 1, lambda f: 100.0 * swing_after_peak(in_the_air(f), 0.7))
STAYS = ("stable after lift-off", "s", 1, lambda f: stable_s(in_the_air(f), 0.7, BAND_M, f.tick_s))
OFF = ("RMS distance from the centre", "cm", 1, lambda f: 100.0 * off_centre_m(f))
TRAVEL = ("pitch command's travel", "deg/s", 1, travel_degps)
LOW_MARGIN = "without drag the old gains have under 2 degrees of phase margin, and none from 10 ms of delay on"
SOME_MARGIN = "without drag the new gains have 19 degrees of phase margin, 9 with 77 ms of delay"
LATE = "the camera's 50 ms keep the old gains swinging; without the delay they settle in 8 s"
FIRST_ORDER = "5.4 is first order: it has no inertia that could carry the vehicle over"
SWINGS = "5.4 has no inertia; through the camera the old gains swing sideways too, and the tilt enters the height error"
NOISE = "5.4 has no inertia to fluctuate by: the camera's noise shakes it, and without noise it is 0.4 cm"
DELAYS = "5.4 has no inertia, so ideal it is quicker than the lab, and a camera 50 ms late makes it slower"
PRESET = "the ramp hands over a thrust above the weight, which the integral then has to unwind"
CYCLE = "without drag the old gains are unstable with this delay: the swing grows until the room ends"
CALM = "the new gains have half the derivative gain: through a noisy camera they are the calmer ones"
NO_EXIT = (LEAVES, "no", 0.0, True)
# by gains: measure, the thesis's words, the figure in them, and whether it is a limit
TO_MARKER = {
    "old": [(BEYOND, "almost 50 cm", 50.0), (OVER, "about 4.5 s", 4.5), NO_EXIT],
    "new": [(BEYOND, "small, within the marker", 9.85, True), (OVER, "about 2 s", 2.0), NO_EXIT],
}
TAKE_OFF = {
    "old": [(RISE, "almost 25 cm", 25.0), (SWING, "10 cm", 10.0), (STAYS, "about 7 s", 7.0)],
    "new": [(RISE, "remains, no figure"), (SWING, "none", 5.0, True), (STAYS, "about 3 s", 3.0)],
}
HOVER = {
    "old": [(OFF, '"quite good"'), (TRAVEL, "smooth"), NO_EXIT],
    "new": [(OFF, "more accurate"), (TRAVEL, "brusquer"), NO_EXIT],
}
# section 7.3: place, experiment, flight, vertical form, measures, reasons by gains and measure without drag and with it
# fmt: off
CLOSED_LOOP = [
    ("7.3, fig. 7.4-7.8", "80 cm to the marker", "fly-80cm", "pwm", TO_MARKER,
     {"old": LOW_MARGIN, "new": SOME_MARGIN}, {("old", OVER): LATE}),
    ("7.3, fig. 7.9", "take-off to 70 cm, on 5.4", "takeoff-70cm", "pwm", TAKE_OFF,
     {"old": SWINGS, "new": FIRST_ORDER}, {"old": FIRST_ORDER, ("old", SWING): NOISE, ("new", STAYS): DELAYS}),
    ("7.3, fig. 7.9", "take-off to 70 cm, thrust form", "takeoff-70cm", "thrust", TAKE_OFF,
     {"old": PRESET, "new": PRESET}, {"old": PRESET, "new": PRESET}),
    ("7.3, fig. 7.10-7.14", "hover at 70 cm", "hover-70cm", "pwm", HOVER,
     {"old": CYCLE, ("new", TRAVEL): CALM}, {("new", TRAVEL): CALM}),
]
# fmt: on


def closed_loop(file, place, experiment, name, vertical, measures, *whys):
    """Return the rows of a flight of section 7.3: old gains against new."""
    rows, whys = [], whys[bool(file)]
    for gains, pid in GAINS.items():
        # with the true position a hover stands still
        ideal = None if measures is HOVER else fly(name, pid, vertical, 1, False, file)[0]
        rig = fly(name, pid, vertical, SEEDS, True, file)
        for measure, claim, *figure in measures[gains]:
            *quantity, of = measure
            middle = np.mean if measure is LEAVES else np.median
            ours = {"ideal": None if ideal is None else of(ideal), "rig": float(middle([of(flight) for flight in rig]))}
            why = whys.get((gains, measure), whys.get(gains, ""))
            rows.append(Row(place, experiment, gains, *quantity, claim, *figure, why=why, **ours))
    return rows


def flown(file=None):
    """Return the rows of a model file, the thesis's model unless given."""
    model = json.loads(crazyflie("model", *[file] if file else [], "--json"))
    rows = [row for experiment in (tilts, yaw, height, pwm, angle_speed) for row in experiment(model, file)]
    return rows + [row for flight in CLOSED_LOOP for row in closed_loop(file, *flight)]


def scorecard():
    """Return all rows, in the order of the thesis, each with its row with drag."""
    return [replace(row, drag=drag) for row, drag in zip(flown(), flown(DRAG_MODEL), strict=True)]


def unmet(rows):
    """Return the figures of the thesis that differ in every row: a take-off has one on 5.4 and one in thrust form."""
    marks = {}
    for row in rows:
        marks.setdefault((row.place, row.gains, row.quantity), []).append(row.mark())
    return [figure for figure, found in marks.items() if set(found) == {"differs"}]


def legend(rows):
    """Return what the table's words mean, and its counts."""
    words = {"drag": json.loads(crazyflie("model", DRAG_MODEL, "--json"))["lateral"]["drag"]["value"]}
    for name, each in {"": rows, "_drag": [row.drag for row in rows]}.items():
        words[f"rows{name}"] = sum(row.mark() == "differs" for row in each)
        words[f"unmet{name}"] = len(unmet(each))
    return textwrap.fill(LEGEND.format(**words), 100) + "\n"


def as_text(rows):
    """Return the table in 100 columns; reasons stand below it by their letters."""
    line, reasons = "{:4} {:33} {:24}{:>8}{:>8}{:>8}{:>8}  {}", {}
    text = [f"{'without drag':>79}{'with drag':>16}", line.format("", "", "thesis", *2 * ["ideal", "camera"], "why")]
    for before, row in zip([None, *rows[:-1]], rows, strict=True):
        if before is None or row.experiment != before.experiment:
            text.append(f"{row.experiment} ({row.place})")
        why = row.reason()
        letter = why and reasons.setdefault(why, chr(ord("a") + len(reasons)))
        text.append(line.format(row.gains, *row.cells(), letter).rstrip())
    notes = [textwrap.fill(f"{letter}: {why}", 100) for why, letter in reasons.items()]
    return "\n".join([*text, "", *notes, "", legend(rows)])


def table(rows):
    """Return rows as a table of Markdown; an experiment is named in its first line only."""
    cells, before = [], None
    for row in rows:
        about = ["", ""] if row.experiment == before else [row.experiment, row.place]
        cells.append([*about, row.gains, *row.cells(), row.reason()])
        before = row.experiment
    return markdown(HEADER, cells, left=(1, 2, 3, 4, 9))


def as_markdown(rows):
    """Return the table; where the thesis gives no figure, rows are there for the reader who unfolds them."""
    folded = [row for row in rows if row.mark() == "not comparable"]
    first = table([row for row in rows if row not in folded])
    summary = f"<summary>{len(folded)} more rows, which are not comparable</summary>"
    return f'{first}\n<details markdown="1">\n{summary}\n\n{table(folded)}\n</details>\n\n{legend(rows)}'


def main():
    """Print the scorecard."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shape = parser.add_mutually_exclusive_group()
    shape.add_argument("--json", action="store_true", help="for machines")
    shape.add_argument("--markdown", action="store_true", help="the table that docs/thesis.md holds")
    args = parser.parse_args()
    rows = scorecard()
    if args.json:
        print(json.dumps([row.as_json() for row in rows], indent=2))
    else:
        print(as_markdown(rows) if args.markdown else as_text(rows), end="")


if __name__ == "__main__":
    main()
