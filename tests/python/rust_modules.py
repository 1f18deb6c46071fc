"""Finds which file of the Rust code uses which, by `use` lines and paths. Tests are left out, re-exports are followed.

Methods have no path: a call of one is not seen, and so a type's methods in another file are not either.
Run it from the project's root for the largest circle of every crate: `python3 tests/python/rust_modules.py`.
"""

import re
from bisect import bisect
from dataclasses import dataclass, field
from pathlib import Path

NOT_CODE = re.compile(
    r"""//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|b?'(?:\\[^\n']+|[^\\'\n])'""", re.DOTALL
)
# `test` or `fuzzing`, alone or in `any` and `all`, but not `not(test)`
TEST = re.compile(r"#\s*\[cfg\((?:test\)|(?:any|all)\([^\]]*?(?<!not\()\b(?:test|fuzzing)\b)[^\]]*\]")
USE = re.compile(r"\buse\s+([^;]+);")
MOD = re.compile(r"\bmod\s+(\w+)")
INNER_MOD = re.compile(r"\bmod\s+(\w+)\s*\{")
ITEM = re.compile(r"\b(?:fn|struct|enum|union|trait|type|const|static|macro_rules\s*!)\s+(?!(?:fn|unsafe)\b)(\w+)")
PATH = re.compile(r"(?<![\w:.])(?:::)?(\$?\w+(?:\s*::\s*\w+)+)")
WORD = re.compile(r"(?<![\w.:$'])[A-Za-z_]\w*")


@dataclass(eq=False)
class Module:
    """A module: a whole file, or one that is written inside a file."""

    file: str
    parent: "Module | None" = None
    children: dict = field(default_factory=dict)
    items: set = field(default_factory=set)
    # by name here: the path that is imported, and its place in the file
    names: dict = field(default_factory=dict)
    globs: list = field(default_factory=list)
    text: str = ""

    def root(self):
        return self.parent.root() if self.parent else self

    def files_above(self):
        return self.parent.files_above() | {self.parent.file} if self.parent else set()

    def all(self):
        yield self
        for child in self.children.values():
            yield from child.all()

    def read(self, path, root):
        """Reads the module's file and the files below it: those of `mod` lines, and by their place those of macros."""
        text, tests = product_code(path.read_text())
        below = path.parent if path.stem in ("lib", "main", "mod") else path.parent / path.stem
        self.fill(text)
        for child in sorted([*below.glob("*.rs"), *below.glob("*/mod.rs")]):
            name = child.parent.name if child.stem == "mod" else child.stem
            if child != path and name not in tests | {"lib", "main", "mod"}:
                self.children[name] = Module(child.relative_to(root).as_posix(), self)
                self.children[name].read(child, root)
        return self

    def fill(self, text):
        """Takes from a text what it declares; the text of modules inside it goes to them."""
        while match := INNER_MOD.search(text):
            end = closing(text, match.end() - 1)
            self.children[match[1]] = Module(self.file, self)
            self.children[match[1]].fill(blank(blank(text, 0, match.end()), end, len(text)))
            text = blank(text, match.start(), end)
        for match in USE.finditer(text):
            for path, name in imports(match[1]):
                if name == "*":
                    self.globs.append((path[:-1], match.start()))
                else:
                    self.names[name] = (path, match.start())
        self.text = USE.sub(lambda match: blank(match[0], 0, len(match[0])), text)
        self.items = set(ITEM.findall(self.text))

    def paths(self):
        """All paths in the module, each with its place. A word alone may come from a `use` of all names."""
        yield from self.names.values()
        yield from self.globs
        for match in PATH.finditer(self.text):
            yield tuple(re.split(r"\s*::\s*", match[1])), match.start()
        own = {*self.items, *self.names, *self.children}
        for match in WORD.finditer(self.text) if self.globs else ():
            if match[0] not in own:
                yield (match[0],), match.start()

    def find(self, path, crates, seen=()):
        """The module that a path names, or that declares what it names; None for what is not ours."""
        if not path or (self, path) in seen:
            return None if path else self
        seen = (*seen, (self, path))
        first, rest = path[0], path[1:]
        if first in ("crate", "$crate"):
            return self.root().find(rest, crates, seen)
        if first in ("self", "super"):
            return (self if first == "self" else self.parent or self).find(rest, crates, seen)
        if first in self.children:
            return self.children[first].find(rest, crates, seen)
        if first in self.names and (found := self.find(self.names[first][0] + rest, crates, seen)):
            return found
        if first in self.items:
            return self
        # the path of a `use` of all names is not looked for in what it brings
        for glob, _ in self.globs if (self, "*") not in seen else ():
            source = self.find(glob, crates, (*seen, (self, "*")))
            if source and (found := source.find(path, crates, seen)):
                return found
        return crates[first].find(rest, crates, seen) if first in crates else None


def blank(text, start, end):
    """The same text with spaces in place of a part: all else keeps its place."""
    return text[:start] + re.sub(r"[^\n]", " ", text[start:end]) + text[end:]


def closing(text, at):
    """The place behind the brace that closes the one at `at`."""
    depth = 0
    for match in re.compile(r"[{}]").finditer(text, at):
        depth += 1 if match[0] == "{" else -1
        if depth == 0:
            return match.end()
    return len(text)


def product_code(text):
    """The text without comments, strings and tests, and the names of modules that only tests have."""
    text = NOT_CODE.sub(lambda match: blank(match[0], 0, len(match[0])), text)
    tests = set()
    while match := TEST.search(text):
        end = re.compile(r"[;{]").search(text, match.end()).end()
        if text[end - 1] == "{":
            end = closing(text, end - 1)
            end += text[end : end + 1] == ";"
        tests.update(MOD.findall(text[match.end() : end]))
        text = blank(text, match.start(), end)
    return text, tests


def imports(tree, prefix=()):
    """The paths of a `use` tree, each with its name here; `*` for all names."""
    head, brace, body = tree.strip().partition("{")
    path, _, name = head.partition(" as ")
    path = (*prefix, *(part.strip() for part in path.split("::") if part.strip()))
    if not brace:
        path = path[:-1] if path[-1] == "self" and len(path) > 1 else path
        yield path, name.strip() or path[-1]
        return
    depth, start = 0, 0
    for at, char in enumerate(body):
        depth += {"{": 1, "}": -1}.get(char, 0)
        if depth < 0 or (depth == 0 and char == ","):
            if body[start:at].strip():
                yield from imports(body[start:at], path)
            start = at + 1


def uses(root):
    """All uses of one file by another, as (file, line, used file), and the files above each file in the module tree."""
    crates, programs = {}, []
    for manifest in sorted(Path(root).glob("*/Cargo.toml")):
        name = re.search(r'^name = "(.+)"', manifest.read_text(), re.MULTILINE)[1].replace("-", "_")
        for path in (manifest.parent / "src" / file for file in ("lib.rs", "main.rs")):
            if path.exists():
                top = Module(path.relative_to(root).as_posix())
                if path.stem == "lib":
                    crates[name] = top.read(path, Path(root))
                else:
                    top.fill(product_code(path.read_text())[0])
                    programs.append(top)
    found, above = set(), {}
    for module in (module for top in [*crates.values(), *programs] for module in top.all()):
        above.setdefault(module.file, set()).update(module.files_above() - {module.file})
        ends = [match.start() for match in re.finditer("\n", module.text)]
        for path, at in module.paths():
            used = module.find(path, crates)
            if used and used.file != module.file:
                found.add((module.file, bisect(ends, at) + 1, used.file))
    return sorted(found), above


def crate_of(file):
    return file.split("/")[0]


def circles(found, above):
    """Groups of files of one crate that all use each other, the largest first. A file's uses of files above and below
    it in the module tree do not count."""
    graph = {file: set() for file in above}
    for file, _, used in found:
        if crate_of(file) == crate_of(used) and used not in above[file] and file not in above[used]:
            graph[file].add(used)

    def reached(start):
        seen, todo = set(), [start]
        while todo:
            for used in graph[todo.pop()] - seen:
                seen.add(used)
                todo.append(used)
        return seen

    reach = {file: reached(file) for file in graph}
    groups = {tuple(sorted({file, *(other for other in reach[file] if file in reach[other])})) for file in graph}
    return sorted(groups, key=lambda group: (-len(group), group))


def largest(groups):
    """The largest circle of every crate; a file alone where it has none."""
    return {crate_of(group[0]): group for group in reversed(groups)}


if __name__ == "__main__":
    for crate, group in sorted(largest(circles(*uses("."))).items()):
        print(f"{len(group):3d}  {crate:14}", *group if len(group) > 1 else ())
