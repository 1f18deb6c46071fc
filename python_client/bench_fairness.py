"""Attacks on a server of this machine at full size, and an honest client beside each.

    python python_client/bench_fairness.py                       # the program of this environment
    python python_client/bench_fairness.py target/debug/crazyflie

Every attack has a fresh server. The table has the memory of the server at most, the steps per second and the
99th percentile in ms of a client that makes one step at a time, alone and beside the attack, and what the attack got.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import re
import resource
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

FLOODERS = 4
FLOOD_S = 4
READERS = 500
UNFINISHED = 510
PART = int(1.8 * 2**20)
ATTEMPTS, TEAMS, LISTERS = 2500, 100, 64


class Server:
    """A server in a process of its own, with a database that is thrown away."""

    def __init__(self, program, log="error"):
        """Choose the program and the level of its log."""
        self.program, self.level = program, log

    def __enter__(self):
        """Start it, learn its port, and watch its memory."""
        self.folder = tempfile.TemporaryDirectory()
        self.data = os.path.join(self.folder.name, "bench.sqlite")
        self.log = open(os.path.join(self.folder.name, "log"), "wb")
        command = [*self.program, "serve", "--listen", "127.0.0.1:0", "--log", self.level, "--data", self.data]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.log, text=True)
        self.port = int(self.process.stdout.readline().rsplit(":", 1)[1])
        self.most_mib, self.watching = 0, True
        self.watcher = threading.Thread(target=self.watch)
        self.watcher.start()
        return self

    def watch(self):
        """Note the largest resident memory until the end."""
        while self.watching:
            with contextlib.suppress(OSError, AttributeError):
                with open(f"/proc/{self.process.pid}/status") as status:
                    kib = int(re.search(r"VmRSS:\s+(\d+)", status.read())[1])
                self.most_mib = max(self.most_mib, kib >> 10)
            time.sleep(0.05)

    def log_bytes(self):
        """Return the size of the log."""
        return os.path.getsize(self.log.name)

    def __exit__(self, *_):
        """Stop it."""
        self.watching = False
        self.watcher.join()
        self.process.terminate()
        self.process.communicate()
        self.log.close()
        self.folder.cleanup()


def frame(opcode, payload=b"", final=True):
    """Return a frame of a client, with a mask of zeros."""
    head = bytes([(0x80 if final else 0) | opcode])
    length = len(payload)
    if length < 126:
        head += bytes([0x80 | length])
    elif length < 2**16:
        head += bytes([0x80 | 126]) + struct.pack(">H", length)
    else:
        head += bytes([0x80 | 127]) + struct.pack(">Q", length)
    return head + bytes(4) + payload


def text(**message):
    """Return a JSON message as a frame."""
    return frame(1, json.dumps(message).encode())


class Peer:
    """One connection that does what no client library would."""

    def __init__(self, port, protocol=None, path="/ws", receive_bytes=None):
        """Connect, with a buffer of the system of this size; with a protocol the connection is upgraded."""
        self.socket = socket.socket()
        if receive_bytes:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        self.socket.settimeout(120)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.input = self.socket.makefile("rb", buffering=1 << 16)
        if protocol:
            self.socket.sendall(
                f"GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: upgrade\r\nupgrade: websocket\r\n"
                f"sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
                f"sec-websocket-protocol: {protocol}\r\n\r\n".encode()
            )
            while self.input.readline() not in (b"\r\n", b""):
                pass

    def ask(self, octets):
        """Send a frame and return the payload of the next message."""
        self.socket.sendall(octets)
        while True:
            opcode, length = self.input.read(2)
            if length == 126:
                length = struct.unpack(">H", self.input.read(2))[0]
            elif length == 127:
                length = struct.unpack(">Q", self.input.read(8))[0]
            payload = self.input.read(length)
            if opcode & 15 in (1, 2):
                return payload
            if opcode & 15 == 8:
                raise ConnectionError(payload)

    def ask_json(self, **message):
        """Send a JSON request and return the reply."""
        return json.loads(self.ask(text(**message)))


def honest(port, seconds, out):
    """Make one step at a time; put rate and 99th percentile into `out`."""
    peer = Peer(port, "crazyflie.v1")
    peer.ask_json(id=1, type="make", num_envs=1)
    peer.ask(frame(2, struct.pack("<QBBHI", 2, 1, 0, 0, 1)))
    times, began = [], time.perf_counter()
    while time.perf_counter() - began < seconds:
        asked = time.perf_counter()
        peer.ask(frame(2, struct.pack("<QBBHI4f", 3 + len(times), 2, 0, 1, 1, 0, 0, 0, 0)))
        times.append(time.perf_counter() - asked)
    out.put((len(times) / (time.perf_counter() - began), 1e3 * sorted(times)[len(times) * 99 // 100]))


def measure(port, seconds=FLOOD_S):
    """Return rate and 99th percentile of an honest client, in a process of its own."""
    out = multiprocessing.Queue()
    process = multiprocessing.Process(target=honest, args=(port, seconds, out))
    process.start()
    try:
        return out.get(timeout=150)
    except Exception:  # the honest client was not served at all
        return 0.0, float("inf")
    finally:
        process.join()


def flood(port, protocol, path, octets, first=b""):
    """Send the same octets without end, after the first, and read whatever is answered."""
    peer = Peer(port, protocol, path)
    peer.socket.sendall(first)

    def read():
        with contextlib.suppress(OSError):
            while peer.socket.recv(1 << 16):
                pass

    threading.Thread(target=read, daemon=True).start()
    many = octets * (1 + 30_000 // len(octets))
    with contextlib.suppress(OSError):
        while True:
            peer.socket.sendall(many)


FLOODS = {
    "pongs": ("crazyflie.v1", "/ws", frame(10)),
    "empty fragments": ("crazyflie.v1", "/ws", frame(0, final=False), frame(1, final=False)),
    "pings": ("crazyflie.v1", "/ws", frame(9, b"x")),
    "echo": ("crazyflie.echo.v1", "/ws", frame(2, b"x")),
    "/live": ("crazyflie.live.v1", "/live", text(watch=None)),
    "/live errors": ("crazyflie.live.v1", "/live", frame(1, b"{}")),
    "pipelined /healthz": (None, "/healthz", b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n"),
    "pipelined hello": ("crazyflie.v1", "/ws", text(id=1, type="hello", client="x")),
}


def show(name, server, alone, beside, got=""):
    """Print a row."""
    (rate, ms), (rate_beside, ms_beside) = alone, beside
    print(
        f"{name:22s} {server.most_mib:6d} MiB  alone {rate:6.0f}/s p99 {ms:6.2f} ms  "
        f"beside {rate_beside:6.0f}/s p99 {ms_beside:7.2f} ms  {got}",
        flush=True,
    )


def measure_floods(program):
    """Run every flood, four connections each."""
    for name, octets in FLOODS.items():
        with Server(program, "info") as server:
            alone = measure(server.port)
            logged, began = server.log_bytes(), time.perf_counter()
            flooders = [multiprocessing.Process(target=flood, args=(server.port, *octets)) for _ in range(FLOODERS)]
            for process in flooders:
                process.start()
            time.sleep(0.5)
            beside = measure(server.port)
            share = beside[0] / (alone[0] / (FLOODERS + 1))
            log = (server.log_bytes() - logged) / (time.perf_counter() - began) / 1e3
            for process in flooders:
                process.terminate()
                process.join()
            show(f"4 x {name}", server, alone, beside, f"{share:.2f} of a fair share, log {log:.1f} kB/s")


def measure_parked(name, program, prepare, attack, count, seconds):
    """Open connections that leave something in the server's memory, and measure beside them."""
    with Server(program) as server:
        alone = measure(server.port)
        prepare(server)
        server.most_mib = 0
        peers, stop = [], threading.Event()

        def open_all():
            for _ in range(count):
                with contextlib.suppress(OSError, ValueError):
                    peer = attack(server)
                    peer.socket.settimeout(0.5)
                    peers.append(peer)
                if stop.is_set():
                    return

        opener = threading.Thread(target=open_all)
        opener.start()
        began, beside = time.perf_counter(), measure(server.port, seconds)
        stop.set()
        opener.join()
        time.sleep(max(0.0, seconds + 22 - (time.perf_counter() - began)))
        with open(f"/proc/{server.process.pid}/status") as status:
            left = int(re.search(r"VmRSS:\s+(\d+)", status.read())[1]) >> 10
        show(name, server, alone, beside, f"{len(peers)} connections, {left} MiB after 22 s")
        for peer in peers:
            peer.socket.close()


def fly_long_world(server):
    """Fly a world of 50 drones for 9800 steps."""
    pilot = Peer(server.port, "crazyflie.v1")
    options = {"drones": 50, "max_episode_steps": 9800}
    world = pilot.ask_json(id=1, type="world", name="long", mission="swap", options=options, deadline_s=10)
    assert world["type"] == "world", world
    assert pilot.ask_json(id=2, type="join", name="long")["type"] == "joined"
    fly = text(id=3, type="fly", action=[0, 0, 0, 0.07])
    while json.loads(pilot.ask(fly)).get("flying"):
        pass


def read_nothing(server):
    """Request the log of the world, and read nothing."""
    peer = Peer(server.port)
    peer.socket.sendall(b"GET /api/v1/worlds/long/log HTTP/1.1\r\nhost: localhost\r\n\r\n")
    return peer


def begin_message(server):
    """Send the first part of a message."""
    peer = Peer(server.port, "crazyflie.v1")
    peer.socket.settimeout(2)
    peer.socket.sendall(frame(2, bytes(PART), final=False))
    return peer


def request_echo(server):
    """Send a message of 2 MiB to be echoed, and read nothing."""
    peer = Peer(server.port, "crazyflie.echo.v1", receive_bytes=4096)
    peer.socket.settimeout(0.1)
    with contextlib.suppress(OSError):
        for _ in range(4):
            peer.socket.sendall(frame(2, bytes(2**21)))
    return peer


def fly_attempt(port, token):
    """Return the seconds that an attempt takes."""
    began, peer = time.perf_counter(), Peer(port, "crazyflie.v1")
    begun = peer.ask_json(id=1, type="benchmark", scenario="takeoff", controller="still", token=token)
    count, number, over = begun["num_envs"], 2, False
    while not over:
        reply = peer.ask(frame(2, struct.pack("<QBBHI", number, 2, 0, 1, count) + bytes(16 * count)))
        number, over = number + 1, bool(reply[9] & 2)
    peer.ask_json(id=number, type="finish")
    return time.perf_counter() - began


def list_attempts(port):
    """Request the list of attempts without end."""
    with contextlib.suppress(OSError):
        while True:
            peer = Peer(port)
            peer.socket.sendall(b"GET /api/v1/attempts HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")
            while peer.input.read(1 << 16):
                pass
            peer.socket.close()


def measure_attempts(program):
    """Begin many attempts, and fly one beside clients that list them."""
    with Server(program) as server:
        command = [*program, "bench", "token", "create", "--json", "--data", server.data]
        make = lambda team: json.loads(subprocess.check_output([*command, team], text=True))["token"]  # noqa: E731
        tokens = [make(f"team-{number}") for number in range(TEAMS)]
        for number in range(ATTEMPTS):
            token = tokens[number % TEAMS]
            peer = Peer(server.port, "crazyflie.v1")
            peer.ask_json(id=1, type="benchmark", scenario="takeoff", controller="left", token=token)
            peer.socket.close()
        alone = fly_attempt(server.port, make("alone"))
        began = time.perf_counter()
        peer = Peer(server.port)
        peer.socket.sendall(b"GET /api/v1/attempts HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")
        size = len(peer.input.read())
        took = time.perf_counter() - began
        listers = [multiprocessing.Process(target=list_attempts, args=(server.port,)) for _ in range(LISTERS)]
        for process in listers:
            process.start()
        time.sleep(1)
        beside = fly_attempt(server.port, make("beside"))
        for process in listers:
            process.terminate()
            process.join()
        print(
            f"{ATTEMPTS} attempts, {LISTERS} lists {server.most_mib:5d} MiB  a list takes {took:.3f} s, {size} bytes; "
            f"an attempt takes {alone:.2f} s alone, {beside:.2f} s beside",
            flush=True,
        )


def measure_guesses(program):
    """Guess the invitation of a world."""
    with Server(program, "info") as server:
        host = Peer(server.port, "crazyflie.v1")
        host.ask_json(id=1, type="world", name="private", mission="swap", invitation="open sesame")
        guesser, refused, began, logged = Peer(server.port, "crazyflie.v1"), 0, time.perf_counter(), server.log_bytes()
        guesses = 0
        while time.perf_counter() - began < FLOOD_S:
            reply = guesser.ask_json(id=2, type="join", name="private", invitation=f"guess {guesses}")
            guesses, refused = guesses + 1, refused + (reply["code"] == "too_many")
        rate = (guesses - refused) / FLOOD_S
        log = server.log_bytes() - logged
        print(f"invitations: {rate:.0f} guesses/s, {refused / FLOOD_S:.0f}/s refused, {log} bytes of log", flush=True)


def nothing(_):
    """Prepare nothing."""


def main():
    """Run the attacks."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("program", nargs="?", help="the program to attack, otherwise that of this environment")
    parser.add_argument("--only", default="floods,logs,unfinished,echoes,attempts,guesses", help="attacks, with commas")
    arguments = parser.parse_args()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, hard), hard))
    program = [arguments.program] if arguments.program else [sys.executable, "-m", "crazyflie_gym"]
    attacks = {
        "floods": lambda: measure_floods(program),
        "logs": lambda: measure_parked("500 unread logs", program, fly_long_world, read_nothing, READERS, 6),
        "unfinished": lambda: measure_parked("510 unfinished", program, nothing, begin_message, UNFINISHED, 10),
        "echoes": lambda: measure_parked("510 unread echoes", program, nothing, request_echo, UNFINISHED, 10),
        "attempts": lambda: measure_attempts(program),
        "guesses": lambda: measure_guesses(program),
    }
    for name in arguments.only.split(","):
        attacks[name]()


if __name__ == "__main__":
    main()
