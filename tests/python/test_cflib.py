"""Stock cflib, unchanged, flies the program `crazyflie cf2` over real sockets, in lock-step: seconds are simulated."""

import itertools
import json
import math
import subprocess
import time
import warnings

import cflib.crtp
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.mem import CompressedSegment, CompressedStart, MemoryElement, Poly4D
from cflib.crazyflie.swarm import CachedCfFactory, Swarm
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.positioning.motion_commander import MotionCommander
from cflib.positioning.position_hl_commander import PositionHlCommander
from cflib.utils.reset_estimator import reset_estimator

from common import wait
from crazyflie_gym.lockstep import Clock
from crazyflies import PROGRAM, Link, connected, flying, restart, simulated

pytest_plugins = ["crazyflies"]


def test_a_scan_finds_every_drone_and_takes_none(cache):
    with simulated("--drones", 3, port=19850) as drones:
        uris = [drone["udp"] for drone in drones]
        assert uris == [f"udp://127.0.0.1:{19850 + i}" for i in range(3)]
        # cflib looks for a tenth of a second
        wait(lambda: [uri for uri, _ in cflib.crtp.scan_interfaces() if uri.startswith("udp://")] == uris)
        with flying(uris[1], cache) as link:
            assert link.cf.param.get_value("cpu.id0") == "1"


def test_tables_come_once_and_then_from_the_cache(tmp_path):
    with simulated() as drones:
        uri, tables = drones[0]["udp"], []
        for _ in range(2):
            sent = []
            cf = Crazyflie(rw_cache=str(tmp_path))
            cf.packet_sent.add_callback(sent.append)
            with SyncCrazyflie(uri, cf=cf) as scf:
                scf.wait_for_params()
                items = [packet for packet in sent if packet.channel == 0 and packet.port in (2, 5)]
                tables.append((cf.param.toc.toc.keys(), cf.log.toc.toc.keys(), len(items)))
                values = [(group, name) for group, names in cf.param.values.items() for name in names]
                assert len(values) == sum(map(len, cf.param.toc.toc.values())) > 60
        assert tables[0][2] > 140 and tables[1][2] == 2, "the second time, two checksums are enough"
        listed = json.loads(subprocess.run([PROGRAM, "cf2", "--tables", "--json"], capture_output=True).stdout)
        assert {f"{group}.{name}" for group, name in values} == {param["name"] for param in listed["parameters"]}


def test_log_blocks_come_as_often_as_they_should(cache):
    with simulated() as drones, flying(drones[0]["udp"], cache) as link:
        times = {}
        for period in (10, 20, 100, 1000):
            config = LogConfig(str(period), period)
            config.add_variable("stateEstimate.z", "FP16")
            config.add_variable("pm.vbat", "float")
            config.add_variable("supervisor.info")
            link.cf.log.add_config(config)
            config.data_received_cb.add_callback(
                lambda stamp, values, config: times.setdefault(config.period_in_ms, []).append((stamp, values))
            )
            config.start()
        time.sleep(2.5)
        for block in link.cf.log.log_blocks:
            block.stop()
        time.sleep(0.1)
        for period, got in times.items():
            assert abs(len(got) - 2500 / period) <= 1, (period, len(got))
            stamps = [stamp for stamp, _ in got]
            assert all(b - a == period for a, b in itertools.pairwise(stamps[2:])), stamps
            assert got[0][1]["pm.vbat"] == pytest.approx(4.2)
        counts = {period: len(got) for period, got in times.items()}
        time.sleep(0.3)
        assert counts == {period: len(got) for period, got in times.items()}, "what is stopped is silent"


def test_parameters_change_the_flight(link):
    param = link.cf.param
    param.set_value("posCtlPid.xVelMax", 0.2)
    defaults = []
    param.get_default_value("posCtlPid.xVelMax", lambda _, value: defaults.append(value))
    link.until(lambda: defaults)
    assert defaults == [1.0] and float(param.get_value("posCtlPid.xVelMax")) == pytest.approx(0.2)
    with pytest.raises(AttributeError):
        param.set_value("deck.bcFlow2", 1)
    link.take_off()
    speeds = []
    for limit in (0.2, 0.6):
        param.set_value("posCtlPid.xVelMax", limit)
        start, far = link.place[0], link.place[0] + 3
        link.repeat(3, link.cf.commander.send_position_setpoint, far, 0, 0.5, 0)
        speeds.append(link.now["stateEstimate.vx"])
        assert link.place[0] > start
    assert speeds == pytest.approx([0.2, 0.6], abs=0.06)


def test_stored_parameters_survive_a_restart(drone, cache):
    name, told = "posCtlPid.xVelMax", []

    def answer(ask):
        ask(name, lambda _, value: told.append(value))
        wait(lambda: told, "the parameter is not answered")
        return told.pop()

    def stored(param):
        return tuple(answer(param.persistent_get_state))

    with flying(drone, cache) as link:
        param = link.cf.param
        assert stored(param) == (False, 1.0, None)
        param.set_value(name, 0.25)
        assert answer(param.persistent_store) and stored(param) == (True, 1.0, 0.25)
        param.set_value(name, 0.75)
        param.set_value("posCtlPid.yVelMax", 0.5)
        with pytest.raises(AttributeError, match="not persistent"):
            param.persistent_store("sim.reset")
    restart(drone)
    with flying(drone, cache) as link:
        param = link.cf.param
        values = [float(param.get_value(f"posCtlPid.{axis}VelMax")) for axis in "xy"]
        assert values == [0.25, 1.0], "what was stored, not what was written last"
        assert answer(param.persistent_clear) and stored(param) == (False, 1.0, None)
    restart(drone)
    with flying(drone, cache) as link:
        assert float(link.cf.param.get_value(name)) == 1.0


def test_a_link_closes_with_parameters_still_to_be_written(cache):
    with simulated("--drones", 2) as drones, Clock(), connected(drones[1]["udp"], cache) as other:
        with connected(drones[0]["udp"], cache) as link:
            for i in range(6):
                link.cf.param.set_value("posCtlPid.xVelMax", 0.2 + 0.1 * i)
        other.take_off()
        assert other.place[2] == pytest.approx(0.5, abs=0.1)


def test_an_estimator_reset_is_what_scripts_wait_for(link):
    spread = []
    config = LogConfig("spread", 10)
    config.add_variable("kalman.varX")
    config.add_variable("stateEstimate.x")
    link.cf.log.add_config(config)
    config.data_received_cb.add_callback(lambda _, values, __: spread.append(values["kalman.varX"]))
    config.start()
    link.cf.param.set_value("kalman.initialX", 3)
    link.until(lambda: len(spread) > 20)
    settled = spread[-1]
    before = time.monotonic()
    reset_estimator(link.cf)
    assert time.monotonic() - before < 20
    assert max(spread) > 100 > 1e-4 > settled and spread[-1] == pytest.approx(settled, rel=0.2)
    link.is_at(0, 0, 0, within=0.02)


def test_arming(cache):
    with simulated("--no-auto-arm") as drones, flying(drones[0]["udp"], cache) as link:
        supervisor = link.cf.supervisor
        assert supervisor.read_state_list() == ["Can be armed"]
        link.take_off()
        link.is_at(0, 0, 0)
        supervisor.send_arming_request(True)
        time.sleep(1)
        assert {"Is armed", "Can fly"} <= set(supervisor.read_state_list())
        link.take_off()
        link.is_at(0, 0, 0.5)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            link.cf.platform.send_arming_request(False)
        link.until(lambda: link.now["stabilizer.thrust"] == 0)


def test_attitude_set_points_need_a_thrust_of_nothing_first(link):
    send = link.cf.commander.send_setpoint
    link.repeat(1, send, 0, 0, 0, 45000)
    link.is_at(0, 0, 0, within=0.02)
    send(0, 0, 0, 0)
    link.repeat(1.5, send, 0, 0, 0, 45000)
    assert link.place[2] > 0.5
    link.repeat(1, send, 0, 5, 0, 39343)
    assert link.now["stateEstimate.vx"] > 0.2, "a positive pitch flies forward"
    link.repeat(1, send, 0, 0, 0, 39343)


def test_set_points_of_every_kind(link):
    commander = link.cf.commander
    link.repeat(4, commander.send_zdistance_setpoint, 0, 0, 0, 0.6)
    link.is_at(0, 0, 0.6)
    x, y, _ = link.place
    link.repeat(3, commander.send_hover_setpoint, 0.2, 0, 0, 0.6)
    assert link.place[0] - x == pytest.approx(0.6, abs=0.2)
    link.repeat(1, commander.send_hover_setpoint, 0, 0, 90, 0.6)
    link.repeat(2, commander.send_hover_setpoint, 0, 0, 0, 0.6)
    assert link.now["stateEstimate.yaw"] == pytest.approx(90, abs=25), "counter-clockwise"
    y = link.place[1]
    link.repeat(3, commander.send_hover_setpoint, 0.2, 0, 0, 0.6)
    assert link.place[1] - y == pytest.approx(0.6, abs=0.25), "along the nose"
    link.repeat(2, commander.send_velocity_world_setpoint, -0.2, 0, 0.1, 0)
    assert link.now["stateEstimate.vx"] == pytest.approx(-0.2, abs=0.08)
    link.repeat(6, commander.send_position_setpoint, 0.5, -0.5, 0.8, 0)
    link.is_at(0.5, -0.5, 0.8)
    turned = (0, 0, math.sin(math.pi / 8), math.cos(math.pi / 8))
    zero = (0, 0, 0)
    link.repeat(6, lambda: commander.send_full_state_setpoint((0, 0, 0.5), zero, zero, turned, 0, 0, 0))
    link.is_at(0, 0, 0.5)
    assert link.now["stateEstimate.yaw"] == pytest.approx(45, abs=5)
    x = link.place[0]
    hover = 100 * (39343 - 10001) / (60000 - 10001)
    link.repeat(1.2, commander.send_setpoint_manual, 0, 5, 0, hover, False)
    assert math.dist(link.place[:2], (0, 0)) > 0.1
    commander.send_stop_setpoint()
    link.until(lambda: link.now["stabilizer.thrust"] == 0)


def test_motion_commander(link):
    # its own thread sends five set-points a second
    with MotionCommander(link.cf, default_height=0.3) as commander:
        assert link.place[2] == pytest.approx(0.3, abs=0.12)
        x = link.place[0]
        commander.forward(0.4, velocity=0.5)
        commander.stop()
        time.sleep(1)
        assert link.place[0] - x == pytest.approx(0.4, abs=0.15)
    link.until(lambda: link.now["stabilizer.thrust"] == 0)
    time.sleep(2)
    assert link.place[2] < 0.05


def test_a_thread_that_reads_the_time_flies_the_same_bits(cache):
    def flown():
        with simulated() as drones, flying(drones[0]["udp"], cache) as link:
            with MotionCommander(link.cf, default_height=0.3) as commander:
                commander.forward(0.3, velocity=0.5)
                commander.turn_left(90)
            return link.heights[-100:], link.now

    first = flown()
    time.sleep(0.37)
    assert flown() == first


def test_position_commander(link):
    with PositionHlCommander(link.cf, default_height=0.5, default_velocity=0.5) as commander:
        commander.go_to(0.5, 0.2)
        time.sleep(2)
        link.is_at(0.5, 0.2, 0.5)
        commander.back(0.5)
        time.sleep(2)
        link.is_at(0, 0.2, 0.5)
    time.sleep(1)
    assert link.place[2] < 0.05


def upload(link, trajectory, kind):
    memory = link.cf.mem.get_mems(MemoryElement.TYPE_TRAJ)[0]
    memory.trajectory = trajectory
    assert memory.write_data_sync()
    pieces = len(trajectory) - (1 if kind else 0)
    link.cf.high_level_commander.define_trajectory(1, 0, pieces, type=kind)


def test_the_high_level_commander(link):
    commander = link.cf.high_level_commander
    link.take_off(0.5)
    link.is_at(0, 0, 0.5)
    commander.go_to(0.6, 0, 0, 0, 3, relative=True)
    time.sleep(4)
    link.is_at(0.6, 0, 0.5)
    commander.go_to(0, 0.3, 0.7, math.pi / 2, 3)
    time.sleep(4)
    link.is_at(0, 0.3, 0.7)
    assert link.now["stateEstimate.yaw"] == pytest.approx(90, abs=5)
    assert {"HL control is active", "Finished HL trajectory"} <= set(link.cf.supervisor.read_state_list())
    commander.spiral(math.pi, 0.3, 0.3, 0.1, 4)
    time.sleep(5)
    link.is_at(-0.6, 0.3, 0.8, within=0.12)
    commander.land(0.0, 2.0)
    link.until(lambda: link.now["stabilizer.thrust"] == 0)
    time.sleep(1)
    assert link.place[2] < 0.03 and link.cf.supervisor.can_fly


def test_uploaded_trajectories(link):
    commander = link.cf.high_level_commander
    link.take_off(0.5)
    # a straight metre in x with a smooth start and end: 10 s^3 - 15 s^4 + 6 s^5 over 4 s
    x = Poly4D.Poly([0, 0, 0, 10 / 4**3, -15 / 4**4, 6 / 4**5, 0, 0])
    upload(link, [Poly4D(4, x=x, z=Poly4D.Poly([0.5] + [0] * 7))], commander.TRAJECTORY_TYPE_POLY4D)
    commander.start_trajectory(1)
    time.sleep(2)
    assert 0.1 < link.place[0] < 0.6
    time.sleep(3)
    link.is_at(1, 0, 0.5)
    commander.start_trajectory(1, reversed=True)
    time.sleep(5)
    link.is_at(0, 0, 0.5)
    segment = CompressedSegment(3, [0, 0.5, 0.5], [], [0.0, 0.2, 0.2], [])
    upload(link, [CompressedStart(0, 0, 0, 0), segment], commander.TRAJECTORY_TYPE_POLY4D_COMPRESSED)
    commander.start_trajectory(1, relative_position=True)
    time.sleep(4.5)
    link.is_at(0.5, 0, 0.7)


def test_a_swarm_flies_a_choreography(cache):
    with simulated("--drones", 8) as drones, Clock():
        uris = [drone["udp"] for drone in drones]
        seen = {}

        def dance(scf, index):
            link = Link(scf)
            x, y, _ = link.place
            link.take_off(0.4 + 0.05 * index)
            commander = scf.cf.high_level_commander
            # all a place on: half a metre to the right and back, each at its own height
            for side in (0.5, -0.5):
                commander.go_to(side, 0, 0, 0, 2, relative=True)
                time.sleep(3.5)
                seen.setdefault(index, []).append((link.place[0] - x, link.place[1] - y, link.place[2]))
            commander.land(0, 2)
            time.sleep(3)
            seen[index].append(link.place[2])

        with Swarm(uris, factory=CachedCfFactory(rw_cache=cache)) as swarm:
            swarm.parallel_safe(dance, {uri: [index] for index, uri in enumerate(uris)})
        assert len(seen) == 8
        for index, (there, back, height) in seen.items():
            assert there == pytest.approx((0.5, 0, 0.4 + 0.05 * index), abs=0.1), index
            assert back == pytest.approx((0, 0, 0.4 + 0.05 * index), abs=0.1), index
            assert height < 0.05


def test_a_rest_that_rounds_to_nothing_takes_a_tick():
    clock = Clock()
    clock._frozen_ns = 829_935_000_000
    assert clock._waiter(1e-13).due_ns > clock._frozen_ns, "who waits for it would ask again and again"
    assert clock._waiter(0.0).due_ns == clock._frozen_ns
