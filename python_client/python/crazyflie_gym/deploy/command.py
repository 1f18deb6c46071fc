"""The command `crazyflie deploy`, and the same as a function."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from pathlib import Path
from typing import Any

from crazyflie_gym.deploy.flight import Flight
from crazyflie_gym.deploy.keys import Keys
from crazyflie_gym.deploy.limits import Ending
from crazyflie_gym.deploy.pilot import Pilot
from crazyflie_gym.deploy.record import Recorder
from crazyflie_gym.deploy.settings import DeployError, Settings
from crazyflie_gym.deploy.vehicle import Vehicle
from crazyflie_gym.lockstep import Clock


def deploy(settings: Settings, report: Any = None) -> dict[str, Any]:
    """Fly, and return how it went: reason, detail, ok, landed, figures, and the files that were written.

    `report` is called with each line of progress; nothing is printed without it.

    Raises:
        DeployError: if the vehicle cannot be reached, or is not fit to fly.
        ValueError: for a controller, model, task or option that is wrong.
    """

    def tell(line: str) -> None:
        # a terminal that is gone is no reason to fall
        with contextlib.suppress(Exception):
            if report is not None:
                report(line)

    pilot = Pilot(settings)
    path = Path(settings.log or time.strftime("deploy-%Y%m%d-%H%M%S.csv"))
    with Keys() as keys, Clock() if settings.lockstep else contextlib.nullcontext():
        tell(f"connecting to {settings.uri}")
        vehicle = Vehicle(settings.uri, pilot.interface.yaw_sign)
        recorder = Recorder(path, settings.vertical, vehicle.firmware_revision)
        flight = Flight(settings, pilot, vehicle, keys, tell, recorder)
        summary: dict[str, Any] = {}
        try:
            summary = _summary(settings, flight.fly(), flight, recorder)
        finally:
            vehicle.close()
            recorder.close(settings.plain(), summary)
    return summary


def _summary(settings: Settings, ending: Ending, flight: Flight, recorder: Recorder) -> dict[str, Any]:
    return {
        "uri": settings.uri,
        "controller": str(settings.controller),
        "reason": ending.reason,
        "detail": ending.detail,
        "ok": ending.is_fine,
        **flight.summary,
        "log": str(recorder.path),
        "log_problem": recorder.problem or None,
        "settings": str(recorder.settings_path),
    }


def main(text: str) -> None:
    """Fly what an object of settings, as JSON, asks for, and print how it went.

    Raises:
        DeployError: for a flight that did not end as it was meant to.
        ValueError: for what cannot be flown.
    """
    given = json.loads(text)
    given["room_m"] = tuple(given["room_m"])
    settings = Settings(**given)
    stream = sys.stderr if settings.json else sys.stdout
    summary = deploy(settings, lambda line: print(line, file=stream, flush=True))
    if settings.json:
        print(json.dumps(summary, indent=2), flush=True)
    else:
        _print(summary)
    if not summary["ok"]:
        raise DeployError(f"landed early: {summary['reason']}: {summary['detail']}")


def _print(summary: dict[str, Any]) -> None:
    flown, missed = summary["flown_s"], summary["missed"]
    print(f"{summary['reason']}: {summary['detail']}")
    print(f"the controller flew {flown:.1f} s, {missed} samples missed, {summary['levelled']} ticks levelled")
    print(f"error to the set-point: {summary['rmse_m']:.3f} m rms, {summary['worst_m']:.3f} m at most")
    print(f"the log is {summary['log']}, its settings {summary['settings']}")
