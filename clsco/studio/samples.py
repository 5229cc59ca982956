"""Pictures of samples of the data sets that jobs make."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clsco.files.png import png_parts
from clsco.files.transfer import encode

SMALL = 160  # px of a small picture, at most


def sample_picture(folder: Path, part: int, parts: int) -> bytes:
    """A small PNG of the color of a sample.

    Parameters
    ----------
    folder : Path
    part, parts : int
        The first sample of the part-th of equal parts of the set.

    Raises
    ------
    ClscoError, OSError, IndexError
        There is no such sample.
    """
    from clsco.data import dataset

    opened = dataset.open(folder)
    try:
        record = opened[part * len(opened) // parts]
        name = next(name for name in record.arrays if name.rpartition(".")[2] == "color")  # of the first frame and view
        radiance = record.radiance(name)
    finally:
        opened.close()
    step = max(1, -(-max(radiance.shape[:2]) // SMALL))
    codes = encode(np.ascontiguousarray(radiance[::step, ::step]), 8, "srgb").astype(np.uint8)
    return b"".join(png_parts(codes))
