"""Writes the scorecard that the program prints into README.md; a test compares the two."""

import pathlib
import subprocess
import sys

MARK = "<!-- scorecard -->"


def main():
    """Replace the block between the two marks."""
    readme = pathlib.Path(__file__).parent.parent / "README.md"
    before, _, after = readme.read_text().split(MARK)
    program = pathlib.Path(sys.executable).parent / "crazyflie"
    block = subprocess.run(
        [program, "reproduce", "thesis", "--markdown"], check=True, capture_output=True, text=True
    ).stdout
    readme.write_text(f"{before}{MARK}\n{block.strip()}\n{MARK}{after}")


if __name__ == "__main__":
    main()
