"""Adds one of each thing that CONTRIBUTING.md tells how to add to a copy of the project, and finds it again.

    python tests/add_one_of_each.py

An effect, a task, a controller, a log format, a scenario and a request, each a copy of one that is there under another
name.
It counts the files touched, then asks the command line, the generated docs, a flight, and the test that holds the
requests against their page. Building takes minutes, so this is a command of its own: make doors.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
EFFECTS, TASKS = "env/src/effects", "env/src/task"
CONTROLLERS, FORMATS, SERVE = "control/src", "logs/src/formats", "server/src/serve"
SCENARIOS = "bench/scenarios"
LOG = "fuzz/corpus/flight_log/firmware_csv/cfclient.csv"


def insert(path, before, line):
    """A line above the first that begins with `before`."""
    text = path.read_text()
    assert before in text, f"{path} lacks {before!r}"
    path.write_text(text.replace(before, line + before, 1))


def copy(folder, source, name, *changes):
    """Writes a copy of a source file under another name, with these replacements."""
    text = (folder / source).read_text()
    for old, new in changes:
        assert old in text, f"{source} lacks {old!r}"
        text = text.replace(old, new)
    (folder / f"{name}.rs").write_text(text)


def add_effect(at):
    """One file and a line."""
    folder = at / EFFECTS
    change = ("DragLinear", "AddedDrag"), ('"drag_linear"', '"added_drag"')
    copy(folder, "drag_linear.rs", "added_drag", *change, ('Some("lateral.drag")', "None"))
    insert(folder / "mod.rs", "    drag_linear::DragLinear,", "    added_drag::AddedDrag,\n")


def add_task(at):
    """One file and two lines of the registry."""
    folder = at / TASKS
    copy(folder, "takeoff.rs", "added_task", ("Takeoff", "AddedTask"), ('"takeoff"', '"added-task"'))
    insert(folder / "mod.rs", "mod carry;", "mod added_task;\n")
    insert(folder / "mod.rs", "    takeoff::Takeoff,", "    added_task::AddedTask,\n")


def add_controller(at):
    """One file and two lines of the registry."""
    folder = at / CONTROLLERS
    copy(folder, "hover.rs", "added_controller", ('"hover"', '"added-controller"'))
    insert(folder / "lib.rs", "mod hover;", "mod added_controller;\n")
    insert(folder / "lib.rs", "        &hover::ENTRY,", "        &added_controller::ENTRY,\n")


def add_log_format(at):
    """One file and two lines of the registry."""
    folder = at / FORMATS
    change = ('"firmware_csv"', '"added_csv"'), ("variables (cfclient, cflib)", "an added kind")
    copy(folder, "firmware_csv.rs", "added_csv", *change)
    insert(folder / "mod.rs", "mod firmware_csv;", "mod added_csv;\n")
    insert(folder / "mod.rs", "        &firmware_csv::READER,", "        &added_csv::READER,\n")


def add_request(at):
    """A case, a line of the table, where it is carried out, and a row of the page."""
    folder = at / SERVE
    protocol = at / "server/src/protocol/request.rs"
    insert(protocol, "    State,\n    Close,", "    AddedState,\n")
    insert(
        protocol,
        '    ("close",',
        '    ("added_state", |fields| fields.read::<Empty>().map(|_| Request::AddedState)),\n',
    )
    text = (folder / "connection.rs").read_text()
    (folder / "connection.rs").write_text(
        text.replace("            Request::State =>", "            Request::State | Request::AddedState =>")
    )
    insert(at / "docs/protocol.md", "| `close` | |", "| `added_state` | | as `state` |\n")


def add_scenario(at):
    """One file."""
    folder = at / SCENARIOS
    text = (folder / "wind.toml").read_text()
    (folder / "added-scenario.toml").write_text(text.replace('"wind"', '"added-scenario"', 1))


def touched(at):
    """Returns the files that differ from the last commit."""
    said = subprocess.run(["git", "status", "--short"], cwd=at, capture_output=True, text=True, check=True).stdout
    return sorted(line[3:] for line in said.splitlines())


MOST_FILES = {
    add_effect: 2,
    add_task: 2,
    add_controller: 2,
    add_log_format: 2,
    add_scenario: 1,
    add_request: 2,
}


def main():
    """Adds all of them, builds once, and looks for each."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder) / "copy"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(at)], check=True)
        places = {}
        for add, most in MOST_FILES.items():
            before = set(touched(at))
            add(at)
            code = [path for path in touched(at) if path not in before and not path.startswith("docs/")]
            places[add.__name__] = code
            assert len(code) <= most, f"{add.__name__} touches {code}"
        target = ["--target-dir", str(ROOT / "target/doors")]
        subprocess.run(["cargo", "build", "--quiet", "-p", "crazyflie-cli", *target], cwd=at, check=True)
        program = ROOT / "target/doors/debug/crazyflie"

        def said(*args):
            return subprocess.run([program, *args], capture_output=True, text=True, check=True).stdout

        assert any(effect["name"] == "added_drag" for effect in json.loads(said("effects", "--json")))
        assert "`added_drag`" in said("effects", "--markdown")
        assert "added-task" in said("tasks") and "CrazyflieAddedTask-v0" in said("tasks", "--markdown")
        assert "added-controller" in said("controllers")
        assert "added-controller" in json.dumps(json.loads(said("controllers", "--json")))
        flown = said(
            "fly",
            "--task",
            "added-task",
            "--controller",
            "added-controller",
            "--effects",
            "added_drag=0.3",
            "--seconds",
            "1",
        )
        assert re.search("added-task", flown)
        assert "added-scenario@1.0.0" in said("bench", "scenarios", "--data", str(Path(folder) / "bench.sqlite"))
        assert "an added kind" in said("inspect", str(at / LOG))
        # fails where the table of the page and the requests, which the fuzz tests draw from, are not the same
        test = ["-p", "crazyflie-server", "--lib", "the_page_of_the_protocol"]
        done = subprocess.run(["cargo", "test", *target, *test], cwd=at, capture_output=True, text=True, check=True)
        assert "1 passed" in done.stdout, done.stdout
    for add, code in places.items():
        print(f"{add}: {', '.join(code)}")
    print("each is found")
    return 0


if __name__ == "__main__":
    sys.exit(main())
