"""Keys and signals of a flight: the first lands, the second stops the motors."""

from __future__ import annotations

import contextlib
import select
import signal
import sys
import threading
import time
from types import FrameType, TracebackType
from typing import Any

LANDING_KEYS = b" \r\nqQ\x03"


class Keys:
    """Space, Enter and q of a terminal, and interrupts, counted while the context lasts."""

    def __init__(self) -> None:
        self.presses = 0
        self.name = ""
        self._ended = threading.Event()
        self._handlers: dict[int, Any] = {}
        self._terminal: list[Any] | None = None
        self._thread: threading.Thread | None = None

    def press(self, name: str) -> None:
        """Count a wish to land."""
        self.presses += 1
        self.name = self.name or name

    def land(self, name: str) -> None:
        """Make all vehicles land, where nobody has wished it yet. It never counts as a second key."""
        if not self.presses:
            self.press(name)

    def __enter__(self) -> Keys:
        """Begin to listen. A pipe is left alone: a script may need what is in it."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, self._signal)
        if sys.stdin is not None and sys.stdin.isatty():
            self._listen()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the terminal as it was."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(timeout=1.0)
        if self._terminal is not None:
            import termios

            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._terminal)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _signal(self, number: int, _frame: FrameType | None) -> None:
        self.press(signal.Signals(number).name)

    def _listen(self) -> None:
        try:
            import termios
            import tty

            self._terminal = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
            read = self._read_unix
        except ImportError:
            read = self._read_windows
        self._thread = threading.Thread(target=read, name="keys", daemon=True)
        self._thread.start()

    def _read_unix(self) -> None:
        import os

        while not self._ended.is_set():
            with contextlib.suppress(OSError):
                if select.select([sys.stdin], [], [], 0.1)[0]:
                    self._take(os.read(sys.stdin.fileno(), 64))

    def _read_windows(self) -> None:
        import importlib

        console: Any = importlib.import_module("msvcrt")
        while not self._ended.is_set():
            if console.kbhit():
                self._take(console.getch())
            time.sleep(0.05)

    def _take(self, pressed: bytes) -> None:
        for key in pressed:
            if key in LANDING_KEYS:
                self.press("key")
