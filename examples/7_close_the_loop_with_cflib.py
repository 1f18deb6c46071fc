"""A Crazyflie that nobody described is flown over cflib, explained from its logs, and another flight of it foretold.

The vehicle is `crazyflie cf2` with effects that only it knows, in lock-step: as fast as the machine flies it, and the
same bits each time. A real one needs another address instead.
"""

import contextlib
import csv
import json
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

# only the vehicle knows: drag of the air, which neither the model nor what follows is told of
HIDDEN = '{"drag_linear": 0.6}'
PROGRAM = [sys.executable, "-m", "crazyflie_gym"]
CONTROLLER = ["--controller", "thesis-pid", "--vertical", "thrust"]


def steps(places, every_s):
    """Task options that send the vehicle from place to place: x, y, z, yaw."""
    rows = [
        {"from_s": every_s * i, "setpoint_m": place[:3], "setpoint_yaw_deg": place[3]} for i, place in enumerate(places)
    ]
    return json.dumps({"setpoint_m": [0, 0, 0.5], "steps": rows})


FLIGHTS = {
    "flight1": (steps([(0.8, 0, 0.7, 0), (-0.6, 0.5, 0.5, 60), (0.5, -0.6, 0.9, 120), (-0.7, 0, 0.6, 0)], 3), 12),
    "flight2": (steps([(0, 0.8, 0.6, -60), (0.6, -0.6, 0.8, 0), (-0.6, -0.4, 0.5, 90), (0.6, 0.6, 0.7, 0)], 3), 12),
    # another kind of flight, held out
    "flight3": (steps([(0.9, 0.3, 0.8, 0), (-0.9, -0.3, 0.6, 0), (0, 0, 0.7, 0)], 4), 12),
}


def crazyflie(*args):
    """Run the program, and return what it says."""
    return subprocess.run([*PROGRAM, *map(str, args)], stdout=subprocess.PIPE, check=True, text=True).stdout


@contextlib.contextmanager
def vehicle(seed):
    """A simulated Crazyflie; its address."""
    options = ["--effects", HIDDEN, "--seed", str(seed), "--lockstep", "--port", "0", "--json"]
    process = subprocess.Popen([*PROGRAM, "cf2", *options], stdout=subprocess.PIPE, text=True)
    try:
        yield json.loads(process.stdout.readline())["drones"][0]["udp"]
    finally:
        process.terminate()
        process.wait()


def path(file, flown):
    """Time since the first set-point, and places, of the ticks in which the task was flown."""
    with open(file, newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row["marker_x_m"]]
    goal = [(float(row["setpoint_x_m"]), float(row["setpoint_y_m"])) for row in rows]
    first = next(i for i, place in enumerate(goal) if place != goal[0]) if flown else 0
    table = np.array([[float(row[name]) for name in ("t_s", "marker_x_m", "marker_y_m", "marker_z_m")] for row in rows])
    return table[first:, 0] - table[first, 0], table[first:, 1:]


def main():
    for seed, (name, (options, seconds)) in enumerate(FLIGHTS.items()):
        with vehicle(seed) as uri:
            task = ["--task-options", options, "--duration", seconds, "--log", f"{name}.csv"]
            told = json.loads(crazyflie("deploy", "--lockstep", "--uri", uri, *CONTROLLER, *task, "--json"))
        print(f"{name}: {told['detail']}, {told['rows']} rows, {told['missed']} samples missed")
    logs = ["--fit", "flight1.csv", "flight2.csv", "--test", "flight3.csv", "--vertical", "thrust"]
    crazyflie("explain", "thesis", *logs, "--out", "found")
    print(json.loads(Path("found/report.json").read_text())["sentence"])
    options, seconds = FLIGHTS["flight3"]
    at_s, real = path("flight3.csv", flown=True)
    options = json.dumps(json.loads(options) | {"start_m": real[0].tolist()})
    plt.figure(figsize=(8, 4))
    plt.plot(at_s, real[:, 0], "k", label="flown")
    for name, model in (("declared model", []), ("completed model", ["--model", "found/model.toml"])):
        crazyflie("fly", "--task-options", options, "--seconds", seconds, *CONTROLLER, *model, "--csv", "told.csv")
        told_s, told = path("told.csv", flown=False)
        # the landing of the flight is not foretold
        at = at_s < min(told_s[-1], seconds)
        off = [np.interp(at_s[at], told_s, told[:, i]) - real[at, i] for i in range(3)]
        print(f"{name}: foretells the flight within {100 * np.sqrt(np.mean(np.square(off)) * 3):.2f} cm rms")
        plt.plot(told_s, told[:, 0], "--", label=name)
    plt.gca().set(xlabel="s", ylabel="x, m", title="a flight that was held out")
    plt.legend()
    plt.savefig("7_close_the_loop_with_cflib.png", dpi=100)
    print("the picture is 7_close_the_loop_with_cflib.png, the report found/report.html")


if __name__ == "__main__":
    main()
