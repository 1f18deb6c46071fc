"""Opens many connections to a server over TLS, from several threads, and counts those that fail.

    python tests/tls_connections.py [--connections 2000] [--threads 4]

Python's `websockets` reads in one thread and writes in another. With session tickets from the server, OpenSSL lost
11 of 4000 requests that way: the server waited 5 s for them and hung up. It exits with 1 if one fails.
"""

import argparse
import ssl
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from websockets.sync.client import connect
from websockets.typing import Subprotocol


def serve(folder):
    """Returns the process of a server with a certificate of its own, and its port."""
    key, cert = folder / "key.pem", folder / "cert.pem"
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=lab"
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(cert)]
    subprocess.run([*command.split(), *names], check=True, capture_output=True)
    options = ["--listen", "127.0.0.1:0", "--log", "warn", "--tls-cert", str(cert), "--tls-key", str(key)]
    command = [sys.executable, "-m", "crazyflie_gym", "serve", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    return process, int(process.stdout.readline().rsplit(":", 1)[1])


def find_problem(url, trust):
    """Returns why a connection failed, or None if the server answered over it."""
    try:
        with connect(url, ssl=trust, subprotocols=[Subprotocol("crazyflie.v1")], proxy=None) as ws:
            ws.send('{"id": 1, "type": "hello"}')
            ws.recv(timeout=10)
    except Exception as error:  # all of them count
        return repr(error)
    return None


def main():
    """Counts the failures and prints each kind once."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connections", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=4)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        process, port = serve(Path(folder))
        try:
            trust = ssl.create_default_context(cafile=Path(folder) / "cert.pem")
            with ThreadPoolExecutor(args.threads) as pool:
                ask = [pool.submit(find_problem, f"wss://127.0.0.1:{port}/ws", trust) for _ in range(args.connections)]
            problems = [problem for problem in (answer.result() for answer in ask) if problem]
        finally:
            process.terminate()
            process.wait(timeout=15)
    print(f"{len(problems)} of {args.connections} connections failed", *sorted(set(problems)), sep="\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
