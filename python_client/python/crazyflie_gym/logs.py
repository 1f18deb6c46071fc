"""Flight logs in formats that the command line neither reads nor writes: Parquet, and MATLAB's .mat.

``python -m crazyflie_gym.logs convert flight.parquet flight.csv``: the columns of a Parquet
file become those of a CSV, which a mapping file (docs/logs.md) distinguishes.
``python -m crazyflie_gym.logs convert flight.csv flight.mat``: a variable for each column.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path


def convert(source: str | Path, target: str | Path) -> list[str]:
    """Write the columns of a Parquet or CSV file as CSV or, where `target` ends so, as .mat, and return their names.

    Times become whole nanoseconds; columns of lists, structs or text are left out, since no channel is one. In a .mat
    they are column vectors, an empty cell is NaN, and names are those of `matlab_name`.

    Raises:
        ValueError: no column has numbers, or the file is neither Parquet nor, by its ending, a CSV.
        ModuleNotFoundError: without pyarrow (extra `parquet`), or SciPy for .mat (extra `mat`).
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    try:
        is_csv = ".csv" in Path(source).suffixes
        whole = pyarrow.csv.read_csv(source) if is_csv else pyarrow.parquet.ParquetFile(source).read()
    except pa.ArrowInvalid as error:
        raise ValueError(f"{source}: no {'CSV' if is_csv else 'Parquet file'} ({error})") from error
    kinds = {field.name: field.type for field in whole.schema}

    def is_number(kind: pa.DataType) -> bool:
        return any(test(kind) for test in (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, is_time))

    def is_time(kind: pa.DataType) -> bool:
        return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind))

    names = [name for name, kind in kinds.items() if is_number(kind)]
    if not names:
        raise ValueError(f"{source}: no column holds numbers (found: {', '.join(kinds) or 'none'})")

    def plain(column: pa.ChunkedArray) -> pa.ChunkedArray:
        if pa.types.is_timestamp(column.type):
            return column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
        if pa.types.is_duration(column.type):
            return column.cast(pa.duration("ns")).cast(pa.int64())
        return column.cast(pa.int8()) if pa.types.is_boolean(column.type) else column

    table = pa.table({name: plain(whole[name]) for name in names})
    if Path(target).suffix == ".mat":
        from scipy.io import savemat

        columns = {matlab_name(name): table[name].to_numpy() for name in names}
        if len(columns) < len(names):
            raise ValueError(f"{source}: columns have the same name in MATLAB: {', '.join(names)}")
        savemat(target, columns, oned_as="column", long_field_names=True)
        return names
    # numbers need no quotes, and names hold none
    pyarrow.csv.write_csv(table, target, pyarrow.csv.WriteOptions(quoting_style="needed"))
    return names


def matlab_name(column: str) -> str:
    """Return a column's name as one of MATLAB: a letter, then letters, digits and underscores."""
    plain = re.sub(r"\W", "_", column, flags=re.ASCII)
    return plain if plain[:1].isalpha() else f"x{plain}"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m crazyflie_gym.logs", description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("convert", help="write the columns of a Parquet or CSV file as CSV or .mat")
    one.add_argument("source", type=Path, metavar="FILE.parquet|csv")
    one.add_argument("target", type=Path, metavar="FILE.csv|mat")
    given = parser.parse_args(arguments)
    try:
        names = convert(given.source, given.target)
    except ModuleNotFoundError as error:
        print(f'no {error.name} here: pip install "crazyflie-gym[mat,parquet]"', file=sys.stderr)
        return 1
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{given.target}: {', '.join(names)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
