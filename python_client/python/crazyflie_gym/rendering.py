"""Pictures of flights: as arrays, and in a terminal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from crazyflie_gym import _native
from crazyflie_gym._types import Backend, BoolArray, FloatArray
from crazyflie_gym.options import EnvOptions, to_json
from crazyflie_gym.spaces import split

RENDER_MODES = ["rgb_array", "human"]
WIDTH, HEIGHT = 480, 360
_TRAIL = 400
_FRAME_S = 0.04
_PATH_TICKS = 1000


def check_render_mode(mode: str | None) -> str | None:
    """Return the mode.

    Raises:
        ValueError: if there is no such mode.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise ValueError(f"render_mode is {mode!r}, expected None, {', '.join(map(repr, RENDER_MODES))}")
    return mode


class Screen:
    """Remembers where the drones of a simulation were, and draws them."""

    def __init__(self, sim: Backend, task: str, options: EnvOptions) -> None:
        self._sim = sim
        effects = options.get("effects") or {}
        self._markers = _markers(effects)
        fov_deg = _number(effects, "camera_fov", "diagonal_deg", 0.0)
        self._fov_rad = np.radians(fov_deg) if fov_deg > 0.0 else None
        by_camera = {entry["name"] for entry in _native.effects() if "frame" in entry["hooks"]}
        self._by_camera = any(name in by_camera for name in effects)
        task_options = to_json(**(options.get("task_options") or {}))
        # several drones have no one path
        several = sim.has_drone_axis
        self._path = (
            np.empty((0, 3), np.float32) if several else _native.path(task, task_options, sim.tick_s, _PATH_TICKS)
        )
        self._rows: FloatArray | None = None
        self._states = np.empty((0, sim.num_drones, 12), np.float32)
        self._past = np.empty((_TRAIL, sim.num_envs, sim.num_drones, 3), np.float32)
        self._ticks = 0
        # states of this episode, per environment
        self._known = np.zeros(sim.num_envs, np.int64)
        self._return = 0.0
        self._terminal = Terminal()

    def begin(self, rows: FloatArray, mask: BoolArray | None = None) -> None:
        """Begin episodes, in all environments or those of a mask, with these observations."""
        if mask is None or mask[0]:
            self._return = 0.0
            self._terminal.restart()
        self._remember(rows, mask)

    def record(self, rows: FloatArray, reward: float, begun: BoolArray | None = None) -> None:
        """Remember a step: observations, the first environment's reward, which ones began an episode."""
        self._return += reward
        if begun is not None and begun.any():
            self.begin(rows, begun)
        else:
            self._remember(rows, np.zeros(self._sim.num_envs, np.bool_))

    def _remember(self, rows: FloatArray, begun: BoolArray | None) -> None:
        envs, drones = self._sim.num_envs, self._sim.num_drones
        self._rows = rows.reshape(envs, drones, -1)
        self._states = self._sim.states().reshape(envs, drones, 12)
        self._past[self._ticks % _TRAIL] = self._states[..., :3]
        self._ticks += 1
        self._known[slice(None) if begun is None else begun] = 0
        self._known += 1

    def picture(self, env: int, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
        """Return a picture of an environment, uint8 (height, width, 3).

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self._rows is None:
            raise ResetNeeded("call reset() before render()")
        rows, states = self._rows[env], self._states[env]
        count = min(int(self._known[env]), _TRAIL)
        # a server's rows may lack it
        has_fix = self._by_camera and len(rows) == 1 and bool(np.isfinite(rows[0, :3]).all())
        when = np.arange(self._ticks - count, self._ticks) % _TRAIL
        return _native.render(
            width,
            height,
            drones=np.ascontiguousarray(states[:, [0, 1, 2, 6, 7, 8]]),
            trail=np.ascontiguousarray(self._past[when, env].swapaxes(0, 1)),
            setpoint=np.ascontiguousarray(split(rows)["setpoint"][:, :3]),
            path=self._path,
            markers=self._markers,
            fix=rows[0, :3].copy() if has_fix else None,
            camera_fov_rad=self._fov_rad,
        )

    def show(self) -> None:
        """Show the first environment in the terminal, at the pace of the flight.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self._rows is None:
            raise ResetNeeded("call reset() before render()")
        t_s = (int(self._known[0]) - 1) * self._sim.tick_s
        x, y, z = self._states[0, 0, :3]
        status = f"t {t_s:6.2f} s   x {x:+.2f}  y {y:+.2f}  z {z:+.2f} m   return {self._return:8.2f}"
        self._terminal.show(t_s, status, lambda width, height: self.picture(0, width, height))

    def close(self) -> None:
        """Leave the terminal in order."""
        self._terminal.close()


class Terminal:
    """Half blocks in 24-bit colour on a terminal; elsewhere one line per second of flight."""

    def __init__(self) -> None:
        self._drawn = False
        self.restart()

    def restart(self) -> None:
        """A flight begins: its clock starts with the next picture."""
        self._began: float | None = None
        self._next_s = 0.0

    def show(self, t_s: float, status: str, picture: Any) -> None:
        """Show the flight at its time `t_s`, or wait until it is time for the next picture."""
        if not sys.stdout.isatty():
            if t_s + 1e-6 >= self._next_s:
                self._next_s = np.floor(t_s + 1e-6) + 1.0
                print(status, flush=True)
            return
        now = time.monotonic()
        if self._began is None:
            self._began = now - t_s
        time.sleep(max(0.0, self._began + t_s - now))
        if t_s + 1e-6 < self._next_s:
            return
        self._next_s = t_s + _FRAME_S
        columns, lines = os.get_terminal_size(sys.stdout.fileno())
        # a character is twice as high as wide; two lines are left for the status
        columns = max(8, min(columns, (lines - 2) * 2 * WIDTH // HEIGHT, 160))
        text = _native.ansi(picture(columns * 3, columns * 3 * HEIGHT // WIDTH), columns)
        sys.stdout.write(("\x1b[H" if self._drawn else "\x1b[2J\x1b[H") + text + status + "\x1b[K\n")
        sys.stdout.flush()
        self._drawn = True

    def close(self) -> None:
        """Colours off."""
        if self._drawn:
            sys.stdout.write("\x1b[0m\n")
            self._drawn = False


def _number(effects: Mapping[str, Any], name: str, param: str, default: float) -> float:
    """Return a parameter of an effect, the default where it is not given or drawn anew for every episode."""
    given = effects.get(name, {})
    first = next(entry["params"][0]["name"] for entry in _native.effects() if entry["name"] == name)
    if not isinstance(given, Mapping) or not any(key in given for key in (param, first)):
        given = {first: given}
    value = given.get(param, default)
    if isinstance(value, Mapping):
        value = value.get("value", default)
    return float(value)


def _markers(effects: Mapping[str, Any]) -> FloatArray:
    """Return the markers on the floor as rows of x, y, yaw."""
    columns, rows = (int(_number(effects, "markers", side, 1.0)) for side in ("columns", "rows"))
    pitch_m = _number(effects, "markers", "pitch_m", 0.5)
    x = (np.arange(columns) - 0.5 * (columns - 1)) * pitch_m
    y = (np.arange(rows) - 0.5 * (rows - 1)) * pitch_m
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.concatenate([grid, np.zeros((len(grid), 1))], axis=1).astype(np.float32)
