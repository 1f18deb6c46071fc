"""The log of a deployment: the project's CSV with both clocks, and what was set beside it."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crazyflie_gym.deploy.state import Command, Fix, Sample

FLUSH_ROWS = 25
AXES = ("x", "y", "z")


class Recorder:
    """Writes a row for each tick, so that a log is kept whatever ends the program.

    Args:
        path: of the CSV; what was set goes beside it, with .json at its end.
        vertical: whether commands are heights ("height") or thrusts.
    """

    def __init__(self, path: Path, vertical: str) -> None:
        self.path, self.settings_path = path, path.with_name(path.name + ".json")
        self._lift = "cmd_height_m" if vertical == "height" else "cmd_thrust_pwm"
        self._file: Any = None
        self._writer: Any = None
        self.rows = 0
        self._first_ms: int | None = None
        self._last_ms: int | None = None

    def add(
        self,
        clock_ms: int,
        sample: Sample,
        command: Command,
        setpoint: tuple[float, float, float, float],
        fix: Fix,
        clocks: Mapping[str, float],
    ) -> None:
        """Write a tick: what was measured, what was sent then, and a fix where a new one came.

        `clock_ms` is the vehicle's clock at the tick. A tick that is no later than the last one is left out.
        """
        if self._last_ms is not None and clock_ms <= self._last_ms:
            return
        self._last_ms = clock_ms
        self._first_ms = clock_ms if self._first_ms is None else self._first_ms
        t_s = (clock_ms - self._first_ms) / 1000
        row: dict[str, float | str] = {"t_s": t_s}
        row |= {f"setpoint_{axis}_m": value for axis, value in zip(AXES, setpoint[:3], strict=True)}
        row["setpoint_yaw_deg"] = math.degrees(setpoint[3])
        row["cmd_roll_deg"], row["cmd_pitch_deg"] = math.degrees(command.roll_rad), math.degrees(command.pitch_rad)
        row["cmd_yaw_rate_degps"] = math.degrees(command.yaw_rate_radps)
        row[self._lift] = command.lift
        seen = (*fix.pos_m, math.degrees(fix.yaw_rad), t_s - fix.age_s) if fix.is_new else None
        for i, name in enumerate(("marker_x_m", "marker_y_m", "marker_z_m", "marker_yaw_deg", "marker_t_s")):
            row[name] = "" if seen is None else seen[i]
        row |= {
            f"imu_{name}_deg": math.degrees(a) for name, a in zip(("roll", "pitch", "yaw"), sample.att_rad, strict=True)
        }
        row |= {f"gyro_{axis}_radps": value for axis, value in zip(AXES, sample.gyro_radps, strict=True)}
        row |= {f"acc_{axis}_mps2": value for axis, value in zip(AXES, sample.acc_mps2, strict=True)}
        row["vbat_v"] = sample.vbat_v
        row["vehicle_clock_ms"] = clock_ms
        row |= clocks
        if self._writer is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(self.path, "w", newline="", encoding="utf-8")  # noqa: SIM115
            self._writer = csv.DictWriter(self._file, list(row))
            self._writer.writeheader()
        self._writer.writerow(row)
        self.rows += 1
        if self.rows % FLUSH_ROWS == 0:
            self._file.flush()

    def close(self, settings: Mapping[str, Any], summary: Mapping[str, Any]) -> None:
        """End the log, and write what was set and how it ended; nothing if nothing was flown."""
        if self._file is None:
            return
        self._file.close()
        text = json.dumps({"settings": settings, "summary": summary}, indent=2)
        self.settings_path.write_text(text + "\n", encoding="utf-8")
