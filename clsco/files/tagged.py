"""Binary files of Middlebury and Sintel: a tag, which is a float, sizes, and floats after them.

All of it is little endian.
"""

from __future__ import annotations

import os
import struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.files.decoders import check_limits, path_of

TAG = struct.pack("<f", 202021.25)


def read_floats(file: BinaryIO, channels: int) -> NDArray[np.float32]:
    """Read an opened .flo or .dpt file: (rows, columns, channels), for one channel (rows, columns).

    Raises FileError for sizes beyond the limits, ValueError for more or fewer bytes than the header says.
    """
    columns, rows = struct.unpack("<4xii", file.read(12))
    check_limits(path_of(file), columns, rows)
    size, there = 4 * channels * columns * rows, os.fstat(file.fileno()).st_size - 12
    if there != size:
        got = "more" if there > size else f"{there} bytes"
        raise ValueError(f"{got} after a header of {columns} x {rows} pixels, which have {size} bytes")
    shape = (rows, columns) if channels == 1 else (rows, columns, channels)
    return np.frombuffer(file.read(size), "<f4").reshape(shape).astype(np.float32)
