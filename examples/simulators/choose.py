"""Chooses what turns PWM into thrust, on the flights of the fit alone: THRUST_POWER and HOVER_S of `real_flights.py`.

    python examples/simulators/choose.py ../shared/data/nanobench

No simulator takes part. A point mass with the measured tilt is lifted by the thrust; what is printed is how far its
climb is from the measured one, in m/s (root mean square over the flights).
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from real_flights import DT_S, FIT, GRAVITY_MPS2, THRUST_POWER, check_recordings, cut_windows, read_flight

POWERS, SPANS_S = (1.0, 1.25, 1.5, 1.75, 2.0), (2.0, 3.0, 5.0)


def climb_errors(flight, power, span_s):
    """Return mean squares, (m/s)^2, of the climb 0.5 and 2 s ahead, from the same instants for every span."""
    command = flight.command.copy()
    command[:, 3] **= power / THRUST_POWER
    _, commanded, measured = cut_windows(dataclasses.replace(flight, command=command, hover_s=span_s), 2.0, 0.25)
    lift = commanded[..., 3] * np.cos(measured[:, :-1, 6]) * np.cos(measured[:, :-1, 7])
    gained_mps = np.cumsum(GRAVITY_MPS2 * (lift - 1.0), axis=1) * DT_S
    missed = (measured[:, :1, 5] + gained_mps - measured[:, 1:, 5])[round((max(SPANS_S) - span_s) / 0.25) :]
    return (missed[:, [49, 199]] ** 2).mean(0)


def main(folder):
    """Print a line for each power and span."""
    recorded = [read_flight(folder / f"{name}.csv.gz") for name in FIT]
    print("power  span, s  0.5 s ahead  2 s ahead")
    for power in POWERS:
        for span_s in SPANS_S:
            near, far = np.sqrt(np.mean([climb_errors(flight, power, span_s) for flight in recorded], 0))
            print(f"{power:5.2f} {span_s:8.0f} {near:12.4f} {far:10.4f}")


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("data", type=Path, help="folder of the recordings")
    data = arguments.parse_args().data
    check_recordings(arguments, data, (f"{name}.csv.gz" for name in FIT))
    main(data)
