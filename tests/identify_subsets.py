"""Identifies a vehicle from random subsets of flights.

Each subset must converge, leave no number at a bound, and agree with the others.

    python tests/identify_subsets.py target/release/crazyflie a.csv b.csv ... --size 5 --subsets 20 --mass 0.034

Prints one line per subset and the spread of every number; ends with 1 if a subset failed. Needs no packages.
"""

import argparse
import json
import random
import statistics
import subprocess
import sys


def identify(program, fit, test, mass_kg):
    """The JSON answer of `crazyflie identify` on these logs."""
    command = [program, "identify", "--json", "--mass", str(mass_kg), "--fit", *fit]
    answer = subprocess.run(command + (["--test", *test] if test else []), capture_output=True, text=True)
    if answer.returncode != 0:
        raise RuntimeError(answer.stderr.strip())
    return json.loads(answer.stdout)


def errors_2s(found, part):
    """Sideways, vertical and space velocity errors 2 s ahead, m/s."""
    axes = found["axis_errors"].get(part, [])
    return {e["axis"]: e["after"] for e in axes if e["horizon_s"] == 2.0}


def faults(found):
    """What is wrong with an answer."""
    bound = [p["name"] + " at its bound" for p in found["parameters"] if p["at_bound"]]
    unknown = [p["name"] + " without an error" for p in found["parameters"] if p["standard_error"] is None]
    return bound + unknown + ([] if found["converged"] else ["did not converge"])


def main():
    """Runs the subsets and ends with their verdict."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("logs", nargs="+")
    parser.add_argument("--size", type=int, default=5)
    parser.add_argument("--subsets", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="skip the subsets before this one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mass", type=float, default=0.034, help="kg")
    parser.add_argument("--judge", action="store_true", help="predict the flights that a subset leaves out")
    args = parser.parse_args()
    rng = random.Random(args.seed)
    chosen = [sorted(rng.sample(args.logs, args.size)) for _ in range(args.subsets)][args.first :]
    values, failed = {}, 0
    for i, fit in enumerate(chosen, args.first):
        rest = [log for log in args.logs if log not in fit] if args.judge else []
        try:
            found = identify(args.program, fit, rest, args.mass)
        except RuntimeError as error:
            failed += 1
            print(f"{i}: {error} ({' '.join(fit)})", flush=True)
            continue
        wrong = faults(found)
        failed += bool(wrong)
        for p in found["parameters"]:
            values.setdefault(p["name"], []).append(p["value"])
        axes = errors_2s(found, "test" if rest else "fit")
        text = ", ".join(f"{axis} {error:.3f}" for axis, error in axes.items())
        left_out = "; left out " + ", ".join(found["left_out"]) if found["left_out"] else ""
        print(f"{i}: {', '.join(wrong) or 'good'}; 2 s ahead {text}{left_out}", flush=True)
    for name, all_values in values.items():
        spread = statistics.stdev(all_values) if len(all_values) > 1 else 0.0
        print(f"{name}: {statistics.mean(all_values):.4g} +- {spread:.2g} (in {len(all_values)} of {len(chosen)})")
    print(f"{len(chosen) - failed} of {len(chosen)} good")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
