"""Environments on a real server are the environments of this process, bit for bit."""

import contextlib
import gc
import hashlib
import importlib.util
import os
import pathlib
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import crazyflie_gym
from common import FIVE, IDS, LIMIT_S, SINGLE, actions_for, random_actions, wait
from served import Server

remote = pytest.importorskip("crazyflie_gym.remote", reason="the extra remote is not installed")

EXAMPLES = pathlib.Path(__file__).parents[2] / "examples"
DRAWN = {**FIVE, "wind": {"x_mps2": {"uniform": [-1, 1]}}, "camera_latency": 0.05}
# so close to the wall that some episodes terminate, and others are truncated
WALL = {"task_options": {"start_radius_m": 2.0, "start_yaw_deg": 90.0}, "max_episode_steps": 12, "vertical": "pwm"}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("server"))
    yield server
    server.stop()


def same(a, b, where="result"):
    """Whether two results are the same in type, shape and every bit."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            same(a[key], b[key], f"{where}.{key}")
    elif isinstance(a, tuple | list) or (isinstance(a, np.ndarray) and a.dtype.hasobject):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            same(x, y, f"{where}[{i}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes(), where
        assert a.flags.writeable and b.flags.writeable, where
    else:
        assert type(a) is type(b) and a == b, where


def test_a_single_environment(server, env_id):
    for kwargs in (
        {},
        {
            "effects": DRAWN,
            "vertical": "pwm",
            "true_state": True,
            "form": "dict",
            "observation": "estimate",
            "history": 2,
        },
    ):
        here = gym.make(env_id, **kwargs)
        there = gym.make(env_id, remote=server.url, **kwargs)
        assert there.observation_space == here.observation_space and there.action_space == here.action_space
        assert there.spec.max_episode_steps == here.spec.max_episode_steps
        for name in ("vertical", "tilt_max_rad", "yaw_rate_max_radps", "lift_max", "hover_lift", "yaw_sign", "tick_s"):
            assert getattr(here.unwrapped.interface, name) == getattr(there.unwrapped.interface, name)
        same(here.reset(seed=7), there.reset(seed=7))
        for action in actions_for(here.action_space, 60, seed=1):
            a, b = here.step(action), there.step(action)
            same(a, b)
            if a[2] or a[3]:
                same(here.reset(), there.reset())
        there.close()
        there.close()


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_a_batch(server, mode):
    count = 7
    ends = 0
    for kwargs in ({}, {"true_state": True, "form": "dict", "observation": "state", "effects": DRAWN}, {"copy": False}):
        args = {"num_envs": count, "autoreset_mode": mode, **WALL, **kwargs}
        here = gym.make_vec("Crazyflie-v0", **args)
        there = gym.make_vec("Crazyflie-v0", remote=server.url, **args)
        assert there.observation_space == here.observation_space and there.action_space == here.action_space
        assert there.metadata == here.metadata and there.num_envs == count
        # none of them was given a seed: some are drawn
        same(
            here.reset(seed=[3, None, 5, None, None, 2**64 - 1, 0]),
            there.reset(seed=[3, None, 5, None, None, 2**64 - 1, 0]),
        )
        for actions in random_actions(40, count):
            a, b = here.step(actions), there.step(actions)
            same(a, b)
            done = a[2] | a[3]
            ends += done.sum()
            if mode == "disabled" and done.any():
                options = {"reset_mask": done}
                same(here.reset(options=options), there.reset(options=options))
        same(here.reset(seed=[None, 1] + [None] * 5), there.reset(seed=[None, 1] + [None] * 5))
        there.close()
    assert ends >= 6 * count


@pytest.mark.parametrize("env_id", IDS)
def test_several_ticks_in_one_request(server, env_id):
    for mode in ("next_step", "same_step"):
        # the last ones take more than one request; of several drones each tick does
        large = [(2048, 9, True)] if env_id in SINGLE else []
        for count, ticks, true_state in [(5, 30, True), (5, 30, False), *large]:
            args = {"num_envs": count, "autoreset_mode": mode, "max_episode_steps": 4, "true_state": true_state}
            here = gym.make_vec(env_id, **args)
            there = gym.make_vec(env_id, remote=server.url, **args)
            actions = actions_for(here.action_space, ticks)
            same(here.reset(seed=1), there.reset(seed=1))
            assert (ticks > there.unwrapped.sim.max_steps) == (count == 2048)
            a, b = here.unwrapped.step_many(actions), there.unwrapped.step_many(actions)
            same(a, b)
            assert (a[2] | a[3]).sum() >= count and ("final_obs" in a[4]) == (mode == "same_step")
            same(here.step(actions[0]), there.step(actions[0]))
            there.close()


def test_several_ticks_are_as_many_steps():
    many, single = (gym.make_vec("Crazyflie-v0", num_envs=3, autoreset_mode="same_step", **WALL) for _ in range(2))
    many.reset(seed=0), single.reset(seed=0)
    actions = random_actions(30, 3)
    rows, rewards, terminated, truncated, infos = many.unwrapped.step_many(actions)
    finals = []
    for k in range(30):
        result = single.step(actions[k])
        same((rows[k], rewards[k], terminated[k], truncated[k]), result[:4])
        finals += [row for row in result[4].get("final_obs", []) if row is not None]
    assert len(finals) >= 6
    same(infos["final_obs"], np.array(finals))
    actions[20, 2, 1] = np.nan
    with pytest.raises(ValueError, match=r"step 20: actions\[2\]\[1\] is nan"):
        many.unwrapped.step_many(actions)


FINE = st.floats(0.0, 1.0).map(lambda x: x / 3.0)


@settings(max_examples=15, deadline=None)
@given(FINE, FINE, FINE)
def test_numbers_of_options_arrive_with_every_digit(server, wind, drag, start):
    kwargs = {
        "effects": {"wind": wind, "drag_linear": drag},
        "task_options": {"start_radius_m": start},
        "true_state": True,
    }
    here = gym.make("Crazyflie-v0", **kwargs)
    there = gym.make("Crazyflie-v0", remote=server.url, **kwargs)
    same(here.reset(seed=1), there.reset(seed=1))
    for action in random_actions(8, 1)[:, 0]:
        same(here.step(action), there.step(action))
    there.close()


def test_a_wind_from_place_to_place_and_a_race_are_the_same_there(server):
    field = crazyflie_gym.WindField.sample(lambda places: places * [0.5, -0.2, 0.1], [-2, -2, 0], [2, 2, 2], 0.5)
    options = {"effects": {"drag_linear": 0.4}, "wind_field": field, "task_options": {"level": 4}}
    options["observation"] = ["gate_pos_m", "obstacle_m", "pos_m"]
    here = gym.make("CrazyflieRace-v0", **options)
    there = gym.make("CrazyflieRace-v0", remote=server.url, **options)
    same(here.reset(seed=1), there.reset(seed=1))
    for action in random_actions(40, 1)[:, 0]:
        blown = here.step(action)
        same(blown, there.step(action))
    calm = gym.make("CrazyflieRace-v0", **(options | {"wind_field": None}))
    calm.reset(seed=1)
    for action in random_actions(40, 1)[:, 0]:
        still = calm.step(action)
    assert not np.array_equal(blown[0], still[0])
    there.close()


def test_drones_of_a_swarm(server):
    here, there = (
        crazyflie_gym.CrazyflieSwarm(2, "swap", drones=3, max_episode_steps=3, true_state=True, **more)
        for more in ({}, {"remote": server.url})
    )
    same(here.reset(seed=4), there.reset(seed=4))
    for _ in range(5):
        same(here.step(np.zeros((2, 3, 4), np.float32)), there.step(np.zeros((2, 3, 4), np.float32)))
    there.close()


def test_a_model_of_ones_own(server):
    text = crazyflie_gym.model_text().replace("123.2", "99.9", 1)
    assert text != crazyflie_gym.model_text()
    here = gym.make("Crazyflie-v0", model=text)
    there = gym.make("Crazyflie-v0", model=text, remote=server.url)
    same(here.reset(seed=1), there.reset(seed=1))
    for action in random_actions(20, 1)[:, 0]:
        same(here.step(action), there.step(action))
    there.close()


def test_pictures_and_the_pid(server):
    for options in ({"observation": "measured"}, {}):
        here = gym.make("Crazyflie-v0", render_mode="rgb_array", **options)
        there = gym.make("Crazyflie-v0", render_mode="rgb_array", remote=server.url, **options)
        pids = here.unwrapped.pid(), there.unwrapped.pid()
        here.reset(seed=3), there.reset(seed=3)
        for _ in range(10):
            action = here.unwrapped.act(pids[0])
            if options:
                same(action, there.unwrapped.act(pids[1]))
            here.step(action), there.step(action)
        same(here.render(), there.render())
        if not options:
            with pytest.raises(ValueError, match="expected observation=\"measured\", got 'state'"):
                there.unwrapped.act(pids[1])
        there.close()


def test_mistakes_are_the_same_exceptions(server):
    def both(make, error):
        words = []
        for where in ({}, {"remote": server.url}):
            with pytest.raises(error) as raised:
                make(where)
            words.append(str(raised.value))
        return words

    for kwargs in (
        {"effects": {"drag_lineer": 0.3}},
        {"effects": {"wind": {"x_mps2": 30}}},
        {"task_options": {"start_radius": 1}},
        {"vertical": "hight"},
        {"physics_hz": 77},
        {"model": "schema = 1\nname = 'x'\n"},
    ):
        here, there = both(lambda where, kwargs=kwargs: gym.make("Crazyflie-v0", **kwargs, **where), ValueError)
        assert here.split(" at line")[0] in there
    here, there = both(lambda where: crazyflie_gym.CrazyflieVectorEnv(2, task="hoover", **where), ValueError)
    assert here == there
    for count, error in ((0, ValueError), (-1, ValueError), (2.5, TypeError)):
        both(lambda where, count=count: crazyflie_gym.CrazyflieVectorEnv(count, **where), error)

    good = np.zeros((20, 4), np.float32)
    for mode in ("next_step", "same_step", "disabled"):
        envs = [crazyflie_gym.CrazyflieVectorEnv(20, autoreset_mode=mode, **w) for w in ({}, {"remote": server.url})]
        for env in envs:
            with pytest.raises(RuntimeError, match="reset"):
                env.step(good)
            env.reset(seed=1)
        for bad, error in (
            (np.full((20, 4), 1.5, np.float32), ValueError),
            (np.full((20, 4), np.nan, np.float32), ValueError),
            (np.zeros((19, 4), np.float32), ValueError),
            (np.full((20, 4), "up"), TypeError),
        ):
            words = []
            for env in envs:
                with pytest.raises(error) as raised:
                    env.step(bad)
                words.append(str(raised.value))
            assert words[0] == words[1]
        # nothing has moved, and the session lives
        same(envs[0].step(good), envs[1].step(good))
        envs[1].close()
    with pytest.raises(RuntimeError, match="ended"):
        env = crazyflie_gym.CrazyflieEnv(task_options={"start_m": [2.4, 0, 0.7]}, remote=server.url)
        env.reset(seed=0)
        for _ in range(500):
            env.step(np.array([0, 1, 0, 0], np.float32))


SECURE = """
import sys
import gymnasium as gym, crazyflie_gym
print(gym.make("Crazyflie-v0", remote=sys.argv[1]).reset(seed=5)[0].tobytes().hex())
"""


@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl to make a certificate with")
def test_tls_is_trusted_as_the_machine_trusts(tmp_path):
    key, cert = tmp_path / "key.pem", tmp_path / "cert.pem"
    request = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=lab"
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-addext", "basicConstraints=critical,CA:FALSE"]
    command = ["openssl", *request.split(), *names, "-keyout", str(key), "-out", str(cert)]
    subprocess.run(command, check=True, capture_output=True)
    server = Server(tmp_path, "--tls-cert", str(cert), "--tls-key", str(key))
    url = server.url.replace("ws://", "wss://")
    command = [sys.executable, "-c", SECURE, url]
    trusting = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "SSL_CERT_FILE": str(cert)})
    expected = gym.make("Crazyflie-v0").reset(seed=5)[0].tobytes().hex()
    assert trusting.stdout.strip() == expected, trusting.stderr
    with pytest.raises(ConnectionError, match=r"certificate|SSL"):
        gym.make("Crazyflie-v0", remote=url)
    trust = ssl.create_default_context(cafile=cert)
    with (
        socket.create_connection(("127.0.0.1", server.port)) as plain,
        trust.wrap_socket(plain, server_hostname="127.0.0.1") as secure,
    ):
        secure.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        assert secure.recv(100).startswith(b"HTTP/1.1 200")
        # a ticket in the middle of a request can lose the request
        assert not secure.session.has_ticket
    server.stop()


def test_addresses():
    for url in ("http://127.0.0.1", "127.0.0.1:8765", "ws://", ""):
        with pytest.raises(ValueError, match="expected ws://host:port"):
            gym.make("Crazyflie-v0", remote=url)
    with pytest.raises(ValueError, match="logs"):
        remote.Client("ws://me:secret@127.0.0.1")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    with pytest.raises(ConnectionError, match=str(port)):
        gym.make("Crazyflie-v0", remote=f"ws://127.0.0.1:{port}")
    # it has one model for all drones; the others were left out without a word
    with pytest.raises(ValueError, match="expected one for all drones where a server simulates, got 2"):
        gym.make_vec("Crazyflie-v0", num_envs=1, task="formation", model=[None, None], remote="ws://127.0.0.1")


class Wire:
    """A connection between client and server that can be cut, and cut short."""

    def __init__(self, port):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"ws://127.0.0.1:{self.listener.getsockname()[1]}"
        self.port = port
        self.pairs = []
        # bytes of replies that still get through; None for all
        self.left = None
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            try:
                near, _ = self.listener.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self.port))
            self.left = None
            self.pairs.append((near, far))
            threading.Thread(target=self.copy, args=(near, far, False), daemon=True).start()
            threading.Thread(target=self.copy, args=(far, near, True), daemon=True).start()

    def copy(self, source, sink, replies):
        try:
            while data := source.recv(1 << 16):
                if replies and self.left is not None:
                    data, self.left = data[: self.left], max(0, self.left - len(data))
                    sink.sendall(data)
                    if self.left == 0:
                        break
                else:
                    sink.sendall(data)
        except OSError:
            pass
        for end in (source, sink):
            # a close alone would not wake the other thread
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self):
        for near, far in self.pairs:
            for end in (near, far):
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def close(self):
        # a close alone would not wake the thread that accepts
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        self.cut()


def test_a_lost_connection_is_taken_up_again(server):
    wire = Wire(server.port)
    here = gym.make_vec("Crazyflie-v0", num_envs=5, autoreset_mode="same_step", **WALL)
    there = gym.make_vec("Crazyflie-v0", num_envs=5, autoreset_mode="same_step", remote=wire.url, **WALL)
    same(here.reset(seed=1), there.reset(seed=1))
    for k, actions in enumerate(random_actions(40, 5)):
        if k % 10 == 5:
            wire.cut()
        if k % 10 == 8:
            # the request arrives, half of its reply comes back: it must not be stepped twice
            wire.left = 100
        same(here.step(actions), there.step(actions))
    assert there.unwrapped.sim.client.resumed == 8
    wire.close()
    there.unwrapped.sim.client.resume_s = 0.2
    with pytest.raises(ConnectionError, match="was lost"):
        there.step(random_actions(1, 5)[0])


def test_a_server_that_stops(tmp_path):
    server = Server(tmp_path)
    env = gym.make("Crazyflie-v0", remote=server.url)
    env.reset(seed=0)
    env.step(np.zeros(4, np.float32))
    server.stop()
    with pytest.raises(ConnectionError, match="the server stops"):
        env.step(np.zeros(4, np.float32))


def test_many_clients_at_once(server):
    envs = [gym.make("Crazyflie-v0", remote=server.url).unwrapped for _ in range(200)]
    reference = crazyflie_gym.CrazyflieVectorEnv(200, max_episode_steps=-1)
    expected = reference.reset(seed=0)[0]
    actions = random_actions(5, 200, size=0.1)
    failures = []

    def fly(mine):
        try:
            for i in mine:
                same(envs[i].reset(seed=i)[0], expected[i])
            for k in range(5):
                for i in mine:
                    same(envs[i].step(actions[k, i])[0], results[k][i])
        except BaseException as error:
            failures.append(error)

    results = [reference.step(actions[k])[0] for k in range(5)]
    threads = [threading.Thread(target=fly, args=(range(i, 200, 8),)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    for env in envs:
        env.close()


WAITING = """
import sys
import signal
from crazyflie_gym import remote
# a process that a shell has started in the background ignores SIGINT
signal.signal(signal.SIGINT, signal.default_int_handler)
server = remote.Client(sys.argv[1])
server.ask("make")
print("made", flush=True)
sys.stdin.readline()
server.ask("reset")
"""


def test_an_interrupt_is_noticed_while_waiting(tmp_path):
    server = Server(tmp_path)
    command = [sys.executable, "-c", WAITING, server.url]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdout.readline() == "made\n"
        # from here on nobody answers
        server.process.send_signal(signal.SIGSTOP)
        assert os.WIFSTOPPED(os.waitpid(server.process.pid, os.WUNTRACED)[1])
        process.stdin.write("go\n")
        process.stdin.flush()
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, words = process.communicate(timeout=LIMIT_S)
    server.process.send_signal(signal.SIGCONT)
    server.stop()
    assert words.rstrip().endswith("KeyboardInterrupt")


def test_a_client_that_is_forgotten_goes_away(server):
    threads = len(os.listdir("/proc/self/task")) if os.path.isdir("/proc/self/task") else None
    env = gym.make("Crazyflie-v0", remote=server.url)
    env.reset(seed=0)
    del env
    gc.collect()
    if threads is not None:
        wait(lambda: len(os.listdir("/proc/self/task")) <= threads)


def test_a_client_from_the_protocol_page_flies_the_flight_of_this_process(server):
    example = EXAMPLES / "remote_client.py"
    done = subprocess.run([sys.executable, str(example), server.url], capture_output=True, text=True, check=True)
    spec = importlib.util.spec_from_file_location("remote_client", example)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    env = gym.make("Crazyflie-v0", observation="measured", effects={"gust": 0.2, "camera_noise": 0.01})
    with module.connect(f"{server.url}/ws", subprotocols=["crazyflie.v1"], compression=None) as ws:
        session = module.Session(ws, env="Crazyflie-v0", options={"effects": {"gust": 0.2, "camera_noise": 0.01}})
        rows, actions, rewards = module.fly(session, seed=7)
        with pytest.raises(ValueError, match="bad_action"):
            session.step([2, 0, 0, 0])
    here = [env.reset(seed=7)[0]]
    for action, expected in zip(actions, rewards, strict=True):
        row, reward, terminated, truncated, _ = env.step(np.float32(action))
        here.append(row)
        assert np.float32(reward) == np.float32(expected)
    assert (terminated or truncated) and len(actions) > 100
    assert np.array(here).tobytes() == np.float32(rows).tobytes()
    assert hashlib.sha256(np.array(here).tobytes()).hexdigest() in done.stdout


def test_every_action_level_flies_there_as_here(server):
    for level in crazyflie_gym.action_levels():
        name = level["name"]
        here, there = (gym.make("Crazyflie-v0", action=name, **more).unwrapped for more in ({}, {"remote": server.url}))
        assert there.interface.action == name
        assert there.interface.action_ranges == here.interface.action_ranges
        for env in (here, there):
            env.reset(seed=1)
        for step in range(5):
            action = np.full(4, 0.1 * step, np.float32)
            np.testing.assert_array_equal(here.step(action)[0], there.step(action)[0])
        there.close()
