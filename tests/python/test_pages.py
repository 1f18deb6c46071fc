"""The code of the README and of every page runs, as a reader would run it.

Blocks of a page run in their order: Python in one namespace, shell with `crazyflie` on the path, in an empty folder.
A block that cannot run here says so in its title, which the site shows, and is counted.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import crazyflie_gym
from common import LIMIT_S

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r'^```(\w*)(?: title="(.*?)")?\n(.*?)^```', re.MULTILINE | re.DOTALL)
CODE = {"python", "sh"}
# blocks that are shown and not run; another test parses the mapping of logs.md and plays the exchange of protocol.md
SHOWN = {"", "text", "toml", "json", "exchange"}
# pages whose code another test runs, and looks at what comes of it
ELSEWHERE = {"docs/jax.md": "test_jax_examples.py", "docs/rewards.md": "test_own_judgement.py"}
# written from the code, where it is tested
GENERATED = {str(path.relative_to(ROOT)) for path in ROOT.glob("docs/reference/command_line/*.md")}
# the extras that a page needs beyond the package
NEEDS = {
    "docs/cflib.md": "cflib",
    "docs/deploy.md": "cflib",
    "docs/swarm.md": "pettingzoo",
    "docs/training.md": "stable_baselines3",
}
NOT_RUN = {
    "docs/cflib.md": 3,
    "docs/deploy.md": 2,
    "docs/explain.md": 2,
    "docs/identification.md": 1,
    "docs/server.md": 1,
    "docs/simulators.md": 1,
    "docs/swarm.md": 1,
    "docs/training.md": 1,
    "docs/tutorials/first_flight.md": 1,
    "docs/tutorials/your_vehicle.md": 1,
}
# pages of docs, lines of one of them, words of all (a bar of a table is none)
MOST_PAGES = 30
MOST_LINES = 400
MOST_WORDS = 45_000
PAGES = ["README.md", *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/**/*.md"))]


def blocks(page):
    """The blocks of a page: language, title, text."""
    return BLOCK.findall((ROOT / page).read_text())


def run(command, folder, env=None):
    """A program that has ended, with what it said."""
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False, timeout=LIMIT_S)


def code(page):
    """The blocks that run here."""
    return [(kind, text) for kind, title, text in blocks(page) if kind in CODE and not title.startswith("not run: ")]


@pytest.mark.parametrize("page", [page for page in PAGES if page not in GENERATED])
def test_every_block_has_a_language_that_is_known(page):
    text = (ROOT / page).read_text()
    assert len(re.findall(r"^```", text, re.MULTILINE)) == 2 * len(blocks(page)), "a fence that is not understood"
    for kind, title, block in blocks(page):
        assert kind in CODE | SHOWN, (page, kind)
        assert kind or page == "README.md", f"{page}: a block without a language:\n{block}"
        assert not title or (kind in CODE and title.startswith("not run: ")), (page, title)


def test_what_does_not_run_is_counted():
    found = {page: sum(title.startswith("not run: ") for _, title, _ in blocks(page)) for page in PAGES}
    assert {page: count for page, count in found.items() if count} == NOT_RUN
    for page, test in ELSEWHERE.items():
        assert page in (Path(__file__).parent / test).read_text()


RUN = [page for page in PAGES if code(page) and page not in ELSEWHERE | dict.fromkeys(GENERATED)]


@pytest.mark.parametrize("page", RUN)
def test_the_code_of_a_page_runs(page, tmp_path):
    pytest.importorskip(NEEDS.get(page, "numpy"))
    # a program of its own, so that pages do not see each other, and at the end nothing is left running
    program = tmp_path / "page.py"
    program.write_text(_program(page))
    (tmp_path / "here").mkdir()
    env = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "REPOSITORY": str(ROOT),
        "MPLBACKEND": "agg",
    }
    began = time.monotonic()
    said = tmp_path / "said.txt"
    with said.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, program],
            cwd=tmp_path / "here",
            env=env,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            status = process.wait(timeout=2 * LIMIT_S)
        finally:
            # processes that a page has started and not stopped
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert status == 0, f"{page}\n{said.read_text()[-6000:]}"
    print(f"{page}: {time.monotonic() - began:.1f} s")


def _program(page):
    """The page's blocks as one program: each says which it is where it fails."""
    lines = ["import subprocess as _subprocess"]
    for number, (kind, text) in enumerate(code(page)):
        name = f"{page}, block {number + 1}"
        if kind == "python":
            lines.append(f"exec(compile({text!r}, {name!r}, 'exec'), globals())")
        else:
            lines.append(f"print({name!r}, flush=True)")
            lines.append(
                f"_subprocess.run(['bash', '-euo', 'pipefail', '-c', {text!r}], check=True, timeout={LIMIT_S})"
            )
    return "\n".join(lines)


def test_the_pages_run_something():
    assert len(RUN) >= 12
    assert sum(len(code(page)) for page in RUN) >= 35


def test_pages_are_few_and_short():
    assert len(PAGES) - 1 <= MOST_PAGES
    lengths = {page: len((ROOT / page).read_text().splitlines()) for page in PAGES}
    assert {page: lines for page, lines in lengths.items() if lines > MOST_LINES} == {}
    words = [word for page in PAGES[1:] for word in (ROOT / page).read_text().split() if re.search(r"\w", word)]
    assert len(words) <= MOST_WORDS


def test_the_readme_is_one_page_and_names_the_two_commands():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 120
    assert "make demo" in text and "make test" in text
    film = ROOT / "docs/pictures/swap.webp"
    assert str(film.relative_to(ROOT)) in text and film.stat().st_size < 3_000_000


def test_the_package_and_the_readme_are_strictly_typed(tmp_path):
    pytest.importorskip("mypy")
    assert (Path(crazyflie_gym.__file__).parent / "py.typed").exists()
    text = "\n".join(text for kind, text in code("README.md") if kind == "python")
    (tmp_path / "readme.py").write_text(text)
    # one call reads the imported packages once
    names = ["-p", "crazyflie_cli", "-p", "crazyflie_gym", "-m", "readme"]
    done = run([sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), *names], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_pyright_accepts_the_readme(tmp_path):
    pytest.importorskip("basedpyright")
    text = "\n".join(text for kind, text in code("README.md") if kind == "python")
    (tmp_path / "readme.py").write_text(text)
    # Gymnasium's own types are incomplete, which "strict" would say here
    (tmp_path / "pyrightconfig.json").write_text('{"typeCheckingMode": "standard"}')
    checker = Path(sys.executable).parent / "basedpyright"
    done = run([checker, "--pythonpath", sys.executable], tmp_path)
    assert done.returncode == 0 and "0 errors" in done.stdout, done.stdout + done.stderr


def test_names_of_tasks_and_scenarios_are_those_of_the_code():
    page = (ROOT / "docs/server.md").read_text()
    table = page.split("| manoeuvre |")[1].split("\n\n")[0]
    named = set(re.findall(r"`([\w-]+)`", table))
    tasks = {task["name"]: task["id"] for task in crazyflie_gym.tasks()}
    scenarios = {path.stem for path in (ROOT / "bench/scenarios").glob("*.toml")}
    assert scenarios <= named, scenarios - named
    assert {name for name in tasks if name not in ("race", "cover", "own")} <= named
    flights = {"hover-70cm", "fly-80cm", "height-step", "takeoff-70cm", "whole-flight"}
    known = set(tasks) | set(tasks.values()) | scenarios | flights | {"start_m", "steps"}
    assert named <= known, named - known
