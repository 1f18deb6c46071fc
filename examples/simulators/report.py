"""The table and the picture of a comparison, and its figures for machines."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
from errors import HORIZONS_S, QUANTITIES, Difference, difference

# all others are compared with this one
OURS = "ours, identified"
MARK = "<!-- {} -->"
COLOURS = ("#56b4e9", "#0072b2", "#d55e00")


def differences(found: dict[str, dict], ours: str = OURS) -> dict[str, list[list[Difference]]]:
    """Return each simulator's paired differences against ours, by quantity and horizon; without ours there are none."""
    if "errors" not in found.get(ours, {}):
        return {}
    base = found[ours]["errors"]
    return {
        name: [[difference(one["errors"][:, q, h], base[:, q, h]) for h in range(base.shape[2])] for q in range(4)]
        for name, one in found.items()
        if "errors" in one and name != ours
    }


def mean_errors(errors: np.ndarray) -> np.ndarray:
    """Return the mean over flights (4, 3) of errors (flights, 4, 3)."""
    return errors.mean(0)


def table(found: dict[str, dict], ours: str = OURS) -> str:
    """Return the errors as Markdown: means over flights, and what is significantly worse or better than ours."""
    gaps = differences(found, ours)
    first, *later = (f"{horizon_s:g} s" for horizon_s in HORIZONS_S)
    heads = [head for q, unit in QUANTITIES.items() for head in (f"{q} ({unit}), {first}", *later)]
    rows = [["simulator", *heads], ["---", *["---:"] * len(heads)]]
    for name, one in found.items():
        if "missing" in one:
            rows.append([name, f"not installed: {one['missing']}", *[""] * (len(heads) - 1)])
            continue
        cells = []
        for q, errors in enumerate(mean_errors(one["errors"])):
            for h, error in enumerate(errors):
                verdict = gaps[name][q][h].verdict if name in gaps else ""
                cells.append(f"{error:.3g}" + {"worse": " +", "better": " -", "": ""}[verdict])
        rows.append([name, *cells])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def draw(found: dict[str, dict], path: Path) -> None:
    """Draw the mean errors of all simulators, with each flight's as a dot, into an SVG file; needs matplotlib."""
    import matplotlib as mpl

    mpl.use("agg")
    mpl.rcParams["svg.hashsalt"] = "crazyflie"
    import matplotlib.pyplot as plt

    shown = {name: one["errors"] for name, one in found.items() if "errors" in one}
    figure, panels = plt.subplots(1, 4, figsize=(12, 0.42 * len(shown) + 1.4), sharey=True, layout="constrained")
    for q, ((quantity, unit), panel) in enumerate(zip(QUANTITIES.items(), panels, strict=True)):
        for h, (horizon_s, colour) in enumerate(zip(HORIZONS_S, COLOURS, strict=True)):
            for row, errors in enumerate(shown.values()):
                label = f"{horizon_s:g} s ahead" if row == 0 else None
                panel.plot(errors[:, q, h], np.full(len(errors), row), ".", color=colour, alpha=0.3, ms=4)
                panel.plot(mean_errors(errors)[q, h], row, "|", color=colour, ms=14, mew=2.5, label=label)
        panel.set(xscale="log" if q < 2 else "linear", xlabel=f"{quantity}, {unit}")
        panel.grid(alpha=0.3)
    panels[0].set_yticks(range(len(shown)), list(shown))
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(HORIZONS_S))
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    path.write_text("".join(line.rstrip() + "\n" for line in text.getvalue().splitlines()))


def as_json(found: dict[str, dict], flights: list[str], ours: str = OURS) -> str:
    """Return all figures for machines: errors [flight][quantity][horizon], and the differences against ours.

    A difference `less_ours` [quantity][horizon] is mean, low and high end of its 95 % interval.
    """
    gaps = differences(found, ours)
    lines = []
    for name, one in found.items():
        told = {key: _rounded(value) if key == "errors" else value for key, value in one.items()}
        if name in gaps:
            told["less_ours"] = _rounded(gaps[name])
        lines.append(f"  {json.dumps(name)}: {json.dumps(told)}")
    head = {"flights": flights, "quantities": QUANTITIES, "horizons_s": HORIZONS_S, "ours": ours}
    return json.dumps(head)[:-1] + ', "simulators": {\n' + ",\n".join(lines) + "\n}}\n"


def read_json(text: str) -> dict[str, dict]:
    """Return what `as_json` was given, errors as it rounded them."""
    simulators = json.loads(text)["simulators"]
    return {
        name: one | {"errors": np.array(one["errors"])} if "errors" in one else one for name, one in simulators.items()
    }


def filled(page: str, text: str, name: str) -> str:
    """Return a page with a text between its two lines MARK of a name.

    Raises:
        ValueError: if there are not two of them.
    """
    mark = MARK.format(name)
    parts = page.split(mark)
    if len(parts) != 3:
        raise ValueError(f"expected {mark} twice on the page, found it {len(parts) - 1} times")
    return f"{parts[0]}{mark}\n{text}\n{mark}{parts[2]}"


def _rounded(numbers) -> list:
    return [[float(f"{x:.6g}") for x in row] if np.ndim(row) == 1 else _rounded(row) for row in numbers]
