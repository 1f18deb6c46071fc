"""A browser with real tabs, by its DevTools protocol. Playwright holds every page to be in front, whatever tab is."""

import json
import os
import signal
import subprocess
from contextlib import ExitStack
from pathlib import Path

from browsing import FLAGS
from websockets.sync.client import connect

from common import LIMIT_S, wait


class Browser:
    """Chromium in processes of its own."""

    def __init__(self, chromium, folder):
        command = [chromium, "--headless=new", "--remote-debugging-port=0", f"--user-data-dir={folder}", *FLAGS]
        # a group of its own, to be stopped as a whole
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        self.process = subprocess.Popen([*command, "about:blank"], **quiet)
        port_file = Path(folder) / "DevToolsActivePort"
        wait(
            lambda: port_file.exists() and len(port_file.read_text().splitlines()) == 2,
            "a port for the DevTools protocol",
        )
        port, path = port_file.read_text().splitlines()
        self.closing = ExitStack()
        self.socket = self.closing.enter_context(connect(f"ws://127.0.0.1:{port}{path}", max_size=None))
        self.id = 0

    def ask(self, method, session=None, **params):
        """Send a command and wait for what comes of it."""
        self.id += 1
        message = {"id": self.id, "method": method, "params": params}
        self.socket.send(json.dumps(message | ({"sessionId": session} if session else {})))
        while (answer := json.loads(self.socket.recv(LIMIT_S))).get("id") != self.id:
            pass
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def open(self, url):
        return Tab(self, url)

    def signal(self, which):
        os.killpg(self.process.pid, which)

    def close(self):
        self.signal(signal.SIGCONT)
        self.closing.close()
        self.signal(signal.SIGKILL)
        self.process.wait()


class Tab:
    """One of its tabs."""

    def __init__(self, browser, url):
        self.browser = browser
        self.target = browser.ask("Target.createTarget", url=url)["targetId"]
        self.session = browser.ask("Target.attachToTarget", targetId=self.target, flatten=True)["sessionId"]

    def ask(self, method, **params):
        return self.browser.ask(method, self.session, **params)

    def evaluate(self, expression):
        return self.ask("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def until(self, expression):
        wait(lambda: self.evaluate(expression), expression)

    def bring_to_front(self):
        self.browser.ask("Target.activateTarget", targetId=self.target)
