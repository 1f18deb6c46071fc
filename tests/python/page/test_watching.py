"""A tab that nobody looks at, or that hangs, is no burden to the session that it shows."""

import json
import re
import signal
import time
import urllib.request
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from browsing import CHROMIUM, Server

ENVS = 16
WINDOW_S = 0.05
WINDOWS = 30


class Session:
    """A session of our own that hovers on a server, and what the server says of itself."""

    def __init__(self, server):
        self.server = server
        self.envs = gym.make_vec(
            "Crazyflie-v0",
            ENVS,
            remote=server.url.replace("http", "ws"),
            max_episode_steps=0,
            task_options={"start_m": [0, 0, 0.7]},
        )
        self.envs.reset(seed=1)
        self.actions = np.zeros((ENVS, 4), np.float32)
        self.steps = 0

    def fly(self):
        """The most steps that fit into a short time: of many such times other work leaves one alone."""
        best = 0
        for _ in range(WINDOWS):
            count, end = 0, time.perf_counter() + WINDOW_S
            while time.perf_counter() < end:
                self.envs.step(self.actions)
                count += 1
            self.steps += count
            best = max(best, count)
        return best

    def get(self, path):
        with urllib.request.urlopen(self.server.url + path) as answer:
            return answer.read().decode()

    def metric(self, name):
        return float(re.search(rf"^{name} (\S+)$", self.get("metrics"), re.MULTILINE)[1])

    def watching(self):
        return [row["watching"] for row in json.loads(self.get("api/v1/sessions"))]

    def rss_kib(self):
        status = Path(f"/proc/{self.server.process.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1])

    def unsent_bytes(self):
        """What waits in the server's sockets to be sent."""
        port, rows = f":{self.server.port:04X}", Path("/proc/net/tcp").read_text().splitlines()[1:]
        cells = [row.split() for row in rows]
        return sum(int(cell[4].split(":")[0], 16) for cell in cells if cell[1].endswith(port) and cell[3] == "01")


@pytest.fixture
def session(data):
    server = Server(data)
    session = Session(server)
    yield session
    session.envs.close()
    server.stop()


@pytest.fixture
def chromium(tmp_path):
    pytest.importorskip("websockets", reason="hidden tabs are not tested: pip install websockets")
    from tabs import Browser

    browser = Browser(CHROMIUM or pytest.skip("hidden tabs are not tested: no chromium here"), tmp_path)
    yield browser
    browser.close()


def hide(browser, tab):
    """Put another tab in front: timers are slowed, no frames are drawn."""
    browser.open("about:blank").bring_to_front()
    tab.until("document.hidden")
    return tab.bring_to_front


def freeze(browser, tab):
    """As browsers do with tabs that were long hidden: no script runs any more."""
    front = hide(browser, tab)
    tab.ask("Page.setWebLifecycleState", state="frozen")

    def back():
        tab.ask("Page.setWebLifecycleState", state="active")
        front()

    return back


def stop(browser, tab):
    """Stop all of the browser: nothing reads from the socket any more, and nothing closes it."""
    browser.signal(signal.SIGSTOP)
    return lambda: browser.signal(signal.SIGCONT)


@pytest.mark.parametrize("away", [hide, freeze, stop])
def test_a_tab_that_nobody_looks_at_slows_nothing(chromium, session, away):
    alone = session.fly()
    tab = chromium.open(session.server.url + "#live")
    while not tab.evaluate("document.querySelector('#readout td') !== null"):
        session.fly()
    back = away(chromium, tab)
    memory, steps = session.rss_kib(), session.metric("crazyflie_env_steps_total")
    # other work may slow it once: of ten tries one is as fast as without the tab
    counts = [session.fly()]
    while max(counts) <= 0.6 * alone and len(counts) < 10:
        counts.append(session.fly())
    assert session.watching() == [1], "the tab is not there any more"
    grown, unsent = session.rss_kib() - memory, session.unsent_bytes()
    flown = session.metric("crazyflie_env_steps_total") - steps
    print(
        f"{away.__name__}: {max(counts)} steps of {ENVS} environments in {1000 * WINDOW_S:.0f} ms, {alone} without it; "
        f"{flown:.0f} steps while nobody looked, server grown by {grown} KiB, {unsent} bytes unsent"
    )
    assert max(counts) > 0.6 * alone
    assert grown < 2048 and unsent < 1 << 16
    back()
    # missed ticks are skipped: the page shows the session's newest one
    session.envs.step(session.actions)
    newest = (session.steps + 1) * 0.02
    tab.until(f"Math.abs(parseFloat(document.querySelector('#readout td').textContent) - {newest}) < 0.03")
