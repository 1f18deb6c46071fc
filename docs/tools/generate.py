"""Writes the pages of the site that come from the code: `make docs`. A test compares them.

python docs/tools/generate.py
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import crazyflie_gym
from formulas import GROUPS

DOCS = Path(__file__).resolve().parents[1]
sys.path.append(str(DOCS.parent / "examples/thesis"))

import scorecard  # noqa: E402
from tables import filled  # noqa: E402

PROGRAM = Path(sys.executable).parent / "crazyflie"
# asked for with the same help under another name
ASIDE = {"help"}


def command_line():
    """Return the page of the program's help: every command, every option."""
    commands = _commands([])
    lines = [
        "# Command line",
        "",
        "Written by `make docs` from `crazyflie --help` of every command. `crazyflie COMMAND --help` prints the same.",
        "",
        "| command | |",
        "|---|---|",
        *(f"| [`{' '.join(words)}`](#{'-'.join(words)}) | {about} |" for words, about, _ in commands),
    ]
    for words, _, text in commands:
        lines += ["", f"## `{' '.join(words)}` {{ #{'-'.join(words)} }}", "", "```text", text, "```"]
    return "\n".join(lines) + "\n"


def _commands(words):
    """Return (words, about, help) of a command's subcommands, and of theirs."""
    listed = re.search(r"^Commands:\n((?:  .*\n)+)", _help(words), re.MULTILINE)
    found = []
    for line in listed[1].splitlines() if listed else []:
        name, _, about = line.strip().partition(" ")
        if name not in ASIDE:
            below = [*words, name]
            found += [(["crazyflie", *below], about.strip().replace("|", "\\|"), _help(below)), *_commands(below)]
    return found


def _help(words):
    # the width is that of the help itself, whatever the terminal
    done = subprocess.run([PROGRAM, *words, "--help"], capture_output=True, text=True, check=True)
    return "\n".join(line.rstrip() for line in done.stdout.strip().splitlines())


def effects():
    """Return the page of the effects: formula, range and source of each."""
    known = {effect["name"]: effect for effect in crazyflie_gym.effects()}
    # an effect without a formula is told in words
    others = set(known) - {name for group in GROUPS.values() for name in group}
    told = {name: rf"\text{{{known[name]['about']}}}" for name in sorted(others)}
    groups = GROUPS | ({"Others": told} if told else {})
    lines = [
        "# Effects",
        "",
        "Written by `make docs` from the registry of effects and `docs/tools/formulas.py`.",
        "",
        f"An effect is something that the [linear model](model.md) leaves out. There are {len(known)}, all off unless asked for. Each is",
        "one file in `env/src/effects/`. The formula tells the idea; corner cases and the exact order of operations are in the file.",
        "[The table of effects](../effects.md) says what each parameter means.",
        "",
        "Symbols: *T* thrust per mass (*g* in a hover), **v** velocity, **a** acceleration, θ pitch (likewise for roll φ), ψ yaw, *u* a command, *p* the",
        "position that the camera tells, *z* height, *R* rotor radius, *n* white noise. A star marks the value with the effect, a hat what is measured.",
    ]
    for group, formulas in groups.items():
        lines += ["", f"## {group}", "", "| effect | formula | parameters: range (off) | source |", "|---|---|---|---|"]
        for name, formula in formulas.items():
            params = "<br>".join(
                f"`{p['name']}` {_number(p['low'])} to {_number(p['high'])} ({_number(p['off'])})"
                for p in known[name]["params"]
            )
            bars = formula.replace("|", r"\vert ")
            lines.append(f"| `{name}` | ${bars}$ | {params} | {known[name]['source'].replace('|', chr(92) + '|')} |")
    lines += [
        "",
        "## In what order they act",
        "",
        "Commands are changed first, then forces and torques act on the motion, then the camera takes frames, then the reading is made. Effects of one kind act in",
        "the order of the registry, which is that of [the table](../effects.md): first what changes the thrust, then what turns it, then other forces.",
        "Forces are held over a physics step and evaluated at the state expected at its middle, which makes them exact to second order.",
        "",
        "## Distributions",
        "",
        "Each parameter may be a distribution, from which every episode draws:",
        "",
        "```python",
        "import crazyflie_gym",
        "import gymnasium",
        "",
        'drawn = {"drag_linear": {"uniform": [0.0, 0.5]}, "wind": {"x_mps2": {"normal": [0.0, 0.2]}}}',
        'envs = gymnasium.make_vec("Crazyflie-v0", num_envs=64, effects=drawn)',
        "```",
    ]
    return "\n".join(lines) + "\n"


def _number(value):
    return f"{value:g}"


def model_file():
    """Return the page of model files: every key of the schema, and the built-in file."""
    schema = json.loads((DOCS / "model.schema.json").read_text())
    lines = [
        "# Model files",
        "",
        "Written by `make docs` from the schema, [model.schema.json](../model.schema.json), which `crazyflie model --schema` prints.",
        "",
        "A model file is TOML or JSON. A number is a table of `value`, `unit` and `source`; the unit must be the one below. `crazyflie model FILE` checks a file.",
        "",
        "| key | unit or type | required | about |",
        "|---|---|---|---|",
        *dict.fromkeys(_keys(schema, "")),
        "",
        "## The built-in file",
        "",
        "```toml",
        (DOCS.parent / "env/models/cf2-thesis.toml").read_text().strip(),
        "```",
    ]
    return "\n".join(lines) + "\n"


def _keys(schema, prefix):
    """Return the rows of a schema's keys; alternatives one after the other."""
    rows = []
    for form in schema.get("oneOf", [schema]):
        for name, inner in form.get("properties", {}).items():
            path = f"{prefix}{name}"
            need = "yes" if name in form.get("required", []) else ""
            about = inner.get("description", "")
            unit = inner.get("properties", {}).get("unit", {}).get("const")
            if unit is not None:
                rows.append(f"| `{path}` | {unit} | {need} | {about} |")
            elif "properties" in inner or "oneOf" in inner:
                rows += _keys(inner, f"{path}.")
            else:
                allowed = inner.get("enum", [inner["const"]] if "const" in inner else [])
                kind = ", ".join(f"`{value}`" for value in allowed) or inner.get("type", "any")
                rows.append(f"| `{path}` | {kind} | {need} | {about} |")
    return rows


def thesis():
    """Return the page of the thesis's experiments, with the scorecard as they are flown now."""
    return filled(DOCS / "thesis.md", scorecard.as_markdown(scorecard.scorecard()))


PAGES = {
    "reference/command_line.md": command_line,
    "reference/model_file.md": model_file,
    "concepts/effects.md": effects,
    "thesis.md": thesis,
}


def main():
    """Write all pages."""
    for name, page in PAGES.items():
        (DOCS / name).write_text(page())
        print(f"docs/{name}")


if __name__ == "__main__":
    main()
