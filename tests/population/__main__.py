"""Makes flights with a hidden effect: rotorpy's Crazyflie under a firmware-like cascade.

The files are those of the shared generator.

usage:  python tests/population OUT --cases 400 --seed 1 [--groups null,single] [--effects wind,gust] [--jobs 2]
needs:  rotorpy 3 (the extra "population" of this repository)
"""

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

if not __package__:
    # run as a folder: `python tests/population`
    sys.path.insert(0, str(Path(__file__).parent.parent))

from population.case import GROUPS, INNER_LOOPS, draw, make
from population.declared import declare
from population.effects import EFFECTS, OUTSIDE
from population.sensors import NOISE


def main():
    """Draws, flies and writes a population."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--groups", default="null,single,single,single,compound,outside", type=lambda text: text.split(",")
    )
    parser.add_argument("--effects", type=lambda text: text.split(","), help="draw from these only")
    parser.add_argument("--noise", choices=NOISE, help="drawn unless given")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--lost", type=float, default=0.0, help="share of the rows that no log holds")
    parser.add_argument("--gap", type=float, default=0.0, metavar="S", help="seconds missing in the middle of a log")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    args = parser.parse_args()
    for name in args.effects or []:
        if name not in EFFECTS | OUTSIDE:
            parser.error(f"unknown effect {name!r}: expected one of {', '.join(EFFECTS | OUTSIDE)}")
    for group in args.groups:
        if group not in GROUPS:
            parser.error(f"unknown group {group!r}: expected one of {', '.join(GROUPS)}")
    args.out.mkdir(parents=True, exist_ok=True)
    cases = [draw(number, args.groups[number % len(args.groups)], args) for number in range(args.cases)]
    with ProcessPoolExecutor(args.jobs) as pool:
        declared = dict(zip(INNER_LOOPS, pool.map(declare, INNER_LOOPS), strict=True))
        print("declared", json.dumps(declared))
        pending = [pool.submit(make, case, declared, args.out) for case in cases]
        for done in pending:
            print(done.result(), flush=True)


if __name__ == "__main__":
    main()
