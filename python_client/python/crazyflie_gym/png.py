"""Pictures as PNG files, without a picture library."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def save_png(path: str | os.PathLike[str], picture: NDArray[np.uint8]) -> None:
    """Write a picture, uint8 (height, width, 3) as `render` returns it, to a PNG file.

    Raises:
        ValueError: for another shape or dtype.
        OSError: if the file cannot be written.
    """
    Path(path).write_bytes(png_bytes(picture))


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture, uint8 (height, width, 3), as the content of a PNG file.

    Raises:
        ValueError: for another shape or dtype.
    """
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise ValueError(f"picture: expected uint8 (height, width, 3), got {picture.dtype} {picture.shape}")
    height, width, _ = picture.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    # every row is preceded by its filter: 0, none
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = picture.reshape(height, 3 * width)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes())) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body
