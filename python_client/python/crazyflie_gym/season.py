"""A season of the benchmark, verified by anybody: every attempt is flown again and compared, bit by bit.

    python -m crazyflie_gym.season spring.jsonl                   # in this process
    python -m crazyflie_gym.season spring.jsonl --ray auto        # on the machines of a Ray cluster

The archive is that of `crazyflie bench season close`. Each verdict is stored once, whichever machine dies meanwhile; a
verification that was cut short goes on where it was. Needs the extra `ray`, also for its progress bar.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from crazyflie_gym import _native
from crazyflie_gym._parts import need
from crazyflie_gym.sweep import Store, do_works

need("bench")


@dataclass(frozen=True)
class Attempt:
    """One attempt of an archive, with the archive's first line, which it is verified by."""

    head: str
    line: str

    def key(self) -> str:
        """Return the SHA-256 of both."""
        return hashlib.sha256(f"{self.head}\n{self.line}".encode()).hexdigest()


def fly_again(attempt: Attempt) -> list[dict[str, Any]]:
    """Return the verdict on an attempt: `id`, `scenario`, `controller`, `verdict`, `findings`."""
    found = _native.verify_attempts(f"{attempt.head}\n{attempt.line}\n")
    return cast("list[dict[str, Any]]", json.loads(found))


def verify(
    archive: str | Path, store: Store, ray_address: str | None = None, progress: bool = True
) -> list[dict[str, Any]]:
    """Return a verdict for each attempt of an archive, in their order.

    Args:
        archive: a file of `crazyflie bench season close`.
        store: place of verdicts, each added as it finishes.
        ray_address: of a Ray cluster ("auto", or "local" for one of this machine alone), or None for this process.
        progress: whether to show a bar, on a terminal.

    Raises:
        ValueError: if the archive is damaged or an attempt is missing, with the line.
    """
    path = Path(archive)
    _native.read_season(path)
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    return do_works([Attempt(head, line) for line in lines], fly_again, store, ray_address, progress)


def main(words: list[str] | None = None) -> int:
    """Verify an archive; 0 if every attempt is verified."""
    parser = argparse.ArgumentParser(
        prog="python -m crazyflie_gym.season", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("archive", help="a file of `crazyflie bench season close`")
    parser.add_argument("--ray", metavar="ADDRESS", help='of a Ray cluster, "auto", or "local"')
    parser.add_argument("--store", metavar="FILE", help="where verdicts are kept (default: beside the archive)")
    parser.add_argument("--json", action="store_true", help="for machines")
    asked = parser.parse_args(words)
    try:
        with Store(asked.store or f"{asked.archive}.verdicts") as store:
            found = verify(asked.archive, store, asked.ray)
    except (OSError, ValueError) as problem:
        print(f"{asked.archive}: {problem}", file=sys.stderr)
        return 1
    wrong = [row for row in found if row["verdict"] == "wrong"]
    if asked.json:
        print(json.dumps(found, indent=2))
    else:
        for row in found:
            print(f"{row['id']} {row['scenario']} {row['controller']}: {row['verdict']} {'; '.join(row['findings'])}")
        print(f"{len(found)} attempts, {len(wrong)} of them wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
