"""Writes the pages of the site that come from the code: `make docs`. A test compares them.

python docs/tools/generate.py
"""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import crazyflie_gym
from formulas import GROUPS

DOCS = Path(__file__).resolve().parents[1]
sys.path.append(str(DOCS.parent / "examples/thesis"))

import scorecard  # noqa: E402
from tables import MARK, filled  # noqa: E402

PROGRAM = Path(sys.executable).parent / "crazyflie"
# asked for with the same help under another name
ASIDE = {"help"}
# a page of commands takes so many lines; a command of more than half of them is alone on one
PAGE_LINES = 380
LONG_LINES = PAGE_LINES // 2


def command_line():
    """Return the pages of the program's help: its groups of commands, as many as a page takes; a long one is alone."""
    pages, alone = [], []
    for title, names in _groups():
        trees = {name: _commands([name]) for name in names}
        alone += [(name, tree) for name, tree in trees.items() if _lines(tree) > LONG_LINES]
        commands = [command for tree in trees.values() if _lines(tree) <= LONG_LINES for command in tree]
        if pages and _lines(pages[-1][1] + commands) <= PAGE_LINES:
            pages[-1] = (f"{pages[-1][0]}, {title}", pages[-1][1] + commands)
        else:
            pages.append((title, commands))
    return {
        f"reference/command_line/{title.split()[0]}.md": lambda title=title, commands=commands: _page(title, commands)
        for title, commands in pages + alone
    }


def _page(title, commands):
    """Return the page of commands: every command, every option."""
    lines = [
        f"# Command line: {title}",
        "",
        "Written by `make docs`. `crazyflie COMMAND --help` prints the same.",
        "",
        "| command | |",
        "|---|---|",
        *(f"| [`{' '.join(words)}`](#{'-'.join(words)}) | {about} |" for words, about, _ in commands),
    ]
    for words, _, text in commands:
        lines += ["", f"## `{' '.join(words)}` {{ #{'-'.join(words)} }}", "", "```text", text, "```"]
    return "\n".join(lines) + "\n"


def _lines(commands):
    """Return the number of lines that commands take on a page."""
    return sum(len(text.splitlines()) + 7 for _, _, text in commands)


def _groups():
    """Return title and commands of the groups in the program's help."""
    return [(title, names.split(", ")) for title, names in _listed([], r"^(.*?)\s{2,}(.*)$")]


def _commands(words):
    """Return (words, about, help) of a command and its subcommands."""
    text = _help(words)
    about = re.split(r"[.:;](?: |$)", text.partition("\n\n")[0].replace("\n", " "))[0].replace("|", "\\|")
    below = [name for (name,) in _listed(words, r"^(\S+)") if name not in ASIDE]
    return [(["crazyflie", *words], about, text), *(command for name in below for command in _commands([*words, name]))]


def _listed(words, pattern):
    """Return the parts of the lines under "Commands" in a help."""
    listed = re.search(r"^Commands:\n((?:  .*\n)+)", _help(words), re.MULTILINE)
    return [re.match(pattern, line.strip()).groups() for line in (listed[1].splitlines() if listed else [])]


def _help(words):
    # a page scrolls: no line is wrapped
    wide = {**os.environ, "COLUMNS": "1000"}
    done = subprocess.run([PROGRAM, *words, "--help"], capture_output=True, text=True, check=True, env=wide)
    return "\n".join(line.rstrip() for line in done.stdout.strip().splitlines())


def model():
    """Return the page of the model with the formula of every effect and, at its end, every key of a model file."""
    known = {effect["name"]: effect for effect in crazyflie_gym.effects()}
    # an effect without a formula is described in words
    others = set(known) - {name for group in GROUPS.values() for name in group}
    words = {name: rf"\text{{{known[name]['about']}}}" for name in sorted(others)}
    lines = ["| effect | formula |", "|---|---|"]
    for formulas in [*GROUPS.values(), words]:
        lines += [f"| `{name}` | ${formula.replace('|', chr(92) + 'vert ')}$ |" for name, formula in formulas.items()]
    page = filled(DOCS / "concepts/model.md", "\n".join(lines))
    return page[: page.rindex(MARK)] + f"{MARK}\n\n{_model_file()}"


def _model_file():
    """Return the section about model files: every key of the schema, and the built-in file."""
    schema = json.loads((DOCS / "model.schema.json").read_text())
    lines = [
        "## Model files",
        "",
        "A model file is TOML or JSON. A number is a table of `value`, `unit` and `source`; the unit must be the one below. `crazyflie model FILE` checks a file.",
        "Its schema is [model.schema.json](../model.schema.json).",
        "[The built-in file](../../env/models/cf2-thesis.toml) is an example with every source.",
        "",
        "| key | unit or type | required | about |",
        "|---|---|---|---|",
        *dict.fromkeys(_keys(schema, "")),
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


def gallery():
    """Return the page of the examples: the first line of each, and its picture."""
    lines = [
        "# Examples",
        "",
        "`make docs` writes this page from the first lines of the files, with the pictures that they draw.",
        "An example runs from any folder: `python examples/1_fly.py`. Some fly on a server and take its address.",
        "`tasks/`, `thesis/` and `simulators/` have task files, the experiments of the thesis and the comparison with others.",
        "",
        "| | |",
        "|---|---|",
    ]
    programs = (DOCS.parent / "examples").glob("*.py")
    for path in sorted(programs, key=lambda path: (not pictures_of(path), path.name)):
        first = ast.get_docstring(ast.parse(path.read_text())).partition("\n")[0]
        # without the name of its picture, or how to call it
        about = re.split(r": (?=python |\w+\.(?:png|svg))|\.$", first)[0].replace("|", "\\|")
        pictures = [f"[![{path.stem}](../docs/pictures/{name})]({path.name})" for name in pictures_of(path)]
        lines.append(f"| {' '.join(pictures)} | [`{path.name}`]({path.name}): {about} |")
    return "\n".join(lines) + "\n"


def picture_of(example):
    """Return the name of the picture that an example writes, or None."""
    named = re.search(rf"{example.stem}\.(?:png|svg)", example.read_text())
    return named and named[0]


def pictures_of(example):
    """Return the copies of an example's picture, below docs/pictures."""
    pictures = DOCS / "pictures"
    return [str(path.relative_to(pictures)) for path in sorted(pictures.glob(f"examples/{example.stem}.*"))]


PAGES = {
    "../examples/README.md": gallery,
    **command_line(),
    "concepts/model.md": model,
    "thesis.md": thesis,
}


def main():
    """Write all pages."""
    for name, page in PAGES.items():
        (DOCS / name).write_text(page())
        print(f"docs/{name}")


if __name__ == "__main__":
    main()
