"""Identifies the Crazyflie 2.1 from the NanoBench flights and writes the model file of the vehicle `cf21`.

python examples/thesis/identify_cf21.py ../shared/data [--out env/models/cf21.toml]

`crazyflie identify` fits the flights of the fit half, starting from env/models/cf21-datasheet.toml. `crazyflie
horizons` fits the motors' lag to the logged rotor speeds. The rest of the motor-level form is the data sheet's.
"""

import argparse
import json
import re
import tempfile
from pathlib import Path

from flights import crazyflie

from recorded import FIT, TEST

SHEET = Path(__file__).parents[2] / "env/models/cf21-datasheet.toml"
ABOUT = "Crazyflie 2.1 of 32.8 g, identified from 11 flights of NanoBench (Ullah and Baca 2026, BSD-3)"


def identified(data):
    """Return the model file's text from the recordings in a folder, which must be there."""
    logs = [[str(data / "nanobench" / f"{name}.csv.gz") for name in half.split()] for half in (FIT, TEST)]
    both = ["--fit", *logs[0], "--test", *logs[1]]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "cf21.toml")
        found = json.loads(crazyflie("identify", SHEET, *both, "--out", out, "--json"))
        text = out.read_text()
    motors = json.loads(crazyflie("model", SHEET, "--json"))["vertical"]["motors"]
    lag = next(p for p in json.loads(crazyflie("horizons", *both, "--json"))["parameters"] if p["name"] == "motor_lag")
    source = f"identified from rotor speeds of 11 flights: standard error {lag['stderr']:.1e}"
    motors["lag"] = {"value": round(lag["value"], 4), "unit": "s", "source": source}
    del motors["lag_falling"]
    errors = [
        f"# {row['horizon_s']} s ahead, {row['axis']}: {row['after']:.3f} {row['unit']}"
        for row in found["axis_errors"]["test"]
    ]
    head = [
        "# Written by examples/thesis/identify_cf21.py; the errors (rms) on five flights that were not fitted are:",
        *errors,
    ]
    text = re.sub(r'description = ".*"', f'description = "{ABOUT}"', text, count=1)
    return "\n".join(head) + "\n" + rounded(text) + table("vertical.motors", motors)


def rounded(text):
    """Return a model file's text with numbers of six digits, far below their standard errors."""
    return re.sub(r"value = (\S+)", lambda found: f"value = {float(found[1]):.6g}", text)


def table(name, members):
    """Return a part of a model file: words first, then a table for each quantity."""
    words = "".join(f'{key} = "{value}"\n' for key, value in members.items() if isinstance(value, str))
    numbers = "".join(
        f'\n[{name}.{key}]\nvalue = {value["value"]:.6g}\nunit = "{value["unit"]}"\nsource = "{value["source"]}"\n'
        for key, value in members.items()
        if isinstance(value, dict)
    )
    return f"\n[{name}]\n{words}{numbers}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--out", type=Path, default=SHEET.with_name("cf21.toml"))
    args = parser.parse_args()
    if not (args.data / "nanobench").is_dir():
        parser.error(f"{args.data}: expected a folder of recordings, but it lacks nanobench")
    args.out.write_text(identified(args.data))
