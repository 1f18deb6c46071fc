"""A case: what is drawn, both flights, and its four files."""

import csv
import gzip
import io
import json

import numpy as np

from .effects import EFFECTS, OUTSIDE, weakened
from .excitation import KINDS
from .firmware import Inner
from .flight import COLUMNS, FORMATS, ROW_S, LostControl, fly
from .sensors import DECLARED_LATENCY_S, NOISE
from .vehicle import MASS_KG, REFERENCE_V

GROUPS = ["null", "single", "compound", "outside"]
INNER_LOOPS = ["firmware", "plain"]
# True of rotorpy's vehicle beside its declared model, whatever is hidden: rotor drag, motor lag, exact geometry.
BENIGN = ["drag_linear", "motor_lag", "rigid_body", "tilt_loss", "euler_kinematics", "exact_tan"]
ATTEMPTS = 4


def draw(number, group, args):
    """Effects and circumstances of a case, by its own generator: a case does not depend on how many there are."""
    rng = np.random.default_rng([args.seed, number])
    noise = args.noise or str(rng.choice(["low", "mid", "mid", "high", "aruco"]))
    table = OUTSIDE if group == "outside" else EFFECTS
    chosen = [name for name in (args.effects or table) if name in table]
    count = {"null": 0, "compound": 2}.get(group, 1)
    names = [str(n) for n in rng.choice(chosen, count, replace=False)]
    # a pair that wants different vehicles wants the one with less memory
    inner = next((table[n].inner for n in names if table[n].inner), str(rng.choice(INNER_LOOPS)))
    kind = str(rng.choice(table[names[0]].kinds if names else KINDS[:-2]))
    return {
        "id": f"d{number:04d}",
        "group": group,
        "effects": [(n, table[n].draw(rng)) for n in names],
        "benign": BENIGN + sorted({b for n in names for b in table[n].benign}),
        "inner": inner,
        "kind": kind,
        "noise": noise,
        "lost": args.lost,
        "gap_s": args.gap,
        "seconds": max(args.seconds, 2 * args.seconds if kind == "drain" else 0.0),
        "seed": args.seed,
        "number": number,
    }


def fly_case(case):
    """Both flights; an effect that makes the vehicle leave the room is weakened."""
    for attempt in range(ATTEMPTS):
        hidden = {key: value for _, values in case["effects"] for key, value in values.items()}
        hidden["stiffness_ps2"] = Inner.stiffness_ps2(case["inner"])
        try:
            logs = []
            for part in range(2):
                rng = np.random.default_rng([case["seed"], case["number"], attempt, 1 + part])
                drain_vps = 0.003 if case["kind"] == "drain" else rng.uniform(0.0012, 0.0020)
                logs.append(fly(hidden, case["inner"], case["kind"], case["seconds"], case["noise"], rng, drain_vps))
            return logs
        except LostControl:
            case["effects"] = [(name, weakened(values)) for name, values in case["effects"]]
    return None


def table_bytes(log):
    """A log as gzipped CSV, the same bytes each time."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(COLUMNS)
    for row in log.rows:
        writer.writerow("" if np.isnan(v) else form % v for form, v in zip(FORMATS, row, strict=True))
    return gzip.compress(text.getvalue().encode(), 6, mtime=0)


def documents(case, declared, saturation):
    """What a user knows, and the truth."""
    name, sigma = case["id"], NOISE[case["noise"]]
    attitude = {key: declared[key] for key in ("n0", "d1", "d0")} | {"input": "command deg -> rad", "output": "rad"}
    height = {"az": "g*(pwm/hover_pwm - 1) - heave*vz", "hover_pwm": declared["hover_pwm"], "heave": declared["heave"]}
    model = {"attitude": attitude, "lateral": "ax = g*pitch, ay = -g*roll, turned by yaw; no drag", "height": height}
    model["yaw"] = {"r_dot": "k*(-cmd_yawrate - r)", "k": declared["k"]}
    hint = {"sigma_xy": sigma[0], "sigma_z": sigma[1], "sigma_angle_deg": sigma[2]}
    sensors = {
        "position_hz": 30,
        "t_cam": f"capture time as stamped by the ground station, {DECLARED_LATENCY_S} s before arrival",
    }
    sensors |= {"imu_hz": 100, "noise_hint": hint}
    known = {
        "id": name,
        "identify_on": f"{name}_a.csv.gz",
        "held_out": f"{name}_b.csv.gz",
        "declared_model": model,
        "sensors": sensors,
    }
    known |= {"controller": {"gains": case["inner"], "rate_hz": 50}, "mass_kg": MASS_KG, "vbat_ref": REFERENCE_V}
    truth = {"id": name, "generator": "rotorpy", "group": case["group"], "tier": f"rotorpy-{case['inner']}"}
    truth |= {"effects": [{"name": n, "params": p} for n, p in case["effects"]]}
    truth |= {
        "answer": [n for n, _ in case["effects"]] or ["none"],
        "benign": case["benign"],
        "excitation": [case["kind"]] * 2,
    }
    truth |= {"noise": case["noise"], "gains": case["inner"], "duration_s": case["seconds"], "seed": case["seed"]}
    truth["command_saturation_share"] = saturation
    return {f"{name}.json": known, f"{name}.answer.json": truth}


def kept_rows(case, part):
    """Which rows the log of a flight holds: rows are lost at random, and a gap is left in the middle."""
    rows = round(case["seconds"] / ROW_S)
    rng = np.random.default_rng([case["seed"], case["number"], ord(part)])
    kept = rng.random(rows) >= case["lost"]
    half = round(0.5 * case["gap_s"] / ROW_S)
    kept[rows // 2 - half : rows // 2 + half] = False
    return kept


def make(case, declared, out):
    """Flies a case and writes its four files."""
    logs = fly_case(case)
    if logs is None:
        return f"{case['id']} {case['group']}: leaves the room however weak, skipped"
    saturation = float(np.mean(np.abs(logs[0].rows[:, 5:7]) > 9.99))
    for part, log in zip("ab", logs, strict=True):
        log.rows = log.rows[kept_rows(case, part)]
        (out / f"{case['id']}_{part}.csv.gz").write_bytes(table_bytes(log))
    for name, document in documents(case, declared[case["inner"]], saturation).items():
        (out / name).write_text(json.dumps(document, indent=1) + "\n")
    return f"{case['id']} {case['group']} {case['inner']} {case['kind']} {case['noise']} {case['effects']}"
