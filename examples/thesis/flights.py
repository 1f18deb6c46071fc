"""The thesis's flights: closed loop in batches of seeds, and the identification flights of chapter 5 as recordings."""

import csv
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from crazyflie_gym import CrazyflieVectorEnv, Pid
from crazyflie_gym.training import LAB

RIG = {name: LAB[name] for name in ("camera", "camera_latency", "camera_noise")}
"""The lab's camera: `crazyflie fly --sensors lab`."""
STEP_DEG, YAW_DEGPS, HEIGHT_M, HOVER_S = 7.5, 36.0, 0.7, 10.0
"""5.1: the step of roll and pitch and that of yaw, "after 10 seconds" of hover."""
ROOM_M = np.float32([2.5, 2.5, 2.8])
SETPOINT_Z = 18
DRAG_MODEL = Path(__file__).parents[2] / "env/models/cf2-thesis-drag.toml"
"""The thesis's model with the drag that `fit_drag.py` fitted."""
# task, start, seconds, and the state of the controller
CLOSED_LOOP = {
    "fly-80cm": ("hover", {"start_m": [0.8, 0.0, 0.7]}, 15.0, "automatic"),
    "takeoff-70cm": ("takeoff", None, 20.0, "takeoff"),
    "hover-70cm": ("hover", {"start_m": [0.0, 0.0, 0.7]}, 20.0, "automatic"),
}


@dataclass
class Flight:
    """One flight, tick by tick, until its end."""

    pos_m: np.ndarray
    pitch_command_deg: np.ndarray
    left_room: bool
    tick_s: float


@cache
def fly(name, controller, vertical, seeds, rig, model=None):
    """Fly one of the flights of section 7.3 with the seeds 0, 1, ...; returns a `Flight` of each.

    The model is a file or the text of one, the thesis's unless given.
    """
    task, task_options, seconds, mode = CLOSED_LOOP[name]
    env = CrazyflieVectorEnv(
        seeds,
        task,
        model=model,
        vertical=vertical,
        effects=RIG if rig else {},
        task_options=task_options,
        true_state=True,
        max_episode_steps=-1,
    )
    pilot, interface = env.controller(controller, mode), env.interface
    _, info = env.reset(seed=0)
    positions, pitches, ended = [], [], [np.zeros(seeds, bool)]
    for _ in range(round(seconds / interface.tick_s) + 1):
        actions = env.act(pilot)
        positions.append(info["true_state"][:, :3].copy())
        pitches.append(actions[:, 1].astype(float))
        _, _, terminated, _, info = env.step(actions)
        ended.append(terminated)
    positions, pitches, ended = np.array(positions), np.array(pitches), np.array(ended)[:-1]
    flights = []
    for i in range(seeds):
        ends = ended[:, i].any()
        last = np.argmax(ended[:, i]) if ends else len(ended) - 1
        left = ends and (np.abs(positions[last, i]) > ROOM_M).any()
        pitch_deg = np.degrees(pitches[: last + 1, i] * interface.tilt_max_rad)
        flights.append(Flight(positions[: last + 1, i].astype(float), pitch_deg, bool(left), interface.tick_s))
    return flights


class Step:
    """The controller of the identification flights: it hovers for 10 s, then holds a command.

    Args:
        num_envs: how many vehicles.
        interface: what their actions mean.
        tilt: number of the command that is held: 0 roll, 1 pitch, 2 yaw rate; none for a step of height alone.
        height_m: where to after the hover.
        lifts: height or PWM before and after, in place of the thesis's PID.
    """

    def __init__(self, num_envs, interface, *, tilt=None, height_m=HEIGHT_M, lifts=None):
        self._pid, self._interface = Pid(num_envs, interface, "thesis"), interface
        self._tilt, self._heights_m, self._lifts = tilt, (HEIGHT_M, height_m), lifts
        self._tick = 0

    def act(self, rows):
        """Return the actions of a tick."""
        after = self._tick >= round(HOVER_S / self._interface.tick_s)
        self._tick += 1
        if self._lifts:
            actions = np.zeros((len(rows), 4))
            actions[:, 3] = self._lifts[after] * (2.0 / self._interface.lift_max) - 1.0
        else:
            rows = rows.copy()
            rows[:, SETPOINT_Z] = self._heights_m[after]
            actions = self._pid.act(rows)
        if after and self._tilt is not None:
            limits = 2 * [self._interface.tilt_max_rad] + [self._interface.yaw_rate_max_radps]
            command = np.radians(YAW_DEGPS if self._tilt == 2 else STEP_DEG)
            actions[:, self._tilt] = command * (1.0 / limits[self._tilt])
        return actions


def crazyflie(*args):
    """Run the program; returns what it prints. If it fails, it has told why, and the script ends with its status."""
    command = [Path(sys.executable).with_name("crazyflie"), *map(str, args)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.returncode)
    return done.stdout


def record(path, seconds, vertical, effects, seed=0, model=None, **step):
    """Fly an identification flight, with so many seconds after the hover, and record it as CSV."""
    options = ["--seconds", HOVER_S + seconds, "--vertical", vertical, "--effects", json.dumps(effects)]
    options += ["--model", model] if model else []
    controller = ["--controller", f"python:{__file__}:Step", "--controller-options", json.dumps(step)]
    crazyflie("fly", "--task", "hover-70cm", *options, *controller, "--seed", seed, "--csv", path)


def recorded(seconds, vertical, effects, before_s=0.0, **step):
    """Fly an identification flight; returns its columns by name, SI units and degrees, gaps as NaN.

    They start `before_s` before the step, which is at 0 s.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.csv"
        record(path, seconds, vertical, effects, **step)
        with path.open(newline="") as file:
            header, *rows = csv.reader(file)
    numbers = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    columns = dict(zip(header, numbers[numbers[:, 0] > HOVER_S - before_s - 5e-3].T, strict=True))
    for name in ("t_s", "marker_t_s"):
        columns[name] -= HOVER_S
    return columns
