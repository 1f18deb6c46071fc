"""Time as a simulator has it: cflib scripts in lock-step with `crazyflie cf2 --lockstep`.

A script runs as it is::

    python -m crazyflie_gym.lockstep script.py

and parts of a program run within the clock::

    from crazyflie_gym.lockstep import Clock

    with Clock(), SyncCrazyflie("udp://127.0.0.1:19850", cf=Crazyflie()) as scf:
        scf.cf.high_level_commander.takeoff(0.5, 2.0)
        time.sleep(3)  # three simulated seconds, as fast as the machine flies them

Simulated time goes on by a tick when all threads of the script wait: in `time.sleep`, for a condition, an event or a
queue, for another thread's end, or for a datagram. So the same script flies the same bits on every machine. Without a
vehicle in lock-step, before one is connected and with real ones, time is real. When a vehicle answers
first, time jumps to the next multiple of 8 s since the clock began, so that simulated time has a round start.

Threads that ran before the clock began keep to real time. Time stops while a thread computes, or waits for
anything else, such as a key or a `threading.Lock`: a thread that sleeps with one needs a `threading.Semaphore` instead.
A callback of cflib must not sleep: it blocks the packets it waits for.
"""

from __future__ import annotations

import queue
import runpy
import select
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

CLOCK_PORT = 10
"""CRTP port of the clock: "go on until then", in milliseconds; answered with the time as soon as it has come."""
TICK_MS = 10
ROUND_NS = 8_000_000_000
"""The first vehicle answers within so long, mostly: simulated time begins at the next multiple of it."""
STREAMED_PORTS = (3, 6, 7)
"""Ports of set-points and positions: nothing answers what is sent there."""
RESEND_S, POLL_S = 1.0, 0.1
DRIVERS = ("cflib.crtp", "cflib.cpx")
"""Modules whose threads wait for the network: their packets arrive before the answer of the clock."""


class _Waiter:
    """A thread that waits; within a condition it takes the place of the lock on which threads wait there."""

    def __init__(self, clock: Clock, due_ns: int | None) -> None:
        self.thread, self.due_ns, self.woken = threading.current_thread(), due_ns, False
        self.lock = threading.Lock()
        self.lock.acquire()
        self._clock = clock

    def release(self) -> None:
        """Wake the waiting thread, like `Condition.notify`."""
        self._clock.wake(self, woken=True)


class _Lock(threading.Semaphore):
    """A lock for which a thread waits like for a condition: time goes on meanwhile."""

    def release(self, n: int = 1) -> None:
        if self._value:
            raise RuntimeError("release unlocked lock")
        super().release(n)


class _Link:
    """A connection of cflib to a vehicle in lock-step."""

    def __init__(self, cf: Any) -> None:
        self.cf, self.time_ms, self.is_ready = cf, 0, False
        self.until_ms, self.is_asked = 0, False
        # nothing was sent to which an answer may be under way
        self.is_quiet = False

    def send(self, until_ms: int) -> None:
        from cflib.crtp.crtpstack import CRTPPacket

        packet, driver = CRTPPacket(), self.cf.link
        packet.set_header(CLOCK_PORT, 0)
        packet.data = struct.pack("<I", until_ms)
        if driver is not None:
            driver.send_packet(packet)


class Clock:
    """While the context lasts, time of this thread, and of threads that start in it, is that of the simulator."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._links: dict[Any, _Link] = {}
        self._watched: set[Any] = set()
        self._opened: set[Any] = set()
        self._waiters: list[_Waiter] = []
        self._threads: dict[threading.Thread, list[_Waiter]] = {}
        self._running: set[threading.Thread] = set()
        self._ended = self._is_over = False
        self._real_monotonic = time.monotonic
        self._shift_ns = -self._real_ns()
        self._frozen_ns: int | None = None
        self._patched: list[tuple[Any, str, Any]] = []
        self._conductor = threading.Thread(target=self._conduct, name="clock", daemon=True)

    def __enter__(self) -> Clock:
        """Take over the time of this process."""
        self._conductor.start()
        thread = threading.current_thread()
        self._threads[thread] = []
        self._running.add(thread)
        for owner, name, function in self._replacements():
            self._patched.append((owner, name, getattr(owner, name)))
            setattr(owner, name, function)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give real time back: threads that still wait go on."""
        for owner, name, function in reversed(self._patched):
            setattr(owner, name, function)
        with self._changed:
            self._ended = True
            for waiter in list(self._waiters):
                self.wake(waiter)
            self._changed.notify_all()
        self._conductor.join()

    def _replacements(self) -> list[tuple[Any, str, Any]]:
        from cflib.crazyflie import Crazyflie, param

        # whole seconds: a difference of two times has the same bits, whenever the clock began
        started_s = time.time() // 1.0
        sleep, wait, start, join = time.sleep, threading.Condition.wait, threading.Thread.start, threading.Thread.join
        receive, open_link, close_link = socket.socket.recv, Crazyflie.open_link, Crazyflie.close_link

        def lockstep_wait(condition: Any, timeout: float | None = None) -> bool:
            if threading.current_thread() not in self._threads:
                return wait(condition, timeout)
            return self._wait_in(condition, timeout)

        def lockstep_sleep(seconds: float) -> None:
            if threading.current_thread() in self._threads:
                self._block(self._waiter(seconds))
            else:
                sleep(seconds)

        def lockstep_start(thread: threading.Thread) -> None:
            if not type(thread).__module__.startswith(DRIVERS):
                self._adopt(thread)
            start(thread)

        def lockstep_join(thread: threading.Thread, timeout: float | None = None) -> None:
            current = threading.current_thread()
            # the conductor lets others go on: where cflib closes a link that is lost it waits for none of them
            if current is not self._conductor and (current not in self._threads or self._wait_end(thread, timeout)):
                join(thread, timeout)

        def lockstep_receive(connection: Any, *args: Any) -> bytes:
            patience_s = connection.gettimeout()
            if threading.current_thread() in self._threads and patience_s != 0.0:
                self._wait_readable(connection, patience_s)
            return receive(connection, *args)

        def lockstep_open(cf: Any, uri: str) -> None:
            self._watch(cf)
            open_link(cf, uri)
            # only a simulator in lock-step answers
            _Link(cf).send(0)

        def lockstep_close(cf: Any) -> None:
            self._forget(cf)
            close_link(cf)

        monotonic_s = self.monotonic_s
        return [
            (time, "sleep", lockstep_sleep),
            (time, "monotonic", monotonic_s),
            (time, "perf_counter", monotonic_s),
            (time, "time", lambda: started_s + monotonic_s()),
            (threading, "_time", monotonic_s),
            (queue, "time", monotonic_s),
            # requests wait with it for an answer, which does not come where the link is being closed
            (param, "Lock", _Lock),
            (threading.Condition, "wait", lockstep_wait),
            (threading.Thread, "start", lockstep_start),
            (threading.Thread, "join", lockstep_join),
            (socket.socket, "recv", lockstep_receive),
            (Crazyflie, "open_link", lockstep_open),
            (Crazyflie, "close_link", lockstep_close),
        ]

    def monotonic_s(self) -> float:
        """Return the time, as `time.monotonic` does."""
        return self._now_ns() / 1e9

    def _now_ns(self) -> int:
        frozen_ns = self._frozen_ns
        return self._real_ns() + self._shift_ns if frozen_ns is None else frozen_ns

    def _real_ns(self) -> int:
        return round(1e9 * self._real_monotonic())

    # threads of the script

    def _adopt(self, thread: threading.Thread) -> None:
        run = thread.run

        def run_in_lockstep() -> None:
            try:
                run()
            finally:
                with self._changed:
                    self._running.discard(thread)
                    for waiter in self._threads.pop(thread):
                        self.wake(waiter, woken=True)
                    self._changed.notify_all()

        thread.run = run_in_lockstep  # type: ignore[method-assign]
        with self._changed:
            self._threads[thread] = []
            self._running.add(thread)

    def _waiter(self, seconds: float | None) -> _Waiter:
        if seconds is None:
            return _Waiter(self, None)
        # a rest that rounds to nothing is not over while time stands still: who asks for it asks again at once
        least_ns = 1 if seconds > 0.0 else 0
        return _Waiter(self, self._now_ns() + max(least_ns, round(1e9 * seconds)))

    def _wait_end(self, thread: threading.Thread, seconds: float | None) -> bool:
        """Return whether a thread that the clock knows ends in time."""
        waiter = self._waiter(seconds)
        with self._changed:
            if thread not in self._threads:
                return True
            self._threads[thread].append(waiter)
        self._block(waiter)
        return waiter.woken

    def _wait_in(self, condition: Any, seconds: float | None) -> bool:
        """Wait like `Condition.wait`, with its lock acquired."""
        waiter = self._waiter(seconds)
        condition._waiters.append(waiter)
        saved = condition._release_save()
        try:
            self._block(waiter)
        finally:
            condition._acquire_restore(saved)
            if waiter in condition._waiters:
                condition._waiters.remove(waiter)
        return waiter.woken

    def _wait_readable(self, connection: Any, patience_s: float | None) -> None:
        """A simulator has sent what belongs to a tick before it answers that the tick is over."""
        end_ns = None if patience_s is None else self._now_ns() + round(1e9 * patience_s)

        def is_readable() -> bool:
            return bool(select.select([connection], [], [], 0.0)[0])

        while not is_readable():
            if end_ns is not None and self._now_ns() >= end_ns:
                raise TimeoutError("timed out")
            self._block(self._waiter(TICK_MS / 1000), is_readable)

    def _block(self, waiter: _Waiter, is_done: Callable[[], bool] = lambda: False) -> None:
        with self._changed:
            if waiter.woken or self._ended:
                return
            self._waiters.append(waiter)
            self._running.discard(waiter.thread)
            self._changed.notify_all()
        try:
            # a packet may arrive while the time does not advance
            while not waiter.lock.acquire(timeout=POLL_S) and not is_done():
                pass
        finally:
            # a signal may end it
            self.wake(waiter)

    def wake(self, waiter: _Waiter, woken: bool = False) -> None:
        """Let a thread go on: time does not until it waits again."""
        with self._changed:
            waiter.woken = waiter.woken or woken
            if waiter in self._waiters:
                self._waiters.remove(waiter)
                if waiter.thread in self._threads:
                    self._running.add(waiter.thread)
                waiter.lock.release()

    # links

    def _watch(self, cf: Any) -> None:
        """Add a vehicle's time to the clock from its first answer on; the time stops until its tables are read."""
        self._opened.add(cf)
        if cf in self._watched:
            return
        self._watched.add(cf)

        def answered(packet: Any) -> None:
            (time_ms,) = struct.unpack("<I", packet.data)
            with self._changed:
                if cf in self._opened:
                    self._opened.remove(cf)
                    self._links[cf] = _Link(cf)
                    if self._frozen_ns is None:
                        self._freeze()
                link = self._links.get(cf)
                if link is None:
                    return
                link.time_ms = time_ms
                link.is_asked = link.is_asked and time_ms < link.until_ms
                self._changed.notify_all()

        def note(name: str, value: bool) -> None:
            with self._changed:
                if cf in self._links:
                    setattr(self._links[cf], name, value)
                    self._changed.notify_all()

        cf.add_port_callback(CLOCK_PORT, answered)
        cf.fully_connected.add_callback(lambda _uri: note("is_ready", True))

        def sent(packet: Any) -> None:
            if packet.port not in STREAMED_PORTS:
                note("is_quiet", False)

        cf.packet_sent.add_callback(sent)

    def _freeze(self) -> None:
        """Stop time at a round number, however long the vehicle took to answer; waiting threads notice nothing."""
        now_ns = self._now_ns()
        self._frozen_ns = -(-now_ns // ROUND_NS) * ROUND_NS
        for waiter in self._waiters:
            if waiter.due_ns is not None:
                waiter.due_ns += self._frozen_ns - now_ns

    def _forget(self, cf: Any) -> None:
        """Without a vehicle in lock-step time is real again."""
        with self._changed:
            self._opened.discard(cf)
            if self._links.pop(cf, None) and not self._links:
                self._shift_ns, self._frozen_ns = self._now_ns() - self._real_ns(), None
            self._changed.notify_all()

    # time

    def _conduct(self) -> None:
        while not self._ended:
            with self._changed:
                for cf in [cf for cf in self._links if cf.link is None]:
                    self._forget(cf)
                ms = self._next_request()
            if ms is not None:
                self._ask(ms)
                self._is_over = ms > 0

    def _next_request(self) -> int | None:
        """Return the milliseconds to request of the vehicles; None after a wait or a wake-up, which may change them."""
        due_ns = min((waiter.due_ns for waiter in self._waiters if waiter.due_ns is not None), default=None)
        links = self._links.values()
        if self._running or not all(link.is_ready for link in links):
            self._changed.wait(RESEND_S)
        elif self._is_over:
            # for whom the vehicles' packets woke it was the tick before
            self._is_over = False
            if self._frozen_ns is not None:
                self._frozen_ns += 1_000_000 * TICK_MS
        elif due_ns is not None and due_ns <= self._now_ns():
            # one after the other, in the order in which they began to wait
            self.wake(next(waiter for waiter in self._waiters if waiter.due_ns == due_ns))
        elif not links:
            self._changed.wait(None if due_ns is None else (due_ns - self._now_ns()) / 1e9)
        elif all(link.is_quiet for link in links):
            return TICK_MS
        else:
            for link in links:
                link.is_quiet = True
            return 0
        return None

    def _ask(self, ms: int) -> None:
        """Let the vehicles' time go on, and wait for their answers: all that was sent before is answered then, too."""
        with self._changed:
            for link in self._links.values():
                link.until_ms, link.is_asked = link.time_ms + ms, True
        while late := self._late():
            for link in late:
                link.send(link.until_ms)
            with self._changed:
                while self._late() and self._changed.wait(RESEND_S):
                    pass

    def _late(self) -> list[_Link]:
        with self._changed:
            late = [link for link in self._links.values() if link.is_asked and link.cf.link is not None]
            return [] if self._ended else late


def main() -> None:
    """Run a script in lock-step: `python -m crazyflie_gym.lockstep SCRIPT.py [ARGUMENT...]`."""
    if len(sys.argv) < 2:
        sys.exit("usage: python -m crazyflie_gym.lockstep SCRIPT.py [ARGUMENT...]")
    del sys.argv[0]
    sys.path.insert(0, str(Path(sys.argv[0]).parent))
    with Clock():
        runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
