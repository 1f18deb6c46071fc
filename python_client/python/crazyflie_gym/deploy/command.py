"""The command `crazyflie deploy`, and the same as a function."""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from crazyflie_gym._native import vehicles
from crazyflie_gym.deploy.flight import Flight
from crazyflie_gym.deploy.keys import Keys
from crazyflie_gym.deploy.limits import Ending
from crazyflie_gym.deploy.pilot import Pilot
from crazyflie_gym.deploy.record import Recorder
from crazyflie_gym.deploy.settings import DeployError, Settings
from crazyflie_gym.deploy.team import Team
from crazyflie_gym.deploy.vehicle import Vehicle
from crazyflie_gym.lockstep import Clock


def deploy(settings: Settings, report: Any = None) -> dict[str, Any]:
    """Fly, and return how it went: reason, detail, ok, landed, figures, and the files that were written.

    Several vehicles give ok, reason, detail and `vehicles`, a list with the summary of each.

    `report` is called with each line of progress; nothing is printed without it.

    Raises:
        DeployError: if the vehicle cannot be reached, or is not fit to fly.
        ValueError: for a controller, model, task or option that is wrong.
    """

    lock = threading.Lock()

    def tell(line: str) -> None:
        # a terminal that is gone is no reason to fall
        with contextlib.suppress(Exception), lock:
            if report is not None:
                report(line)

    uris = settings.uris
    path = Path(settings.log or time.strftime("deploy-%Y%m%d-%H%M%S.csv"))
    if len(uris) == 1:
        pilot = Pilot(settings)
        with Keys() as keys, Clock() if settings.lockstep else contextlib.nullcontext():
            return _fly(settings, uris[0], pilot, keys, path, tell, lambda _: True)
    team = Team(uris)
    pilots = [Pilot(settings, team, vehicle) for vehicle in range(len(uris))]
    with Keys() as keys, Clock() if settings.lockstep else contextlib.nullcontext():
        return _fly_team(settings, team, pilots, keys, path, tell)


def _fly_team(
    settings: Settings, team: Team, pilots: list[Pilot], keys: Keys, path: Path, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Fly each vehicle in a thread; if one lands early, all land."""
    summaries: list[dict[str, Any]] = [{} for _ in pilots]
    errors: list[BaseException] = []

    def fly(vehicle: int) -> None:
        name, log = team.names[vehicle], path.with_stem(f"{path.stem}-{vehicle + 1}")

        def told(line: str) -> None:
            tell(f"{name}: {line}")

        try:
            summary = _fly(
                settings, name, pilots[vehicle], keys, log, told, lambda stage: team.is_ready(vehicle, stage)
            )
            summaries[vehicle] = summary
            if not summary["ok"]:
                keys.land(f"{name}, which landed early")
        except BaseException as error:
            errors.append(error)
            keys.land(f"{name}, which cannot fly")

    threads = [threading.Thread(target=fly, args=(vehicle,), name=name) for vehicle, name in enumerate(team.names)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]
    first = next((summary for summary in summaries if not summary["ok"]), summaries[0])
    return {
        "ok": all(summary["ok"] for summary in summaries),
        "reason": first["reason"],
        "detail": first["detail"],
        "vehicles": summaries,
    }


def is_other(kind: str, model_name: str) -> bool:
    """Return whether a vehicle that calls itself `kind` is none of a model's. Models of one's own fit every vehicle."""
    platform = next((each["platform"] for each in vehicles() if each["name"] == model_name), None)
    return bool(kind) and platform is not None and kind not in (model_name, platform)


def _fly(
    settings: Settings,
    uri: str,
    pilot: Pilot,
    keys: Keys,
    path: Path,
    tell: Callable[[str], None],
    is_ready: Callable[[str], bool],
) -> dict[str, Any]:
    """Fly one vehicle, from the connection to the landing."""
    tell(f"connecting to {uri}")
    vehicle = Vehicle(uri, pilot.interface.yaw_sign)
    if is_other(vehicle.kind, pilot.model_name):
        tell(
            f"warning: {uri} is a {vehicle.kind}, and the controller's model is that of {pilot.model_name}: "
            "expected the vehicle that flies as --vehicle"
        )
    recorder = Recorder(path, settings.vertical, vehicle.firmware_revision)
    flight = Flight(settings, pilot, vehicle, keys, tell, recorder, is_ready)
    summary: dict[str, Any] = {}
    try:
        summary = _summary(settings, uri, flight.fly(), flight, recorder)
    finally:
        vehicle.close()
        recorder.close(settings.plain(), summary)
    return summary


def _summary(settings: Settings, uri: str, ending: Ending, flight: Flight, recorder: Recorder) -> dict[str, Any]:
    return {
        "uri": uri,
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
        for each in summary.get("vehicles", [summary]):
            _print(each)
    if not summary["ok"]:
        raise DeployError(f"landed early: {summary['reason']}: {summary['detail']}")


def _print(summary: dict[str, Any]) -> None:
    flown, missed = summary["flown_s"], summary["missed"]
    print(f"{summary['uri']}: {summary['reason']}: {summary['detail']}")
    print(f"the controller flew {flown:.1f} s, {missed} samples missed, {summary['levelled']} ticks levelled")
    print(f"error to the set-point: {summary['rmse_m']:.3f} m rms, {summary['worst_m']:.3f} m at most")
    print(f"the log is {summary['log']}, its settings {summary['settings']}")
