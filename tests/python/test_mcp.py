"""The tools for language models, by the stock client of the Model Context Protocol over pipes and over HTTP."""

import asyncio
import json
import os
import socket
import subprocess
import sys
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from common import LIMIT_S, wait

mcp = pytest.importorskip("mcp", reason="mcp is not installed")
stdio_client = pytest.importorskip("mcp.client.stdio").stdio_client
streamable_http_client = pytest.importorskip("mcp.client.streamable_http").streamable_http_client

SERVER = ["-m", "crazyflie_gym.mcp"]


@asynccontextmanager
async def over_pipes(folder, *more):
    """A session with a server that the client starts."""
    server = mcp.StdioServerParameters(command=sys.executable, args=[*SERVER, "--folder", str(folder), *more])
    async with stdio_client(server) as (read, write), mcp.ClientSession(read, write) as session:
        await session.initialize()
        yield session


async def answer(session, tool, **arguments):
    """What a tool answers, or what it says is wrong."""
    result = await session.call_tool(tool, arguments)
    text = result.content[0].text
    return text if result.isError else result.structuredContent or json.loads(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with two flights of a vehicle that has drag."""
    folder = tmp_path_factory.mktemp("tools") / "flights"
    folder.mkdir()
    for seed in (1, 2):
        task = ["--task", "track", "--sensors", "lab", "--effects", "drag_linear=0.5", "--seed", str(seed)]
        command = [sys.executable, "-m", "crazyflie_gym", "fly", *task, "--csv", str(folder / f"{seed}.csv")]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=LIMIT_S)
    return folder


def test_flights_are_flown_inspected_identified_and_explained(folder):
    async def talk():
        async with over_pipes(folder, "--seconds", str(LIMIT_S)) as session:
            listed = (await session.list_tools()).tools
            assert sorted(tool.name for tool in listed) == ["explain", "fly", "identify", "inspect"]
            assert all(tool.description and tool.inputSchema["type"] == "object" for tool in listed)
            flown = await answer(session, "fly", task="fly-80cm", runs=2, csv="flown.csv")
            assert len(flown["runs"]) == 2 and flown["runs"][0]["crash"] is None
            inspected = await answer(session, "inspect", logs=["flown.csv"])
            assert "project" in json.dumps(inspected)
            identified = await answer(session, "identify", fit=["1.csv"], test=["2.csv"], out="found.toml")
            assert "roll.gain" in json.dumps(identified) and (folder / "found.toml").is_file()
            explained = await answer(session, "explain", fit=["1.csv"], test=["2.csv"], out="page")
            assert "drag_linear" in json.dumps(explained) and (folder / "page" / "report.html").is_file()

    asyncio.run(talk())


@pytest.mark.parametrize(
    ("tool", "arguments", "words"),
    [
        ("inspect", {"logs": ["../secret.csv"]}, "outside the folder"),
        ("inspect", {"logs": ["1.csv+/etc/passwd"]}, "outside the folder"),
        ("inspect", {"logs": ["link.csv"]}, "outside the folder"),
        ("inspect", {"logs": ["none.csv"]}, "there is no file 'none.csv' in the folder; there are 1.csv"),
        ("inspect", {"logs": ["large.csv"]}, "expected at most 64"),
        ("fly", {"csv": "/tmp/out.csv"}, "outside the folder"),
        ("fly", {"controller": "python:mine.py:Mine"}, "without Python"),
        ("fly", {"controller": "pid:../gains.toml"}, "outside the folder"),
        ("fly", {"vehicle": "--help"}, "expected a registered name"),
        ("fly", {"vehicle": "cf22"}, "did you mean"),
        ("fly", {"runs": 0}, "runs"),
        ("explain", {"fit": ["1.csv"], "test": ["2.csv"], "out": "..", "vehicle": "cf2-thesis"}, "outside the folder"),
        ("explain", {"fit": ["1.csv"], "test": ["2.csv"], "out": "x", "vehicle": "case.json"}, "ends in .toml"),
        ("explain", {"fit": ["1.csv"]}, "Field required"),
    ],
)
def test_what_is_wrong_or_elsewhere_is_refused_in_words(folder, tool, arguments, words):
    (folder.parent / "secret.csv").write_text("t,x\n")
    if not (folder / "link.csv").exists():
        (folder / "link.csv").symlink_to(folder.parent / "secret.csv")
        with (folder / "large.csv").open("wb") as large:
            large.truncate((64 << 20) + 1)

    async def talk():
        async with over_pipes(folder) as session:
            told = await answer(session, tool, **arguments)
            assert isinstance(told, str) and words in told, told
            # the session lives
            assert (await answer(session, "fly"))["runs"]

    asyncio.run(talk())


def running(folder):
    """Commands of the tools that run in a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if os.readlink(process / "cwd") == str(folder) and b"setrlimit" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except OSError:
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="there is no /proc")
def test_a_tool_ends_when_its_time_is_over_or_its_client_is_gone(tmp_path):
    folder = tmp_path.resolve()

    async def over():
        async with over_pipes(folder, "--seconds", "0.2") as session:
            told = await answer(session, "fly", task="swap", runs=100_000)
            assert "takes longer than 0.2 s" in told and running(folder) == []

    async def gone():
        async with over_pipes(folder, "--seconds", str(LIMIT_S)) as session:
            asking = asyncio.create_task(answer(session, "fly", task="swap", runs=100_000))
            while not running(folder):
                await asyncio.sleep(0.05)
            asking.cancel()

    asyncio.run(over())
    asyncio.run(gone())
    wait(lambda: running(folder) == [], "the command goes on without its client")


def test_over_http(folder):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([sys.executable, *SERVER, "--folder", str(folder), "--port", str(port)])

    def listens():
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    async def talk():
        async with (
            streamable_http_client(f"http://127.0.0.1:{port}/mcp") as (read, write, _),
            mcp.ClientSession(read, write) as session,
        ):
            await session.initialize()
            assert "findings" in json.dumps(await answer(session, "inspect", logs=["1.csv"]))

    try:
        wait(listens, "the server does not listen")
        asyncio.run(talk())
    finally:
        process.terminate()
        process.wait(LIMIT_S)
