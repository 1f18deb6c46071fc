"""Fits the model to recorded flights, predicts others from their commands alone: the tables of docs/measured.md.

python examples/thesis/recorded.py ../shared/data [--quick] [--json] [--page docs/measured.md]
"""

import argparse
import json
import tempfile
from pathlib import Path

from flights import crazyflie
from tables import filled, markdown, number

# split by the description of the recordings: the first are fitted, the others only predicted; B9_trefoil_slow_rep12 and
# B9_trefoil_medium_rep10 hold no roll and pitch commands, so there is nothing to drive a model with
FIT = """B2_circle_fast_rep2 B8_star_fast_rep1 B2_circle_medium_rep2 B3_figure8_fast_rep1 B3_figure8_medium_rep2
B5_helix_medium_rep1 B6_linear_ramp_rep2 B7_oval_fast_rep2 B8_star_slow_rep1 B9_trefoil_fast_rep14
B10_lissajous_fast_rep1"""
TEST = "B7_oval_fast_rep3 B2_circle_slow_rep2 B3_figure8_slow_rep1 B8_star_medium_rep1 B9_trefoil_slow_rep15"
TILT = [f"{axis}.{name}" for axis in ("roll", "pitch") for name in ("gain", "damping", "stiffness")]
HOVER, HEAVE = "vertical.thrust.hover", "vertical.thrust.heave"
ALONE = ["--effects", "none", "--pwm-source", "command"]
SHARED = ["--trim", "false", *ALONE]
# fitted part, and options of `crazyflie identify`
STEPS = {
    "5.1, roll and pitch": [*SHARED, "--free", *TILT],
    "hover PWM": [*SHARED, "--free", HOVER],
    "all but 5.1": [*SHARED, "--free", HOVER, HEAVE, "lateral.drag"],
    "all numbers": SHARED,
    "and what each flight has of its own": ALONE,
    "and effects of the powertrain": [],
}
FIRST, LAST = "all numbers", "and effects of the powertrain"
HORIZONS = {"one_step": "0.02 s", "0.1_s": "0.1 s", "0.5_s": "0.5 s", "2_s": "2 s", "free_run": "free run"}
QUANTITIES = {"position_m": "position (m)", "velocity_mps": "velocity (m/s)", "attitude_rad": "attitude (rad)"}
MODELS = {"before": "thesis", "after": "explained", "naive": "nothing moves on"}


def study(data, quick):
    """Return what identify, explain and diagnose say of the recordings in a folder, which must be there."""
    # CrazyPAD: kinds of logs, in each the conditions, one of them the vehicle as it should be
    kinds, normal = [data / "crazypad" / kind for kind in ("controller_data", "motor_data")], "normal_flight"
    conditions = sorted({folder.name for kind in kinds for folder in kind.iterdir()} - {normal})
    pads = {name: [kind / name for kind in kinds if (kind / name).is_dir()] for name in [*conditions, normal]}
    fit, test = ([data / "nanobench" / f"{name}.csv.gz" for name in side.split()] for side in (FIT, TEST))
    logs = ["--fit", *fit[: 2 if quick else None], "--test", *test[: 1 if quick else None], "--json"]
    names = (FIRST, LAST) if quick else STEPS
    identified = {name: json.loads(crazyflie("identify", *STEPS[name], *logs)) for name in names}
    with tempfile.TemporaryDirectory() as folder:
        explained = json.loads(crazyflie("explain", "thesis", *logs, "--out", folder))
    diagnose = ["diagnose", "--normal", *pads[normal], "--json", "--suspect"]
    planted = {name: json.loads(crazyflie(*diagnose, *pads[name])) for name in conditions}
    return {"identified": identified, "explained": explained, "planted": planted}


def axis_errors(found, when="after"):
    """Return errors on the test flights by axis and horizon, `when` before or after the fit."""
    return {f"{e['axis']}, {e['horizon_s']:g} s ({e['unit']})": e[when] for e in found["axis_errors"]["test"]}


def identified_tables(steps):
    """Return errors of the models that were identified, and the numbers of the last."""
    models = {"nothing": axis_errors(steps[FIRST], "before")} | {name: axis_errors(s) for name, s in steps.items()}
    digits = {name: 4 if "rad" in name else 3 for name in models["nothing"]}
    rows = [[name, *(number(e, digits[axis]) for axis, e in errors.items())] for name, errors in models.items()]
    values = []
    for p, before in zip(steps[LAST]["parameters"], steps[LAST]["before"], strict=True):
        own = [number(v, 0 if abs(p["value"]) >= 1000 else 3) for v in (p["value"], p["standard_error"])]
        values.append([f"`{p['name']}`", number(before, 2), " +- ".join(own), p["unit"]])
    return markdown(["fitted", *digits], rows), markdown(["number", "thesis", "identified", "unit"], values, (3,))


def explained_tables(explained):
    """Return the effects that the thesis model lacks, errors over the horizon, and distances in closed loop."""
    effects = [(e["name"], name, p) for e in explained["effects"] for name, p in e["params"].items()]
    found = [[f"`{e}.{name}`", f"{p['value']:.3g} +- {p['stderr']:.1g}", p["unit"]] for e, name, p in effects]
    rows, error = [], explained["error"]
    for quantity, label in QUANTITIES.items():
        for when, model in MODELS.items():
            rows.append([label, model, *(number(error[when][quantity][horizon], 4) for horizon in HORIZONS)])
        p_values = [error["p_value"][quantity][horizon] for horizon in HORIZONS]
        text = ["" if p is None else "< 0.001" if p < 0.001 else number(p, 3) for p in p_values]
        rows.append([label, "p: thesis against explained", *text])
    loop = {MODELS[when]: explained["closed_loop"][when] for when in ("before", "after")}
    flown = [[m, number(d["predicted_m"], 3), number(d["predicted_tracking_m"], 3)] for m, d in loop.items()]
    flown.append(["the set-points themselves", number(loop["thesis"]["measured_tracking_m"], 3), ""])
    header = [
        f"{explained['closed_loop']['controller']} on",
        "distance from the measured flight (m)",
        "tracking error (m)",
    ]
    errors = markdown(["quantity", "model", *HORIZONS.values()], rows, (1,))
    return markdown(["effect", "found", "unit"], found, (2,)), errors, markdown(header, flown)


def planted_tables(planted):
    """Return what `crazyflie diagnose` says of each condition, as text."""
    for condition, found in planted.items():
        sides = [(side, s) for side in ("normal", "suspect") for s in found[side]]
        rows = [
            [f"{side} {s['name']}", str(s["flights"]), *(f"{100 * c:+.1f} %" for c in s["change"])] for side, s in sides
        ]
        rows.append(["all suspects, in standard deviations", "", *(number(z, 1) for z in found["z"])])
        table = markdown(["set-up", "flights", *found["demands"]], rows)
        yield f"### `{condition}`\n\n**{found['text']}**\n\n{table}" + "".join(
            f"\n- left out: {x}" for x in found["left_out"]
        )


def draw(error, file):
    """Draw error over horizon, logarithmic both: three orders of magnitude lie between the ends."""
    import matplotlib.pyplot as plt

    # the same numbers are the same file
    plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "crazyflie"})
    figure, panels = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    for panel, (quantity, label) in zip(panels, QUANTITIES.items(), strict=True):
        for (when, model), style in zip(MODELS.items(), ("C1-", "C2-", "C7--"), strict=True):
            errors = [error[when][quantity][horizon] for horizon in HORIZONS if horizon != "free_run"]
            panel.loglog([0.02, 0.1, 0.5, 2.0], errors, style, label=model)
        panel.set(xlabel="horizon (s)", title=label)
    panels[0].legend()
    figure.savefig(file, metadata={"Date": None})


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the recordings: nanobench, crazypad")
    parser.add_argument("--json", action="store_true", help="all figures for machines")
    parser.add_argument("--quick", action="store_true", help="two flights to fit, one to predict")
    parser.add_argument("--page", type=Path, help="put the tables into this page and its picture beside it")
    args = parser.parse_args()
    if missing := [name for name in ("nanobench", "crazypad") if not (args.data / name).is_dir()]:
        parser.error(f"{args.data}: expected a folder of recordings, but it lacks {', '.join(missing)}")
    found = study(args.data, args.quick)
    tables = [*identified_tables(found["identified"]), *explained_tables(found["explained"])]
    text = "\n".join([*tables, *planted_tables(found["planted"])])
    if args.page:
        draw(found["explained"]["error"], args.page.with_suffix("") / "errors.svg")
        args.page.write_text(filled(args.page, text))
    else:
        print(json.dumps(found, indent=2) if args.json else text)


if __name__ == "__main__":
    main()
