"""Flight logs that the command line does not read itself.

``python -m crazyflie_gym.logs convert flight.parquet flight.csv``: the columns of a Parquet
file become those of a CSV, which a mapping file (docs/logs.md) distinguishes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def convert(source: str | Path, target: str | Path) -> list[str]:
    """Write the columns of a Parquet file as CSV and return their names.

    Times become whole nanoseconds; columns of lists, structs or text are left out, since no channel is one.

    Raises:
        ValueError: no column has numbers, or the file is no Parquet.
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    try:
        file = pyarrow.parquet.ParquetFile(source)
    except pa.ArrowInvalid as error:
        raise ValueError(f"{source}: no Parquet file ({error})") from error
    kinds = {field.name: field.type for field in file.schema_arrow}

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

    table = file.read(columns=names)
    table = pa.table({name: plain(table[name]) for name in names})
    # numbers need no quotes, and names hold none
    pyarrow.csv.write_csv(table, target, pyarrow.csv.WriteOptions(quoting_style="needed"))
    return names


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m crazyflie_gym.logs", description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("convert", help="write the columns of a Parquet file as CSV")
    one.add_argument("source", type=Path, metavar="FILE.parquet")
    one.add_argument("target", type=Path, metavar="FILE.csv")
    given = parser.parse_args(arguments)
    try:
        names = convert(given.source, given.target)
    except ModuleNotFoundError:
        print('Parquet needs pyarrow: pip install "crazyflie-gym[parquet]"', file=sys.stderr)
        return 1
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{given.target}: {', '.join(names)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
