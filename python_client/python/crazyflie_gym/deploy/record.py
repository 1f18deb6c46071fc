"""The log of a deployment: the project's CSV with both clocks, and what was set beside it."""

from __future__ import annotations

import contextlib
import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazyflie_gym.deploy.state import Command, Fix, Sample, Setpoint

FLUSH_ROWS = 50
AXES = ("x", "y", "z")
MARKER = ("marker_x_m", "marker_y_m", "marker_z_m", "marker_yaw_deg", "marker_t_s")


@dataclass(frozen=True)
class Sent:
    """A command as it was sent, and when by the host's clock."""

    command: Command
    unix_s: float


class Recorder:
    """Writes a row for each sample, so that a log is kept whatever ends the program.

    Args:
        path: of the CSV; what was set goes beside it, with .json at its end.
        vertical: whether commands are heights ("height") or thrusts.
        firmware_revision: of the vehicle; 0 tells readers that it is a simulated one.
    """

    def __init__(self, path: Path, vertical: str, firmware_revision: int) -> None:
        self.path, self.settings_path = path, path.with_name(path.name + ".json")
        self._lift = "height_m" if vertical == "height" else "thrust_pwm"
        self._firmware_revision = firmware_revision
        self._file: Any = None
        self._writer: Any = None
        self.rows = 0
        self.problem = ""
        self._first_ms = 0

    def add(
        self, sample: Sample, command: Command, setpoint: Setpoint, fix: Fix, received_s: float, sent: Sent | None
    ) -> None:
        """Write a sample: the command in force, a fix where a new one came, and what was sent since the last row."""
        self._first_ms = self._first_ms if self._writer else sample.vehicle_ms
        t_s = (sample.vehicle_ms - self._first_ms) / 1000
        row: dict[str, float | str] = {"t_s": t_s}
        row |= {f"setpoint_{axis}_m": value for axis, value in zip(AXES, setpoint, strict=False)}
        row["setpoint_yaw_deg"] = math.degrees(setpoint[3])
        row |= self._command("cmd", command)
        seen = (*fix.pos_m, math.degrees(fix.yaw_rad), t_s - fix.age_s) if fix.is_new else ("",) * len(MARKER)
        row |= dict(zip(MARKER, seen, strict=True))
        for name, angle_rad in zip(("roll", "pitch", "yaw"), sample.att_rad, strict=True):
            row[f"imu_{name}_deg"] = math.degrees(angle_rad)
        row |= {f"gyro_{axis}_radps": value for axis, value in zip(AXES, sample.gyro_radps, strict=True)}
        row |= {f"acc_{axis}_mps2": value for axis, value in zip(AXES, sample.acc_mps2, strict=True)}
        row |= {"vbat_v": sample.vbat_v, "vehicle_clock_ms": sample.vehicle_ms}
        row |= {"received_clock_s": round(received_s, 6), "sent_clock_s": round(sent.unix_s, 6) if sent else ""}
        told = self._command("sent", sent.command if sent else command)
        row |= told if sent else dict.fromkeys(told, "")
        self._write(row | {"firmware_revision": self._firmware_revision})

    def _command(self, name: str, command: Command) -> dict[str, float]:
        roll, pitch, turn = command.roll_rad, command.pitch_rad, command.yaw_rate_radps
        angles = {"roll_deg": roll, "pitch_deg": pitch, "yaw_rate_degps": turn}
        row = {f"{name}_{key}": math.degrees(angle_rad) for key, angle_rad in angles.items()}
        return row | {f"{name}_{self._lift}": command.lift}

    def _write(self, row: Mapping[str, float | str]) -> None:
        if self.problem:
            return
        try:
            self._append(row)
        except OSError as error:
            # a full disk is no reason to fall
            self.problem = f"the log ends early: {error}"

    def _append(self, row: Mapping[str, float | str]) -> None:
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
        with contextlib.suppress(OSError):
            self._file.close()
        text = json.dumps({"settings": settings, "summary": summary}, indent=2)
        self.settings_path.write_text(text + "\n", encoding="utf-8")
