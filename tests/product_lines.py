"""Counts Rust product code: lines that are not blank, no comment and no test, crate by crate.

Run it from the project's root: `python3 tests/product_lines.py`. CI prints the table.
"""

import pathlib
import re
import subprocess

# a file of its own that only tests compile
TEST_FILE = re.compile(r"#\[cfg\((?:any\()?test\b[^]]*\]\s*(?:pub(?:\(crate\))? )?mod (\w+);")
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


def test_files(root: pathlib.Path, path: str) -> list[str]:
    """Names the files that a file declares as modules of tests."""
    file = pathlib.PurePosixPath(path)
    below = file.parent if file.name in ("lib.rs", "main.rs", "mod.rs") else file.with_suffix("")
    return [str(below / f"{name}.rs") for name in TEST_FILE.findall((root / path).read_text())]


def counts(root: pathlib.Path) -> dict[str, int]:
    """Product lines by top folder, of all Rust files that git tracks."""
    listed = subprocess.run(["git", "ls-files", "*.rs"], cwd=root, check=True, capture_output=True, text=True)
    totals: dict[str, int] = {}
    files = list(filter(is_product, listed.stdout.split()))
    tests = {file for path in files for file in test_files(root, path)}
    for path in sorted(set(files) - tests):
        crate = path.split("/")[0]
        totals[crate] = totals.get(crate, 0) + product_lines((root / path).read_text())
    return totals


if __name__ == "__main__":
    root = pathlib.Path(__file__).resolve().parent.parent
    totals = counts(root)
    for crate, lines in sorted(totals.items(), key=lambda item: -item[1]):
        print(f"{lines:7d}  {crate}")
    print(f"{sum(totals.values()):7d}  Rust product code, without blank lines, comments and tests")
