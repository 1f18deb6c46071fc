"""Tools for language models, by the Model Context Protocol: `fly`, `inspect`, `identify` and `explain`.

::

    python -m crazyflie_gym.mcp --folder flights            # a client starts it and talks over its pipes
    python -m crazyflie_gym.mcp --folder flights --port 8766    # or over HTTP, on this machine: /mcp

The tools are commands of `crazyflie` with `--json`. They read and write files below the folder only, run no Python
code, and take turns. Each has limits on its time, its memory, and the bytes that it reads, writes and answers.
`pip install "crazyflie-gym[mcp]"` brings what it needs.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import re
import signal
import sys
from pathlib import Path
from typing import Any

try:
    from mcp.server.fastmcp import FastMCP
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(f'{error}; pip install "crazyflie-gym[mcp]" brings it', name=error.name) from None

__all__ = ["Commands", "tools"]

MIB = 1 << 20
MOST_READ = 64 * MIB
MOST_WRITTEN = 64 * MIB
MOST_ANSWERED = MIB
MOST_MEMORY = 4096 * MIB
INSTRUCTIONS = (
    "Simulates and identifies the quadrotor Crazyflie. File names are relative to one folder. "
    "Numbers are in SI units unless their names say otherwise."
)


class Commands:
    """Commands of `crazyflie` within a folder, one at a time, each for so many seconds at most."""

    def __init__(self, folder: Path, seconds: float) -> None:
        self.folder = folder.resolve(strict=True)
        self.seconds = seconds
        self.turn = asyncio.Semaphore(1)

    def path(self, name: str) -> str:
        """Return the path of a file, which need not exist, below the folder."""
        path = (self.folder / name).resolve()
        if not path.is_relative_to(self.folder):
            raise ValueError(f"{name!r} is outside the folder of the tools")
        return str(path)

    def logs(self, names: list[str]) -> list[str]:
        """Return the paths of logs; the files of one flight have a plus between them."""
        parts = [[Path(self.path(part)) for part in name.split("+")] for name in names]
        every = [path for paths in parts for path in paths]
        if missing := [path.name for path in every if not path.is_file()]:
            raise ValueError(f"there is no file {missing[0]!r} in the folder; there are {self.files()}")
        if (size := sum(path.stat().st_size for path in every)) > MOST_READ:
            raise ValueError(f"the logs have {size / MIB:.1f} MiB, expected at most {MOST_READ // MIB}")
        return ["+".join(map(str, paths)) for paths in parts]

    def files(self) -> str:
        """Return the names of some files of the folder, for messages."""
        names = sorted(path.name for path in self.folder.iterdir() if path.is_file())
        return ", ".join(names[:20]) or "none"

    def choice(self, name: str) -> str:
        """Return a registered name as it is, the path of a file of TOML, or NAME:FILE with the path; no Python."""
        kind, colon, file = name.partition(":")
        if not re.fullmatch(r"\w[\w.+/-]*", kind) or kind == "python":
            raise ValueError(f"{name!r}: expected a registered name, or a file of the folder without Python code")
        if kind.endswith(".toml"):
            return self.path(name)
        if "/" in kind or kind.endswith(".json"):
            raise ValueError(f"{name!r}: expected a registered name, or a file that ends in .toml")
        return f"{kind}:{self.path(file)}" if colon else kind

    async def run(self, *arguments: str) -> dict[str, Any]:
        """Return what a command answers in JSON; it ends with whoever waits for it."""
        command = [sys.executable, "-c", LIMITED, *arguments, "--json"]
        async with self.turn:
            pipe, nothing = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
            process = await asyncio.create_subprocess_exec(
                *command, stdin=nothing, stdout=pipe, stderr=pipe, cwd=self.folder
            )
            try:
                reading = asyncio.gather(read(process.stdout), read(process.stderr), process.wait())
                out, err, status = await asyncio.wait_for(reading, self.seconds)
            except asyncio.TimeoutError:
                raise ValueError(f"{arguments[0]} takes longer than {self.seconds:g} s: give it less to do") from None
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
        if status != 0:
            raise ValueError((err or out)[-4000:].decode(errors="replace") or f"{arguments[0]} ended with {status}")
        answer: dict[str, Any] = json.loads(out)
        return {**answer, "said": err.decode(errors="replace").splitlines()} if err else answer


LIMITED = f"""
import sys
if sys.platform != "win32":
    import resource
    resource.setrlimit(resource.RLIMIT_AS, ({MOST_MEMORY},) * 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, ({MOST_WRITTEN},) * 2)
from crazyflie_cli import main
sys.exit(main())
"""


async def read(stream: asyncio.StreamReader | None) -> bytes:
    """Read a pipe to its end, unless it says too much."""
    text = b""
    while stream is not None and (more := await stream.read(MIB)):
        text += more
        if len(text) > MOST_ANSWERED:
            raise ValueError(f"the answer has more than {MOST_ANSWERED // MIB} MiB: request less")
    return text


def option(name: str, value: object) -> list[str]:
    """Return an option of the command line, or nothing where there is no value."""
    return [] if value is None else [f"--{name}={value}"]


def tools(folder: Path, seconds: float = 120.0, port: int = 8766) -> FastMCP:
    """Make a server of the tools for the files below a folder."""
    commands = Commands(folder, seconds)
    server = FastMCP("crazyflie", instructions=INSTRUCTIONS, port=port)

    @server.tool()
    async def fly(
        task: str = "hover",
        vehicle: str = "cf2-thesis",
        controller: str = "thesis-pid",
        effects: dict[str, Any] | None = None,
        sensors: str = "ideal",
        seed: int = 0,
        runs: int = 1,
        csv: str | None = None,
    ) -> dict[str, Any]:
        """Simulate flights of a task. Returns the figures of each run; csv names a file for the log of the first."""
        choices = {"task": task, "vehicle": vehicle, "controller": controller, "sensors": sensors}
        chosen = [argument for name, value in choices.items() for argument in option(name, commands.choice(value))]
        numbers = [*option("seed", seed), *option("runs", runs)]
        given = option("effects", effects and json.dumps(effects))
        return await commands.run("fly", *chosen, *numbers, *given, *option("csv", csv and commands.path(csv)))

    @server.tool()
    async def inspect(logs: list[str]) -> dict[str, Any]:
        """Report the content of flight logs: channels, gaps, clocks, signs, findings, usable commands."""
        return await commands.run("inspect", *commands.logs(logs))

    @server.tool()
    async def identify(
        fit: list[str],
        test: list[str] | None = None,
        vehicle: str = "cf2-thesis",
        mass_kg: float | None = None,
        out: str | None = None,
    ) -> dict[str, Any]:
        """Fit the numbers of a model to logs and judge it by others; out names a .toml file for the model."""
        judged = ["--test", *commands.logs(test)] if test else []
        more = [*option("mass", mass_kg), *option("out", out and commands.path(out))]
        return await commands.run("identify", commands.choice(vehicle), *more, "--fit", *commands.logs(fit), *judged)

    @server.tool()
    async def explain(fit: list[str], test: list[str], out: str, vehicle: str = "cf2-thesis") -> dict[str, Any]:
        """Find the effects that a model lacks in logs. Writes model.toml, report.html and report.json to a folder."""
        judged = ["--test", *commands.logs(test)]
        target = option("out", commands.path(out))
        return await commands.run("explain", commands.choice(vehicle), *target, "--fit", *commands.logs(fit), *judged)

    return server


def main() -> None:
    """Serve the tools over the pipes of this process, or over HTTP."""
    parser = argparse.ArgumentParser(prog="python -m crazyflie_gym.mcp", description="Tools for language models")
    parser.add_argument("--folder", type=Path, default=Path(), help="the tools see files below it only [default: here]")
    parser.add_argument("--seconds", type=float, default=120.0, help="longest time of a tool [default: 120]")
    parser.add_argument("--port", type=int, help="serve HTTP at 127.0.0.1 with this port [default: the pipes]")
    arguments = parser.parse_args()
    # a client closes the pipes, and whoever started it interrupts: neither is an error
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    server = tools(arguments.folder, arguments.seconds, arguments.port or 8766)
    server.run("stdio" if arguments.port is None else "streamable-http")


if __name__ == "__main__":
    main()
