"""Readers and writers of ground truth as other packages have them, in a few lines each where these are large: the steps
are theirs."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def torchvision_flo(path: Path) -> Array:
    """(rows, columns, 2): torchvision.datasets._optical_flow._read_flo."""
    with path.open("rb") as file:
        assert file.read(4) == b"PIEH"
        columns, rows = (int(np.fromfile(file, "<i4", 1)[0]) for _ in range(2))
        return np.fromfile(file, "<f4", 2 * columns * rows).reshape(rows, columns, 2)


def torchvision_kitti_flow(path: Path) -> tuple[Array, Array]:
    """Flow and mask: torchvision.datasets._optical_flow._read_16_bits_png_with_flow_and_valid_mask, RGB by libpng."""
    content = imagecodecs.png_decode(path.read_bytes()).astype(np.int32)
    return (content[..., :2].astype(np.float32) - 2**15) / 64, content[..., 2].astype(bool)


def torchvision_pfm(path: Path, channels: int) -> Array:
    """(rows, columns, channels): torchvision.datasets.utils._read_pfm, of which flow is 2 channels."""
    with path.open("rb") as file:
        kind = file.readline().rstrip()
        size = re.match(rb"^(\d+)\s(\d+)\s$", file.readline())
        assert kind in (b"PF", b"Pf")
        assert size is not None
        columns, rows = (int(number) for number in size.groups())
        order = "<" if float(file.readline().rstrip()) < 0 else ">"
        data = np.fromfile(file, f"{order}f4").reshape(rows, columns, 3 if kind == b"PF" else 1)
    return np.flip(data, axis=0)[..., :channels]


def dpt_bytes(meters: Array) -> bytes:
    """The file that depth_write of Sintel's SDK makes of a depth (rows, columns), m."""
    rows, columns = meters.shape
    return struct.pack("<4sii", b"PIEH", columns, rows) + meters.astype("<f4").tobytes()
