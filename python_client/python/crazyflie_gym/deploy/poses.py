"""Poses from outside: motion capture, or a marker seen by the vehicle's camera.

A message is a JSON object in one UDP datagram. Motion capture sends the body in the room::

    {"body": "cf1", "pos_m": [0.1, -0.2, 0.7], "quat_xyzw": [0, 0, 0, 1], "age_s": 0.004}

and a camera sends the marker as OpenCV's pose estimation tells it, in the camera's frame (x to the right of the
picture, y down, z forward)::

    {"body": "cf1", "tvec_m": [0.0, 0.0, 0.68], "rvec_rad": [2.22, -2.22, 0.0], "age_s": 0.05}

`quat_xyzw` may be left out, or be `yaw_deg`; `age_s` is the time since the picture was taken, 0 unless given; `body`
is looked at only where one was asked for.
"""

from __future__ import annotations

import json
import math
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import numpy as np
from numpy.typing import NDArray

from crazyflie_gym import custom

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
LENS_BELOW_M = 0.02
"""The lens below the vehicle's centre (thesis 4.1.1)."""
# columns: axes of a camera that looks down, the picture's top to the nose, along the body's x, y, z
CAMERA_IN_BODY = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Pose:
    """Place of the vehicle at `captured_s` on this machine's steady clock; without orientation no heading is known."""

    pos_m: Vector
    quat_xyzw: Quaternion | None
    yaw_rad: float | None
    captured_s: float


def pose_from_message(message: Mapping[str, Any], received_s: float) -> Pose:
    """Return the pose that a message tells.

    Raises:
        ValueError: for what is no pose, naming the key.
    """
    captured_s = received_s - _numbers(message, "age_s", 1)[0] if "age_s" in message else received_s
    quat: Quaternion | None = None
    if "tvec_m" in message:
        pos_m, rotation = _over_marker(_numbers(message, "tvec_m", 3), _numbers(message, "rvec_rad", 3))
        quat = _quaternion(rotation)
    else:
        pos_m = _numbers(message, "pos_m", 3)
        if "quat_xyzw" in message:
            quat = _numbers(message, "quat_xyzw", 4)
        elif "yaw_deg" in message:
            half = math.radians(_numbers(message, "yaw_deg", 1)[0]) / 2
            quat = (0.0, 0.0, math.sin(half), math.cos(half))
    x, y, z = pos_m
    return Pose((x, y, z), quat, None if quat is None else _yaw_rad(quat), captured_s)


def _numbers(message: Mapping[str, Any], key: str, count: int) -> Any:
    value = message.get(key)
    numbers = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
    found = tuple(float(n) for n in numbers if isinstance(n, (int, float, np.number)) and math.isfinite(n))
    if len(found) != count or len(numbers) != count:
        raise ValueError(f"a pose's {key} is {value!r}, expected {count} finite numbers")
    return found


def _over_marker(tvec_m: Vector, rvec_rad: Vector) -> tuple[Vector, NDArray[np.float64]]:
    """Return position and rotation of the body in the marker's frame: x right, y up the marker, z out of it."""
    camera_from_marker = _rotation(rvec_rad)
    body = camera_from_marker.T @ CAMERA_IN_BODY.T
    lens_m = -camera_from_marker.T @ np.array(tvec_m)
    x, y, z = lens_m + LENS_BELOW_M * body[:, 2]
    return (float(x), float(y), float(z)), body


def _rotation(rvec_rad: Vector) -> NDArray[np.float64]:
    """Return the matrix of a rotation vector (Rodrigues)."""
    angle = math.sqrt(sum(part * part for part in rvec_rad))
    x, y, z = (part / angle if angle > 0 else 0.0 for part in rvec_rad)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: NDArray[np.float64] = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    return rotation


def _quaternion(m: NDArray[np.float64]) -> Quaternion:
    """Return x, y, z, w of a rotation: the eigenvector of the symmetric matrix (Bar-Itzhack 2000)."""
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return float(x), float(y), float(z), float(w)


def _yaw_rad(quat: Quaternion) -> float:
    x, y, z, w = quat
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class PoseFeed:
    """The newest pose, and who else is told of each one.

    Args:
        source: udp://HOST:PORT[/BODY], python:FILE:NAME, or a function that yields messages.
        listener: called with every pose, on the feed's own thread.

    Raises:
        ValueError: for a source of another kind.
        OSError: if the address cannot be had.
    """

    def __init__(
        self, source: str | Callable[[], Iterable[Mapping[str, Any]]], listener: Callable[[Pose], None]
    ) -> None:
        self._listener = listener
        self.newest: Pose | None = None
        self.count, self.refused, self.problem = 0, 0, ""
        self._ended = threading.Event()
        self.address = ""
        self._messages = self._open(source)
        self._thread = threading.Thread(target=self._run, name="poses", daemon=True)
        self._thread.start()

    def _open(self, source: str | Callable[[], Iterable[Mapping[str, Any]]]) -> Iterator[Mapping[str, Any]]:
        if callable(source):
            return iter(source())
        if source.startswith("python:"):
            path, _, name = source.removeprefix("python:").rpartition(":")
            if not path:
                raise ValueError(f"poses: {source} names no part of a file: expected python:FILE:NAME")
            return iter(custom.load(Path(path).read_bytes(), path, name)())
        url = urlparse(source)
        if url.scheme != "udp" or url.hostname is None or url.port is None:
            raise ValueError(f"poses: {source!r}, expected udp://HOST:PORT, udp://HOST:PORT/BODY or python:FILE:NAME")
        family = socket.AF_INET6 if ":" in url.hostname else socket.AF_INET
        port = socket.socket(family, socket.SOCK_DGRAM)
        port.bind((url.hostname, url.port))
        port.settimeout(0.1)
        host, number = port.getsockname()[:2]
        self.address = f"udp://{host}:{number}"
        return self._datagrams(port, url.path.strip("/"))

    def _datagrams(self, port: socket.socket, body: str) -> Iterator[Mapping[str, Any]]:
        with port:
            while not self._ended.is_set():
                try:
                    message = json.loads(port.recv(65536))
                except TimeoutError:
                    continue
                except ValueError as error:
                    self._refuse(f"no JSON: {error}")
                    continue
                if not isinstance(message, dict):
                    self._refuse("expected a JSON object")
                elif not body or str(message.get("body")) == body:
                    yield message

    def _refuse(self, problem: str) -> None:
        self.refused += 1
        self.problem = problem

    def _run(self) -> None:
        try:
            for message in self._messages:
                if self._ended.is_set():
                    return
                try:
                    pose = pose_from_message(message, time.monotonic())
                except ValueError as error:
                    self._refuse(str(error))
                    continue
                self.newest = pose
                self.count += 1
                self._listener(pose)
        except Exception as error:
            # an error in the caller's own function counts as a feed that stops
            self.problem = f"{type(error).__name__}: {error}"

    def close(self) -> None:
        """Listen no longer."""
        self._ended.set()
        self._thread.join(timeout=1.0)
