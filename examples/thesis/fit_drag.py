"""Fits one number, the drag of 4.15, to the four figures that section 7.3 gives of its 80 cm flights.

python examples/thesis/fit_drag.py [--seeds 200] [--json]
"""

import argparse
import json

import numpy as np
from flights import crazyflie, fly
from scorecard import GAINS, TO_MARKER
from tables import plain

GRID_PS = np.arange(0.3, 1.55, 0.05)
GROUPS = 10
PLACES = [f"7.3, fig. {figure}" for figure in ("7.4 (p. 51)", "7.6 (p. 52)", "7.4 (p. 51)", "7.5 (p. 52)")]
LEGEND = """\
Fitted to these four figures and to nothing else; each is a median of {seeds} flights through the lab's camera. Each
figure alone asks for the least drag that brings it down to the thesis's. The fit is the median of the four answers, so
that no figure alone decides it, and the spread is from the least to the greatest.
"""


def flown(drag_ps, seeds):
    """Return what flights with a drag have of the four figures; (seeds, 4), cm and s, infinite for never."""
    model = json.loads(crazyflie("model", "--json"))
    model["lateral"]["drag"]["value"] = drag_ps
    columns = []
    for gains, pid in GAINS.items():
        flights = fly("fly-80cm", pid, "pwm", seeds, True, json.dumps(model))
        columns += [[of(flight) for flight in flights] for (*_, of), *_ in TO_MARKER[gains][:2]]
    return np.transpose(columns)


def answers(sweep, figures):
    """Return the drag in 1/s that each figure alone asks for; flights are (drags of the grid, seeds, figures)."""
    medians, found = np.median(sweep, axis=1), []
    for ours, wanted in zip(medians.T, figures, strict=True):
        after = int(np.argmax(ours <= wanted))
        before = ours[after - 1]
        # from never to the wanted time there is no straight line
        share = (before - wanted) / (before - ours[after]) if np.isfinite(before) else 1.0
        found.append(GRID_PS[after - 1] + share * (GRID_PS[after] - GRID_PS[after - 1]))
    return found


def fit(seeds):
    """Return the fitted drag with its spread, for machines."""
    claims = [(gains, claim) for gains in GAINS for claim in TO_MARKER[gains][:2]]
    figures, sweep = [claim[2] for _, claim in claims], np.array([flown(drag_ps, seeds) for drag_ps in GRID_PS])
    alone = answers(sweep, figures)
    drag_ps = float(np.median(alone))
    groups = [np.median(answers(part, figures)) for part in np.array_split(sweep, GROUPS, axis=1)]
    fitted, rows = np.median(flown(drag_ps, seeds), axis=0), []
    for (gains, ((name, unit, *_), words, figure, *_)), place, its_ps, ours in zip(
        claims, PLACES, alone, fitted, strict=True
    ):
        about = {"gains": gains, "quantity": f"{name} ({unit})", "words": words, "place": place, "figure": figure}
        rows.append(about | {"drag_ps": float(its_ps), "ours": float(ours) if np.isfinite(ours) else None})
    spread = {"least_ps": float(min(alone)), "greatest_ps": float(max(alone))}
    error_ps = float(np.std(groups, ddof=1) / np.sqrt(GROUPS))
    return {"drag_ps": drag_ps, **spread, "standard_error_ps": error_ps, "figures": rows}


def cells(row):
    """Return a figure as text."""
    ours = f"{row['ours']:.1f}" if row["ours"] else "never"
    return [row["gains"], row["quantity"], row["words"], row["place"], f"{row['drag_ps']:.2f}", ours]


def main():
    """Print the fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200, help="flights per drag and gains")
    parser.add_argument("--json", action="store_true", help="for machines")
    args = parser.parse_args()
    found = fit(args.seeds)
    if args.json:
        print(json.dumps(found, indent=2))
        return
    header = ["gains", "quantity", "the thesis's words", "where", "drag (1/s)", "ours at the fit"]
    print(plain(header, [cells(row) for row in found["figures"]], (1, 2, 3)))
    fitted, least, greatest, error = list(found.values())[:4]
    print(f"lateral.drag = {fitted:.2f} 1/s, {least:.2f} to {greatest:.2f}; by the seeds alone +- {error:.3f}\n")
    print(LEGEND.format(seeds=args.seeds), end="")


if __name__ == "__main__":
    main()
