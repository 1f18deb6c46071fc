"""The simulated Crazyflie under load: share of a core, and time from a request to its answer while flying.

    python python_client/bench_cflib.py                     # eight drones with logs at 100 Hz
    python python_client/bench_cflib.py --program target/release/crazyflie

The client is a bare socket for each drone: cflib's own threads would be measured with it. Linux, for the CPU time.
"""

import argparse
import json
import os
import platform
import socket
import statistics
import struct
import subprocess
import sys
import time
from pathlib import Path

REQUESTS = 2000
# port and channel of the link's echo, of the reading of a parameter, and of log data
ECHO, READ, DATA = 0xFC, 0x2D, 0x5E


class Drone:
    """A connected drone that logs and hovers."""

    def __init__(self, uri, index):
        host, port = uri.removeprefix("udp://").split(":")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, int(port)))
        self.socket.settimeout(2)
        self.ask(0x5D, b"\x05")
        for block in range(2):
            # six floats of the head of the table each
            variables = b"".join(struct.pack("<BH", 7, 6 * block + i) for i in range(6))
            assert self.ask(0x5D, bytes([6, block]) + variables)[3] == 0
            assert self.ask(0x5D, bytes([3, block, 1]))[3] == 0
        self.socket.send(b"\x8c" + struct.pack("<BBff?f", 7, 0, 0.5 + 0.1 * index, 0, False, 2))

    def ask(self, header, data):
        """The answer to a request; logs that come in between are dropped."""
        self.socket.send(bytes([header]) + data)
        while True:
            answer = self.socket.recv(64)
            if answer[0] == header and answer[1 : 1 + min(len(data), 2)] == data[:2]:
                return answer

    def drain(self):
        """Log packets that have arrived."""
        count = 0
        self.socket.setblocking(False)
        try:
            while True:
                count += self.socket.recv(64)[0] == DATA
        except BlockingIOError:
            self.socket.settimeout(2)
            return count


def cpu_s(pid):
    """CPU time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def processor():
    """Name of the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores"


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", default=str(Path(sys.executable).with_name("crazyflie")))
    parser.add_argument("--drones", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=10)
    args = parser.parse_args()
    command = [args.program, "cf2", "--json", "--port", "0", "--drones", str(args.drones)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        uris = [drone["udp"] for drone in json.loads(process.stdout.readline())["drones"]]
        drones = [Drone(uri, index) for index, uri in enumerate(uris)]
        time.sleep(3)
        for drone in drones:
            drone.drain()
        packets, before, start = 0, cpu_s(process.pid), time.monotonic()
        while time.monotonic() - start < args.seconds:
            for drone in drones:
                drone.socket.send(bytes([ECHO]) + b"ping")
                packets += drone.drain()
            time.sleep(0.1)
        seconds = time.monotonic() - start
        share = (cpu_s(process.pid) - before) / seconds
        times = []
        for i in range(REQUESTS):
            drone = drones[i % len(drones)]
            drone.drain()
            begun = time.perf_counter()
            drone.ask(READ, struct.pack("<H", i % 80))
            times.append(1e3 * (time.perf_counter() - begun))
            if i % 4 == 0:
                for other in drones:
                    other.socket.send(bytes([ECHO]) + b"ping")
                time.sleep(0.003)
        heights = [drone.ask(0x5D, b"\x04\x00") for drone in drones]
        assert len(heights) == len(drones)
        process.terminate()
    cuts = statistics.quantiles(times, n=100)
    print(f"{processor()}, {args.program}")
    print(f"{args.drones} drones, {packets / seconds:.0f} log packets/s: {100 * share:.1f} % of a core")
    print(f"request to answer: median {cuts[49]:.3f} ms, p99 {cuts[98]:.3f} ms, most {max(times):.3f} ms")


if __name__ == "__main__":
    main()
