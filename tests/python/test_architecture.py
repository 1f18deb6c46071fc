"""The architecture in the code: no large circles, and nothing that must not be known is."""

import re
from pathlib import Path

import pytest

from rust_modules import circles, crate_of, largest, uses

ROOT = Path(__file__).parents[2]
# files of a circle: what can be held in the head at once
MOST = 5

ANY = "every other crate"
# forbidden uses, by the beginnings of paths; ARCHITECTURE.md has the same
MUST_NOT_KNOW = {
    "env": (ANY,),
    "statistics": (ANY,),
    "picture": (ANY,),
    "logs": ("env", "control", "identify", "picture", "server"),
    "control": ("logs", "identify", "picture", "server", "env/src/effects", "env/src/world"),
    "identify": ("picture", "server", "bench", "lab"),
    "jax": ("control", "identify", "server", "env/src/effects"),
    "crtp": ("control", "identify", "logs", "server", "bench"),
    "server": ("bench", "lab", "crtp"),
    "bench": ("lab", "identify", "crtp"),
    "cli": ("python_client", "lab"),
    "lab": ("python_client",),
    "python_client": ("lab", "crtp"),
    "env/src/model": ("env/src/plant", "env/src/effects", "env/src/task", "env/src/config"),
    "env/src/plant": ("env/src/effects", "env/src/action", "env/src/world"),
    "env/src/action": ("env/src/motors", "env/src/effects", "env/src/observation", "env/src/task"),
    "env/src/motors": ("env/src/effects", "env/src/observation", "env/src/task"),
    "env/src/effects": ("env/src/observation", "env/src/task", "env/src/config"),
    "env/src/observation": ("env/src/world", "env/src/task"),
    "env/src/estimator": ("env/src/plant", "env/src/effects", "env/src/world"),
    "env/src/coupling": ("env/src/world", "env/src/task"),
    "env/src/expression": ("env/src/effects", "env/src/world", "env/src/task"),
    "env/src/world": ("env/src/task", "env/src/config", "env/src/vector"),
    "env/src/task": ("env/src/config", "env/src/vector"),
    "env/src/config": ("env/src/world", "env/src/vector"),
    "env/src/episode": ("env/src/vector", "env/src/recording"),
    "control/src/loop_analysis": ("control/src/policy", "control/src/spec"),
    "logs/src/flight": ("logs/src/formats", "logs/src/reader", "logs/src/mapping"),
    "logs/src/formats": ("logs/src/inspect", "logs/src/draft"),
    "logs/src/inspect": ("logs/src/formats", "logs/src/mapping"),
    "identify/src/fit": ("identify/src/explain", "identify/src/diagnose", "identify/src/vehicle"),
    "identify/src/closed_loop": ("identify/src/explain", "identify/src/vehicle"),
    "identify/src/explain": ("identify/src/diagnose", "identify/src/closed_loop"),
    "identify/src/motor": ("env/src/effects", "env/src/world"),
    "identify/src/transfer": ("env/src/effects", "env/src/world"),
    "crtp/src/board": ("crtp/src/udp", "crtp/src/tcp", "crtp/src/fleet", "env/src/world"),
    "crtp/src/pilot": ("crtp/src/packet", "crtp/src/board", "crtp/src/server"),
    "server/src/protocol": ("server/src/serve", "server/src/flight"),
    "server/src/worlds": ("server/src/serve",),
    "server/src/flight": ("server/src/serve", "server/src/worlds"),
}


def begins(path, part):
    """Whether a path is a part's own file or below its folder."""
    return re.match(rf"{re.escape(part)}(?:\.rs|/|$)", path) is not None


def violations(found, table):
    """All uses that a table forbids, in words."""
    broken = []
    for file, line, used in found:
        for part, unknown in table.items():
            foreign = ANY in unknown and crate_of(used) != part
            if begins(file, part) and (foreign or any(begins(used, other) for other in unknown)):
                broken.append(f"{file}:{line}: {part} must not know {used}")
    return broken


@pytest.fixture(scope="module")
def found():
    return uses(ROOT)


def test_no_circle_has_more_than_five_files(found):
    biggest = largest(circles(*found))
    for crate, group in sorted(biggest.items()):
        print(f"{len(group):3d}  {crate}")
    too_large = [group for group in circles(*found) if len(group) > MOST]
    assert not too_large, "\n".join(" ".join(group) for group in too_large)


def test_nothing_knows_what_it_must_not(found):
    assert not (broken := violations(found[0], MUST_NOT_KNOW)), "\n".join(broken)


def test_the_table_is_that_of_the_page_and_of_the_code():
    page = (ROOT / "ARCHITECTURE.md").read_text()
    rows = re.findall(r"^\| `([^|]*)` \| [^|]* \| ([^|]*) \|$", page, re.MULTILINE)
    cells = {part: tuple(re.findall(rf"{ANY}|(?<=`)[\w/]+(?=`)", unknown)) for part, unknown in rows}
    assert cells == MUST_NOT_KNOW
    assert len(page.splitlines()) <= 90
    crates = re.findall(r'"(\w+)"', re.search(r"members = \[(.*?)\]", (ROOT / "Cargo.toml").read_text(), re.DOTALL)[1])
    assert sorted(crates) == sorted(part for part in MUST_NOT_KNOW if "/" not in part)
    parts = {*MUST_NOT_KNOW, *(other for unknown in MUST_NOT_KNOW.values() for other in unknown)} - {ANY}
    assert not [part for part in parts if not ((ROOT / part).exists() or (ROOT / f"{part}.rs").exists())]


def test_unsafe_code_is_where_the_page_says():
    places = re.search(r"\*\*Unsafe code\*\*(.*?)\n\n", (ROOT / "ARCHITECTURE.md").read_text(), re.DOTALL)[1]
    named = re.findall(r"`([\w/.]+)`", places)
    files = [
        path.relative_to(ROOT).as_posix()
        for path in ROOT.glob("*/src/**/*.rs")
        if "allow(unsafe_code" in path.read_text()
    ]
    assert all(any(name in file for file in files) for name in named)
    assert all(any(name in file for name in named) for file in files)


# one crate whose six files use each other in a ring, by every kind of path, and another one that uses it
TREE = {
    "ring/Cargo.toml": '[package]\nname = "a-ring"\n',
    "ring/src/lib.rs": "mod a; mod b; mod c; mod d;\nmacros![e];\nmod f;\npub use f::F as Last;\n",
    "ring/src/a.rs": "use crate::{b::{self, B}, c::C as _};\n// use crate::nowhere\npub struct A(B);\n",
    "ring/src/b.rs": 'use super::c::*;\nconst TEXT: &str = "use crate::a::A;";\npub struct B(C);\n',
    "ring/src/c.rs": "pub struct C(crate::d::inner::D);\n",
    "ring/src/d/mod.rs": "pub mod inner { pub struct D(super::super::e::E); }\nmod below;\npub struct Top;\n",
    "ring/src/d/below.rs": "use super::Top;\n",
    "ring/src/e.rs": "pub struct E(crate::Last);\n",
    "ring/src/f.rs": "pub struct F;\n#[cfg(not(test))]\nuse crate::a::A;\n",
    "user/Cargo.toml": '[package]\nname = "user"\n',
    "user/src/lib.rs": "\n\nfn f() { a_ring::Last; }\n#[cfg(any(test, fuzzing))]\nmod tests { use a_ring::e::E; }\n",
}


def found_in(folder, tree):
    for path, text in tree.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    return uses(folder)


def test_a_circle_is_found_and_a_test_closes_none(tmp_path):
    ring = tuple(f"ring/src/{name}.rs" for name in ("a", "b", "c", "d/mod", "e", "f"))
    found = found_in(tmp_path, TREE)
    assert [group for group in circles(*found) if len(group) > 1] == [ring]
    tested = TREE["ring/src/f.rs"].replace("not(test)", "test")
    assert {len(group) for group in circles(*found_in(tmp_path, {"ring/src/f.rs": tested}))} == {1}


def test_a_violation_names_file_and_line(tmp_path):
    found, _ = found_in(tmp_path, TREE)
    broken = ["user/src/lib.rs:3: user must not know ring/src/f.rs"]
    assert violations(found, {"user": ("ring/src/f",), "ring": (ANY,)}) == broken
    assert violations(found, {"user": (ANY,)}) == broken
    assert violations(found, {"user": ("ring/src/e", "ring/src/a"), "ring/src/f": ("ring/src/b",)}) == []
