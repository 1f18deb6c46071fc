"""The prose of pages and comments stays within the limits of tests/prose.py."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(*arguments):
    """The check, ended."""
    command = [sys.executable, ROOT / "tests/prose.py", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def test_the_prose_is_within_its_limits():
    done = run()
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("sentence", "status"),
    [
        ("The vehicle hovers. What is heavy falls.", 1),
        ("- Where a frame is lost, the last one is repeated.", 1),
        ("**Of these** flights, three are long.", 1),
        ("It says what a rope tells.", 1),
        ("The heavy vehicle falls, whatever hovers. What is heavy?", 0),
        ("# What a heading is\n\n| What a cell is |\n\n```python\nWhat = 1\n```\n\nThe rest is [fine](x.md).", 0),
    ],
)
def test_a_planted_sentence_is_found(tmp_path, sentence, status):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/page.md").write_text(f"# Page\n\n{sentence}\n")
    done = run(tmp_path)
    assert done.returncode == status, done.stdout
    assert ("docs/page.md" in done.stdout) == (status == 1 and "rope" not in sentence)


def test_comments_and_docstrings_are_read(tmp_path):
    python, rust = tmp_path / "python_client/python/a.py", tmp_path / "env/src/a.rs"
    for path in (python, rust):
        path.parent.mkdir(parents=True)
    python.write_text('def f():\n    """Return it.\n\n    Whether it flies is open.\n    """\n')
    rust.write_text("//! Of a crate.\n/// How fast\n/// it flies. It says so.\nfn f() {}\n")
    done = run(tmp_path, "--list")
    assert "docstrings: 1 sentences" in done.stdout and "\ncomments: 2 sentences" in done.stdout, done.stdout
    assert "a.rs: How fast it flies." in done.stdout
    # a verb in a few words is far beyond any rate
    assert done.returncode == 1


@pytest.mark.parametrize(
    ("file", "text", "kind"),
    [
        ("env/src/a.rs", "fn f() {\n    // what is plain\n    // counts\n}\n", "plain comments"),
        ("env/src/a.rs", '#[error("what flies is {name}")]\nstruct E;\n', "errors"),
        ("env/src/a.rs", 'fn f() { Err(format!("whoever flies {name}")) }\n', "errors"),
        ("python_client/python/a.py", 'raise ValueError(f"of {this} nothing is known")\n', "errors"),
        ("python_client/python/a.py", 'A = 1\n"""What it is."""\n', "docstrings"),
        ("tests/a.sh", "# as a shell does\n", "plain comments"),
        ("server/page/js/a.js", "/** Where it is. */\n", "plain comments"),
        ("server/page/js/a.js", 'show("What went wrong");\n', "page"),
        ("server/page/index.html", '<button title="Where it is">x</button>\n', "page"),
    ],
)
def test_a_planted_sentence_of_code_is_found(tmp_path, file, text, kind):
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(text)
    done = run(tmp_path, "--list")
    assert f"\n{kind}: 1 sentences" in done.stdout and done.returncode == 1, done.stdout
