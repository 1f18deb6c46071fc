"""What the simulated Crazyflie does when things go wrong, as stock cflib sees it."""

import _thread
import contextlib
import json
import math
import os
import socket
import struct
import subprocess
import time
import urllib.request

import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.positioning.position_hl_commander import PositionHlCommander
from cflib.utils.encoding import decompress_quaternion
from websockets.sync.client import connect

from common import LIMIT_S, wait
from crazyflies import PROGRAM, Link, connected, flying, restart, simulated, started

pytest_plugins = ["crazyflies"]


def test_an_emergency_stop_holds_until_a_restart(drone, cache):
    with flying(drone, cache) as link:
        link.take_off()
        link.cf.supervisor.send_emergency_stop()
        link.until(lambda: link.now["stabilizer.thrust"] == 0)
        time.sleep(1.5)
        states = set(link.cf.supervisor.read_state_list())
        assert "Is locked" in states and not states & {"Can fly", "Can be armed"}
        link.cf.supervisor.send_crash_recovery_request()
        link.take_off()
        assert link.place[2] < 0.05
    restart(drone)
    with flying(drone, cache) as link:
        link.take_off()
        link.is_at(0, 0, 0.5)


@pytest.mark.parametrize(("height", "up", "down"), [(1.0, 2, 2), (0.5, 2, 1), (1.5, 3, 2), (2.0, 3, 3)])
def test_a_landing_is_no_crash_whatever_its_speed(link, height, up, down):
    high = link.cf.high_level_commander
    high.takeoff(height, up)
    time.sleep(up + 1)
    high.land(0.0, down)
    time.sleep(down + 1)
    assert "Is crashed" not in link.cf.supervisor.read_state_list()
    link.take_off(0.5)
    assert link.place[2] == pytest.approx(0.5, abs=0.1)


def test_the_position_commander_flies_twice_with_all_defaults(link, drone):
    scf = SyncCrazyflie(drone, cf=link.cf)
    for _ in range(2):
        with PositionHlCommander(scf):
            time.sleep(1)
            assert link.place[2] == pytest.approx(0.5, abs=0.1)
        time.sleep(1)
        assert "Can fly" in link.cf.supervisor.read_state_list()


def test_a_script_that_dies_in_the_air_leaves_a_vehicle_that_flies(drone, cache):
    with flying(drone, cache) as link:
        link.repeat(3, link.cf.commander.send_zdistance_setpoint, 0, 0, 0, 0.8)
        assert link.place[2] > 0.6
    with flying(drone, cache) as link:
        time.sleep(3)
        link.is_at(*link.place[:2], 0)
        link.take_off()
        assert link.place[2] == pytest.approx(0.5, abs=0.1)


def test_who_touches_another_lies_until_it_is_recovered(cache):
    with simulated("--drones", 2) as drones, flying(drones[0]["udp"], cache) as link:
        told = []
        link.cf.console.receivedChar.add_callback(told.append)
        high = link.cf.high_level_commander
        x, y, _ = link.place
        high.takeoff(0.3, 2)
        time.sleep(2.5)
        high.go_to(-x, -y, 0.05, 0, 2)
        link.until(lambda: "Tumbled" in "".join(told))
        states = set(link.cf.supervisor.read_state_list())
        assert "Is crashed" in states and "Can fly" not in states
        link.take_off()
        assert link.place[2] < 0.1
        # both stand where they touched: only their places help
        link.cf.param.set_value("sim.reset", 1)
        time.sleep(0.5)
        link.is_at(x, y, 0, within=0.05)
        link.take_off()
        link.is_at(x, y, 0.5)
        assert "Upright again" in "".join(told)


def test_every_script_finds_the_drones_on_their_places_with_reset(cache):
    with simulated("--reset") as drones:
        uri = drones[0]["udp"]
        with flying(uri, cache) as link:
            link.take_off()
            link.cf.high_level_commander.go_to(1, 0, 0.5, 0, 2)
            time.sleep(3)
            link.is_at(1, 0, 0.5)
            link.cf.supervisor.send_emergency_stop()
            time.sleep(1)
        with flying(uri, cache) as link:
            link.is_at(0, 0, 0, within=0.05)
            link.take_off()
            link.is_at(0, 0, 0.5)


def test_decks_are_reported_and_measure(cache):
    names = ("range.zrange", "range.front", "range.up", "motion.deltaX", "baro.asl")
    with simulated("--deck", "bcFlow2,bcMultiranger") as drones, flying(drones[0]["udp"], cache) as link:
        decks = {name: link.cf.param.get_value(f"deck.{name}") for name in ("bcFlow2", "bcMultiranger", "bcDWM1000")}
        assert decks == {"bcFlow2": "1", "bcMultiranger": "1", "bcDWM1000": "0"}
        rows = []
        block = LogConfig("decks", 20)
        for name in (*names, "stateEstimateZ.quat"):
            block.add_variable(name)
        link.cf.log.add_config(block)
        block.data_received_cb.add_callback(lambda _, row, __: rows.append(row))
        block.start()
        link.take_off()
        time.sleep(3)
        now = rows[-1]
        assert now["range.zrange"] == pytest.approx(500, abs=50) and now["baro.asl"] == pytest.approx(0.5, abs=0.05)
        assert now["range.front"] == pytest.approx(2500, abs=60) and now["range.up"] == pytest.approx(2300, abs=60)
        link.cf.high_level_commander.go_to(1, 0, 0.5, 0, 2)
        time.sleep(3)
        # half a metre over the floor, at 0.5 m/s and more: 488 counts per radian, a hundredth of a second
        assert 4 < max(row["motion.deltaX"] for row in rows) < 15
        assert rows[-1]["range.front"] == pytest.approx(1500, abs=100)
        *_, w = decompress_quaternion(rows[-1]["stateEstimateZ.quat"])
        assert abs(w) > 0.99


def test_set_points_that_stop_are_levelled_and_then_dropped(link):
    link.repeat(2, link.cf.commander.send_zdistance_setpoint, 0, 0, 0, 0.5)
    link.repeat(0.4, link.cf.commander.send_zdistance_setpoint, 5, 0, 0, 0.5)
    angles = []
    config = LogConfig("asked", 10)
    config.add_variable("controller.roll")
    config.add_variable("stabilizer.thrust")
    link.cf.log.add_config(config)
    start = time.monotonic()

    def take(_, values, __):
        angles.append((time.monotonic() - start, *values.values()))

    config.data_received_cb.add_callback(take)
    link.cf.commander.send_zdistance_setpoint(5, 0, 0, 0.5)
    config.start()
    time.sleep(2.4)
    level = min(t for t, roll, thrust in angles if abs(roll) < 2 and thrust > 0)
    off = min(t for t, _, thrust in angles if thrust == 0)
    assert level == pytest.approx(0.5, abs=0.03) and off == pytest.approx(2.0, abs=0.03), (level, off)
    assert "Can fly" in link.cf.supervisor.read_state_list(), "a fall is no crash"


def test_an_empty_battery_stops_the_motors(cache):
    battery = '{"battery_sag": {"exponent": 0.5, "charge": 0.05, "resistance_ohm": 0.1}}'
    with simulated("--effects", battery) as drones, flying(drones[0]["udp"], cache) as link:
        power = []
        config = LogConfig("power", 50)
        config.add_variable("pm.vbat", "float")
        config.add_variable("pm.state", "uint8_t")
        link.cf.log.add_config(config)
        config.data_received_cb.add_callback(lambda _, values, __: power.append(tuple(values.values())))
        config.start()
        link.take_off(0.4)
        assert link.place[2] > 0.3
        link.until(lambda: link.now["stabilizer.thrust"] == 0, seconds=40)
        time.sleep(1)
        assert min(volts for volts, _ in power) < 3.0
        assert {state for _, state in power} >= {0, 3, 4}
        assert link.cf.supervisor.is_locked


def test_a_client_that_was_cut_off_can_come_back(cache):
    # the limit of a client's silence is in real time
    with simulated(pace=("--speed", 8)) as drones:
        uri = drones[0]["udp"]
        lost = Crazyflie(rw_cache=cache)
        cut = SyncCrazyflie(uri, cf=lost)
        cut.open_link()
        cut.wait_for_params()
        start = time.monotonic()
        lost.high_level_commander.takeoff(0.5, 2)
        # the network is gone: neither a farewell nor a closed socket reaches the drone
        lost.link_statistics.stop()
        lost.link._thread.stop()
        quiet = lost.link.socket
        lost.link = None

        def again():
            scf = SyncCrazyflie(uri, cf=Crazyflie(rw_cache=cache))
            with contextlib.suppress(Exception):
                scf.open_link()
                return scf

        scf = wait(again, "who was cut off comes back", pause_s=0.1)
        assert time.monotonic() - start > 2.9, "who was heard a moment ago is not replaced"
        with contextlib.closing(quiet):
            link = Link(scf)
            link.until(lambda: abs(link.place[2] - 0.5) < 0.1)
            link.cf.high_level_commander.land(0, 2)
            link.until(lambda: link.now["stabilizer.thrust"] == 0)
            scf.close_link()


def test_a_second_client_is_refused(link, drone, cache):
    failed = []
    second = Crazyflie(rw_cache=cache)
    second.connection_failed.add_callback(lambda uri, message: failed.append((uri, message)))
    second.open_link(drone)
    wait(lambda: failed)
    assert "refused" in failed[0][1]
    second.close_link()
    link.take_off()
    link.is_at(0, 0, 0.5)


def test_losses_and_latency(cache):
    options = ("--loss", 0.3, "--latency", 0.02, "--seed", 3)
    with simulated(*options) as drones, flying(drones[0]["udp"], cache) as link:
        count = len(link.heights)
        time.sleep(2)
        got = len(link.heights) - count
        assert 0.5 * 40 < got < 0.9 * 40, got
        link.repeat(3, link.cf.commander.send_hover_setpoint, 0, 0, 0, 0.5)
        link.is_at(0, 0, 0.5)


def test_real_latency(cache):
    with simulated("--latency", 0.02, pace=()) as drones, connected(drones[0]["udp"], cache) as link:
        echoes = []
        link.cf.link_statistics.latency.latency_updated.add_callback(echoes.append)
        link.until(lambda: len(echoes) > 5)
        assert min(echoes) >= 40, "there and back"


def test_over_tcp(cache):
    with simulated("--tcp", 0) as drones:
        uri = drones[0]["tcp"]
        with flying(uri, cache) as link:
            link.take_off()
            link.is_at(0, 0, 0.5)


def test_positions_of_the_script_are_believed(cache):
    with simulated("--position", "none") as drones, flying(drones[0]["udp"], cache) as link:
        link.repeat(2, link.cf.extpos.send_extpos, 1.0, 2.0, 0.0)
        link.is_at(1, 2, 0, within=0.05)
        link.repeat(2, link.cf.extpos.send_extpose, -1.0, 0.5, 0.0, 0, 0, math.sin(0.5), math.cos(0.5))
        link.is_at(-1, 0.5, 0, within=0.1)
        assert math.radians(link.now["stateEstimate.yaw"]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("source", ["aruco", "mocap"])
def test_positions_from_outside(cache, source):
    with simulated("--position", source) as drones, flying(drones[0]["udp"], cache) as link:
        link.take_off(0.7)
        link.cf.high_level_commander.go_to(0.2, 0, 0.7, 0, 2)
        time.sleep(4)
        link.is_at(0.2, 0, 0.7, within=0.15)


def test_the_page_shows_who_flies(cache):
    with started("--drones", 2, "--page", "127.0.0.1:0", pace=("--speed", 8)) as told:
        page = told["page"]

        def sessions():
            with urllib.request.urlopen(f"{page}/api/v1/sessions") as answer:
                return json.loads(answer.read())

        session = wait(sessions)[0]
        assert (session["env"], session["num_envs"]) == ("cf2", 1)
        with connected(told["drones"][1]["udp"], cache) as link:
            link.cf.high_level_commander.takeoff(0.5, 2.0)
            link.until(lambda: abs(link.place[2] - 0.5) < 0.05)
            live = page.replace("http", "ws") + "/live"
            with connect(live, subprotocols=["crazyflie.live.v1"]) as watcher:
                watcher.send(json.dumps({"watch": session["session"]}))
                head = watcher.recv()
                header = json.loads(head[4 : 4 + int.from_bytes(head[:4], "little")])
                row = watcher.recv()
            columns, drones = header["columns"], header["drones"]
            numbers = struct.unpack(f"<{drones * len(columns)}f", row)
            first, second = (
                dict(zip(columns, numbers[i * len(columns) : (i + 1) * len(columns)], strict=True)) for i in range(2)
            )
            assert (first["flying"], second["flying"]) == (0, 1) and first["z"] == 0
            for name in ("z", "setpoint_z", "fix_z"):
                assert second[name] == pytest.approx(0.5, abs=0.1), name


def test_a_server_has_drones_beside_its_environments(cache):
    command = [PROGRAM, "serve", "--listen", "127.0.0.1:0", "--crtp", "2", "--crtp-port", "0", "--log", "warn"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        page = "http://" + process.stdout.readline().split()[-1]
        uris = [process.stdout.readline().split()[0] for _ in range(2)]
        with connected(uris[1], cache) as link:
            link.cf.high_level_commander.takeoff(0.4, 1.5)
            link.until(lambda: link.place[2] > 0.3)
            with urllib.request.urlopen(f"{page}/api/v1/sessions") as answer:
                assert [session["env"] for session in json.loads(answer.read())] == ["cf2"]
    finally:
        process.terminate()
        assert process.wait(timeout=LIMIT_S) == 0


def test_a_flood_and_nonsense_change_nothing(drone, link):
    link.take_off()
    host, port = drone.removeprefix("udp://").split(":")
    sent = []

    def flood():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
            while len(sent) < 20000:
                with contextlib.suppress(OSError):
                    raw.sendto(os.urandom(len(sent) % 60), (host, int(port)))
                sent.append(None)

    # a thread of which the clock does not know: time goes on meanwhile
    _thread.start_new_thread(flood, ())
    # and from the one client that is heard: ports and channels that there are not
    for header in range(256):
        if header >> 4 in (1, 10, 11, 12, 14):
            link.cf.link.socket.send(bytes([header]) + struct.pack("<I", header))
    link.until(lambda: len(sent) == 20000)
    link.is_at(0, 0, 0.5)
    assert link.cf.supervisor.is_flying
