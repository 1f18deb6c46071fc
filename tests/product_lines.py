"""Counts Rust product code: lines that are not blank, no comment and no test, crate by crate.

Run it from the project's root: `python3 tests/product_lines.py`. CI prints the table. The core is what a build without
optional parts compiles: not the crates of guests, and no module that a feature turns on.
"""

import pathlib
import re
import subprocess

# crates that are no part of the core
GUESTS = ("bench", "crtp", "jax", "lab")
# a module of its own file that a condition turns on: the condition and its name
CHOSEN = re.compile(r"#\[cfg\(([^]]*)\)\]\s*(?:#\[[^]]*\]\s*)*(?:pub(?:\(\w+\))? )?mod (\w+);")
TEST_ITEM = re.compile(r"^\s*#\[cfg\((test|all\([^)]*\btest\b[^)]*\))\)\]")
STRING = re.compile(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])\'')


def is_product(path: str) -> bool:
    """Tells a product's file from one of tests, benches and fuzz targets, by its path from the root."""
    parts = pathlib.PurePosixPath(path).parts
    name = parts[-1]
    return not ({"tests", "benches", "fuzz", "fuzzed"} & set(parts)) and name not in ("tests.rs", "fuzzed.rs")


def product_lines(text: str) -> int:
    """Counts a file's product lines. A `#[cfg(test)]` item counts for nothing, up to its closing brace or semicolon."""
    count, depth, skipping, in_comment = 0, 0, False, False
    for line in text.splitlines():
        bare = STRING.sub('""', line).strip()
        if in_comment:
            in_comment = "*/" not in bare
            continue
        if bare.startswith("/*"):
            in_comment = "*/" not in bare
            continue
        if not skipping and TEST_ITEM.match(line) and "not(test)" not in line:
            skipping, depth = True, 0
            continue
        code = bare.split("//")[0].strip()
        if skipping:
            depth += code.count("{") - code.count("}")
            if depth <= 0 and (code.endswith("}") or code.endswith(";")):
                skipping = False
            continue
        count += bool(code)
    return count


def chosen_modules(root: pathlib.Path, path: str) -> list[tuple[str, str]]:
    """Lists the modules that conditions turn on in a file: each condition, and the module's path without ending."""
    file = pathlib.PurePosixPath(path)
    below = file.parent if file.name in ("lib.rs", "main.rs", "mod.rs") else file.with_suffix("")
    return [(condition, str(below / name)) for condition, name in CHOSEN.findall((root / path).read_text())]


def counts(root: pathlib.Path) -> dict[str, list[int]]:
    """Product lines by top folder, of all Rust files that git tracks: all, and those of the core."""
    listed = subprocess.run(["git", "ls-files", "*.rs"], cwd=root, check=True, capture_output=True, text=True)
    files = list(filter(is_product, listed.stdout.split()))
    chosen = [module for path in files for module in chosen_modules(root, path)]

    def is_within(path: str, word: str) -> bool:
        return any(word in condition and re.match(rf"{module}(\.rs|/)", path) for condition, module in chosen)

    totals: dict[str, list[int]] = {}
    for path in files:
        if not is_within(path, "test") or is_within(path, "not(test"):
            crate, lines = path.split("/")[0], product_lines((root / path).read_text())
            total = totals.setdefault(crate, [0, 0])
            total[0] += lines
            total[1] += 0 if crate in GUESTS or is_within(path, "feature") else lines
    return totals


if __name__ == "__main__":
    totals = counts(pathlib.Path(__file__).resolve().parent.parent)
    print("    all    core")
    for crate, (lines, core) in sorted(totals.items(), key=lambda item: -item[1][0]):
        print(f"{lines:7d} {core:7d}  {crate}")
    lines, core = (sum(column) for column in zip(*totals.values(), strict=True))
    print(f"{lines:7d} {core:7d}  Rust product code, without blank lines, comments and tests")
