"""A server whose process is stopped for a while: whatever waits in it goes on as if no time had passed."""

import signal
import time

import pytest

from served import Server

remote = pytest.importorskip("crazyflie_gym.remote", reason="the extra remote is not installed")

# longer than a pilot may be silent (20 s), a world may be without one (10 s), and a lost session waits (30 s)
PAUSE_S = 33


def test_a_pause_ends_no_world_and_no_session(tmp_path):
    server = Server(tmp_path)
    lost, pilot, guest = (remote.Client(server.url) for _ in range(3))
    lost.ask("make", env="Crazyflie-v0", num_envs=1)
    lost.ask("reset", seed=7)
    before = lost.ask("step", action=[0, 0, 0, 0])["observation"]
    pilot.ask("world", name="flown", mission="formation", options={"drones": 1})
    pilot.ask("join", name="flown")
    pilot.ask("fly", action=[0, 0, 0, 0])
    guest.ask("world", name="left", mission="formation", options={"drones": 1})
    guest.ask("join", name="left")
    guest.ask("leave")
    # without a word, as when a cable is pulled
    lost._ws.socket.shutdown(2)
    server.process.send_signal(signal.SIGSTOP)
    time.sleep(PAUSE_S)
    server.process.send_signal(signal.SIGCONT)
    assert pilot.ask("fly", action=[0, 0, 0, 0])["flying"]
    assert guest.ask("join", name="left")["drone"] == 0
    after = lost.ask("step", action=[0, 0, 0, 0])["observation"]
    assert lost.resumed == 1 and after != before
    server.stop()
