"""Small laboratories with motion capture: each identifies its vehicle on normal flights, then explains flights in which
one thing is different. Vehicle, controller and cause are simulated without code of the project.

    python tests/population/labs.py OUT --cases 20 --seed 1 --jobs 2
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np

PROGRAM = [sys.executable, "-m", "crazyflie_gym"]
G, DT_S, LOG_S, SECONDS = 9.81, 0.001, 0.01, 24.0
MAPPING = """\
frame = "z-up"
position = "motion_capture"
attitude = "motion_capture"
[time]
column = "t"
unit = "s"
[channels]
x = { column = "x", unit = "m" }
y = { column = "y", unit = "m" }
z = { column = "z", unit = "m" }
roll = { column = "roll", unit = "rad" }
pitch = { column = "pitch", unit = "rad" }
yaw = { column = "yaw", unit = "rad" }
cmd_roll = { column = "cmd_roll", unit = "rad" }
cmd_pitch = { column = "cmd_pitch", unit = "rad" }
cmd_yaw_rate = { column = "cmd_yawrate", unit = "rad/s" }
cmd_thrust = { column = "cmd_thrust", unit = "fraction" }
"""
# range of each cause's size, either sign where True, and the right names
CAUSES = {
    "none": (0.0, 0.0, False, ()),
    "weight": (0.06, 0.25, False, ("mass_change", "thrust_scale", "battery_sag")),
    "drag": (0.25, 0.8, False, ("drag_linear", "drag_quadratic")),
    "wind": (0.3, 1.0, True, ("wind", "imu_tilt", "marker_tilt", "estimator_tilt")),
    "frame_yaw": (0.09, 0.17, True, ("frame_yaw", "camera_mount")),
    "delay": (0.04, 0.09, False, ("cmd_delay", "attitude_order")),
    "gain": (0.15, 0.3, True, ("attitude_gain", "inertia_scale", "alloc_cross")),
    "slope": (0.15, 0.35, True, ("thrust_slope",)),
    "heave": (0.4, 1.2, False, ("heave_damping",)),
    "motor_lag": (0.05, 0.1, False, ("motor_lag",)),
    "tilt_frame": (0.02, 0.06, True, ("marker_tilt", "imu_tilt", "estimator_tilt", "wind")),
    "swing": (0.08, 0.2, False, ("slung_load",)),
    # nothing of the library: a force towards a place, a wind that grows with height, damping by vz |vz|, lift lost in
    # descents alone
    "place": (0.5, 1.2, False, ()),
    "shear": (0.8, 2.0, True, ("wind",)),
    "heave_square": (0.8, 2.0, False, ("heave_damping",)),
    "descent": (0.3, 0.8, False, ()),
}
INDEX = {name: i for i, name in enumerate(CAUSES)}


@numba.njit(cache=True)
def fly(seed, vehicle, amplitudes_m, frequencies_radps, phases, cause, size):
    """One flight: rows of t, position, roll, pitch, yaw, commands. `vehicle` holds the numbers of `draw_vehicle`."""
    np.random.seed(seed)
    gain, damping, stiffness, drag, lag_s, heave, shake, heading, length_m = vehicle
    position, velocity, angle, rate = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2)
    position[2] = 1.0
    yaw, lift, total, force = np.random.normal(0.0, 0.05), 1.0, 0.0, np.zeros(3)
    ticks, every = int(SECONDS / DT_S), round(LOG_S / DT_S)
    rows = np.zeros((ticks // every, 11))
    command, late, yaw_rate = np.zeros(3), np.zeros((200, 3)), 0.0
    late[:, 2] = 1.0
    lag_s = lag_s + (size if cause == 9 else 0.0)
    swing, swing_rate = np.zeros(2), np.zeros(2)
    offset = size if cause == 10 else 0.0
    for k in range(ticks):
        t = k * DT_S
        if k % every == 0:
            wave, slope = np.zeros(3), np.zeros(3)
            for axis in range(3):
                for part in range(2):
                    at = frequencies_radps[axis, part] * t + phases[axis, part]
                    wave[axis] += amplitudes_m[axis, part] * np.sin(at)
                    slope[axis] += amplitudes_m[axis, part] * frequencies_radps[axis, part] * np.cos(at)
            wave[2] += 1.0
            seen = position.copy()
            if cause == 4:
                seen[0] = np.cos(size) * position[0] - np.sin(size) * position[1]
                seen[1] = np.sin(size) * position[0] + np.cos(size) * position[1]
            seen += 0.0005 * np.random.normal(0.0, 1.0, 3)
            error, speed = wave - position, slope - velocity
            total = min(max(total + error[2] * LOG_S, -1.0), 1.0)
            wish = 4.0 * error + 3.0 * speed
            command[0] = min(max((np.sin(yaw) * wish[0] - np.cos(yaw) * wish[1]) / G, -0.4), 0.4)
            command[1] = min(max((np.cos(yaw) * wish[0] + np.sin(yaw) * wish[1]) / G, -0.4), 0.4)
            command[2] = min(max(1.0 + (wish[2] + 2.0 * total) / G, 0.4), 1.7)
            row = rows[k // every]
            row[0], row[1:4] = t, seen
            row[4] = angle[0] + offset * np.cos(heading) + 0.001 * np.random.normal()
            row[5] = angle[1] + offset * np.sin(heading) + 0.001 * np.random.normal()
            row[6] = yaw + 0.001 * np.random.normal()
            row[7:9], row[9], row[10] = command[:2], yaw_rate, 0.5 * command[2]
        if k % 2000 == 0:
            yaw_rate = np.random.normal(0.0, 0.06) - 0.3 * yaw
        late[k % 200] = command
        back = int(size / DT_S) if cause == 5 else 0
        asked = late[(k - back) % 200]
        scale = 1.0 + (size if cause == 6 else 0.0)
        for axis in range(2):
            rate[axis] += DT_S * (gain * scale * asked[axis] - damping * rate[axis] - stiffness * angle[axis])
            angle[axis] += DT_S * rate[axis]
        yaw += DT_S * yaw_rate
        wanted = asked[2]
        if cause == 7:
            wanted = 1.0 + (1.0 + size) * (wanted - 1.0)
        lift += DT_S / lag_s * (wanted - lift)
        push = lift * G / (1.0 + (size if cause == 1 else 0.0))
        cos_roll, cos_pitch = np.cos(angle[0]), np.cos(angle[1])
        ahead, left = push * np.sin(angle[1]) * cos_roll, -push * np.sin(angle[0])
        force = force * (1.0 - DT_S / 0.5) + shake * np.sqrt(2.0 * DT_S / 0.5) * np.random.normal(0.0, 1.0, 3)
        acceleration = force.copy()
        acceleration[0] += np.cos(yaw) * ahead - np.sin(yaw) * left
        acceleration[1] += np.sin(yaw) * ahead + np.cos(yaw) * left
        acceleration[2] += push * cos_roll * cos_pitch - G * (1.0 + (size if cause == 11 else 0.0))
        total_drag = drag + (size if cause == 2 else 0.0)
        acceleration[:2] -= total_drag * velocity[:2]
        acceleration[2] -= (heave + (size if cause == 8 else 0.0)) * velocity[2]
        if cause == 3 or cause == 13:
            strength = size if cause == 3 else size * (position[2] - 0.6)
            acceleration[0] += strength * np.cos(heading)
            acceleration[1] += strength * np.sin(heading)
        if cause == 11:
            # the thrust lifts both on a taut thread
            acceleration[2] /= 1.0 + size
            pull = G + acceleration[2]
            for axis in range(2):
                acceleration[axis] += size * pull * swing[axis]
                bend = -pull / length_m * swing[axis] - 0.25 * swing_rate[axis] - acceleration[axis] / length_m
                swing_rate[axis] += DT_S * bend
                swing[axis] += DT_S * swing_rate[axis]
        if cause == 12:
            acceleration[:2] -= size * (position[:2] - 0.5)
        if cause == 14:
            acceleration[2] -= size * velocity[2] * abs(velocity[2])
        if cause == 15 and velocity[2] < 0.0:
            acceleration[2] += size * velocity[2]
        velocity += DT_S * acceleration
        position += DT_S * velocity
    return rows


def draw_vehicle(rng):
    """Attitude gain, damping and stiffness, drag, motor lag, heave damping, how much the air shakes it, and of the
    laboratory the direction of its wind and tilt, and the length of a thread."""
    natural = rng.uniform(9.0, 26.0)
    return np.array([
        natural**2 * rng.uniform(0.92, 1.08), 2 * rng.uniform(0.6, 1.1) * natural, natural**2,
        rng.uniform(0.15, 0.5), rng.uniform(0.02, 0.06), rng.uniform(0.0, 0.4), rng.uniform(0.03, 0.12),
        rng.uniform(0.0, 2 * np.pi), rng.uniform(0.45, 0.85),
    ])  # fmt: skip


def write_flights(folder, rng, vehicle, cause, size):
    """Five flights, of which the first two are to be fitted; the paths."""
    folder.mkdir(parents=True)
    (folder / "mapping.toml").write_text(MAPPING)
    paths = []
    for flight in range(5):
        amplitudes_m = np.array([[0.5], [0.35], [0.12]]) * rng.uniform(0.3, 0.8, (3, 2))
        frequencies = 2 * np.pi * rng.uniform([[0.08, 0.25]] * 3, [[0.22, 0.5]] * 3)
        phases = rng.uniform(0, 2 * np.pi, (3, 2))
        rows = fly(int(rng.integers(1 << 31)), vehicle, amplitudes_m, frequencies, phases, INDEX[cause], size)
        paths.append(folder / f"flight{flight}.csv")
        header = "t,x,y,z,roll,pitch,yaw,cmd_roll,cmd_pitch,cmd_yawrate,cmd_thrust"
        np.savetxt(paths[-1], rows, "%.8g", ",", header=header, comments="")
    return paths


def run(program, *words):
    """A finished command."""
    return subprocess.run(list(map(str, (*program, *words))), capture_output=True, text=True, check=False)


def judge(found, cause):
    """In a word: right, listed (as a trim that flights share), silent (nothing wrong is said), or wrong."""
    # every vehicle has a motor lag, which normal flights are not asked for
    names, right = {effect["name"] for effect in found["effects"]} - {"motor_lag"}, CAUSES[cause][3]
    if names - set(right) or (found["verdict"] == "nothing_missing" and cause != "none"):
        return "WRONG"
    if names or not right:
        return "right"
    return "listed" if found["shared_trims"] else "silent"


def case(number, args):
    """The line of a laboratory."""
    rng = np.random.default_rng([args.seed, number])
    name = list(CAUSES)[number % len(CAUSES)]
    low, high, both, _ = CAUSES[name]
    size = rng.uniform(low, high) * (rng.choice([-1, 1]) if both else 1)
    vehicle, folder = draw_vehicle(rng), args.out / f"{number:03}_{name}"
    normal = write_flights(folder / "normal", rng, vehicle, "none", 0.0)
    changed = write_flights(folder / "changed", rng, vehicle, name, size)
    model = folder / "vehicle.toml"
    done = run(args.program, "identify", "--fit", *normal[:3], "--test", *normal[3:], "--out", model)
    if not done.returncode:
        flights = ["--fit", *changed[:2], "--test", *changed[2:]]
        done = run(args.program, "explain", model, *flights, "--out", folder / "found", "--json")
    if done.returncode:
        return f"{number:3} {name:12} {size:6.3f}  ERROR   {done.stderr.strip().splitlines()[-1]}"
    found = json.loads(done.stdout)
    named = "; ".join(
        f"{e['name']} " + " ".join(f"{key}={p['value']:.3g}" for key, p in e["params"].items())
        for e in found["effects"]
    )
    laws = [
        left["finding"].split(" by another law")[0] for left in found["leftover"] if "another law" in left["finding"]
    ]
    answer = "; ".join([f"{found['verdict']}: {named or '-'}", *laws]) + f"  {found['seconds']:.0f} s"
    return f"{number:3} {name:12} {size:6.3f}  {judge(found, name):6}  {answer}"


def main():
    """Make laboratories and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=len(CAUSES))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="a cause")
    parser.add_argument("--program", nargs="+", default=PROGRAM)
    args = parser.parse_args()
    numbers = [n for n in range(args.cases) if list(CAUSES)[n % len(CAUSES)].startswith(args.only)]
    with ThreadPoolExecutor(args.jobs) as pool:
        for line in pool.map(lambda number: case(number, args), numbers):
            print(line, flush=True)


if __name__ == "__main__":
    main()
