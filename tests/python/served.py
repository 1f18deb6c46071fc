"""A server in a process of its own."""

import signal
import subprocess
import sys

from common import LIMIT_S


class Server:
    """A server of its own in a process of its own."""

    def __init__(self, folder, *more):
        self.data = str(folder / "bench.sqlite")
        options = ["--listen", "127.0.0.1:0", "--log", "warn", "--data", self.data, *more]
        command = [sys.executable, "-m", "crazyflie_gym", "serve", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        assert line.startswith("listening on 127.0.0.1:"), line
        self.port = int(line.rsplit(":", 1)[1])
        self.url = f"ws://127.0.0.1:{self.port}"

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(timeout=LIMIT_S) == 0
        self.process.stdout.close()
