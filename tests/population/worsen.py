"""Copies a folder of cases, and worsens their logs: the same flights, with lost rows, gaps or a fast camera clock.

python tests/population/worsen.py CASES OUT --lost 0.1
"""

import argparse
import csv
import gzip
import io
import shutil
from pathlib import Path

import numpy as np


def worsened(text: str, args: argparse.Namespace, rng: np.random.Generator) -> str:
    """Return the text of a log without the rows that are lost, and with the camera's own time."""
    header, *rows = csv.reader(io.StringIO(text))
    kept = rng.random(len(rows)) >= args.lost
    times_s = np.array([float(row[0]) for row in rows])
    kept &= np.abs(times_s - times_s.mean()) >= 0.5 * args.gap
    camera = header.index("t_cam")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    for row, keep in zip(rows, kept, strict=True):
        if row[camera]:
            row[camera] = f"{float(row[camera]) * args.clock:.4f}"
        if keep:
            writer.writerow(row)
    return out.getvalue()


def main() -> None:
    """Copy and worsen all logs of a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", type=Path, help="folder of cases")
    parser.add_argument("out", type=Path, help="folder of the worsened cases")
    parser.add_argument("--lost", type=float, default=0.0, help="share of the rows that no log holds")
    parser.add_argument("--gap", type=float, default=0.0, metavar="S", help="seconds missing in the middle of a log")
    parser.add_argument("--clock", type=float, default=1.0, help="seconds of the camera's clock in a second")
    args = parser.parse_args()
    args.out.mkdir(parents=True)
    for file in sorted(args.cases.iterdir()):
        if file.name.endswith(".csv.gz"):
            rng = np.random.default_rng(list(file.name.encode()))
            text = worsened(gzip.decompress(file.read_bytes()).decode(), args, rng)
            (args.out / file.name).write_bytes(gzip.compress(text.encode(), mtime=0))
        else:
            shutil.copy(file, args.out)


if __name__ == "__main__":
    main()
