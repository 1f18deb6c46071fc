"""Writes the scorecard that the program prints into docs/thesis.md; a test compares the two."""

import pathlib
import subprocess
import sys

MARK = "<!-- scorecard -->"


def main():
    """Replace the block between the two marks."""
    page = pathlib.Path(__file__).parent.parent / "docs/thesis.md"
    before, _, after = page.read_text().split(MARK)
    program = pathlib.Path(sys.executable).parent / "crazyflie"
    block = subprocess.run(
        [program, "reproduce", "thesis", "--markdown"], check=True, capture_output=True, text=True
    ).stdout
    page.write_text(f"{before}{MARK}\n{block.strip()}\n{MARK}{after}")


if __name__ == "__main__":
    main()
