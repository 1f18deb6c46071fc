"""Cuts the small pieces of third-party flight logs that the tests read.

    python3 logs/tests/data/cut.py FOLDER

FOLDER holds nanobench/ and crazypad/ as their authors published them. The pieces keep every digit; nothing else is changed.
"""

import gzip
import pathlib
import struct
import sys
import zlib

HERE = pathlib.Path(__file__).parent


def cut_csv(source: pathlib.Path, target: str, start_s: float, length_s: float) -> None:
    """Rows of a NanoBench CSV from `start_s` after its first row, or before its end if negative."""
    lines = gzip.decompress(source.read_bytes()).decode().splitlines(keepends=True)
    times = [float(line.split(",", 1)[0]) for line in lines[1:]]
    begin = (times[0] if start_s >= 0 else times[-1]) + start_s
    rows = [line for t, line in zip(times, lines[1:], strict=True) if begin <= t < begin + length_s]
    # no name and no time in the header: the same bytes every time
    (HERE / target).write_bytes(gzip.compress((lines[0] + "".join(rows)).encode(), 9, mtime=0))


def cut_card(source: pathlib.Path, target: str, start_s: float, length_s: float) -> None:
    """Records of a micro-SD log, and the check sum of what is left."""
    data = source.read_bytes()
    _, version, events = struct.unpack_from("<BHH", data)
    clock, unit_s = ("<I", 1e-3) if version == 1 else ("<Q", 1e-6)
    at, sizes = 5, {}
    for _ in range(events):
        (number,) = struct.unpack_from("<H", data, at)
        at = data.index(b"\0", at + 2) + 1
        (count,) = struct.unpack_from("<H", data, at)
        at += 2
        sizes[number] = 2 + struct.calcsize(clock)
        for _ in range(count):
            end = data.index(b"\0", at)
            sizes[number] += struct.calcsize("<" + data[at:end].decode()[-2])
            at = end + 1
    body, first_s = data[:at], None
    while at + 4 < len(data):
        (number,) = struct.unpack_from("<H", data, at)
        t_s = struct.unpack_from(clock, data, at + 2)[0] * unit_s
        first_s = t_s if first_s is None else first_s
        record = data[at : at + sizes[number]]
        body += record if 0 <= t_s - first_s - start_s < length_s else b""
        at += sizes[number]
    body += struct.pack("<I", zlib.crc32(body))
    (HERE / target).write_bytes(gzip.compress(body, 9, mtime=0))


def main() -> None:
    folder = pathlib.Path(sys.argv[1])
    nanobench, crazypad = folder / "nanobench", folder / "crazypad"
    cut_csv(nanobench / "B2_circle_fast_rep2.csv.gz", "nanobench_start.csv.gz", 1.5, 6.0)
    cut_csv(nanobench / "B2_circle_fast_rep2.csv.gz", "nanobench_end.csv.gz", -5.0, 6.0)
    cut_csv(nanobench / "B9_trefoil_slow_rep12.csv.gz", "nanobench_no_commands.csv.gz", 2.2, 2.5)
    for kind in ("controller", "motor"):
        source = sorted((crazypad / f"{kind}_data" / "normal_flight").iterdir())[0]
        cut_card(source, f"crazypad_{kind}.usd.gz", 3.0, 8.0)


if __name__ == "__main__":
    main()
