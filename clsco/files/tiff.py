"""Reader of TIFF pages by tifffile, called by `run_decoder`, with limits, because no header bounds its memory."""

from __future__ import annotations

import logging
from typing import Any, BinaryIO

import numpy as np
import tifffile
from numpy.typing import NDArray

from clsco.files.tags import ORIENTATION

ICC = 0x8773  # number of the tag of a color profile
logging.getLogger("tifffile").addHandler(logging.NullHandler())  # its findings are reported once, as an error


def header(file: BinaryIO) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Read the tags of a TIFF's first page, the number of its pages, and the bytes of the page's color profile."""
    with tifffile.TiffFile(file) as tiff:
        page: Any = tiff.pages[0]
        orientation, icc = page.tags.valueof(ORIENTATION, default=1), page.tags.valueof(ICC, default=b"")
        return {
            "pages": len(tiff.pages),
            "columns": int(page.imagewidth),
            "rows": int(page.imagelength),
            "planes": int(page.imagedepth),
            "samples": int(page.samplesperpixel),
            "extra": len(page.extrasamples),
            "bits": page.bitspersample if isinstance(page.bitspersample, int) else 0,
            "photometric": str(getattr(page.photometric, "name", page.photometric)),
            "orientation": orientation if orientation in range(1, 9) else 1,
        }, [np.frombuffer(icc if isinstance(icc, bytes) else b"", np.uint8)]


def pixels(file: BinaryIO) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """The only page of a TIFF, (rows, columns[, samples]) as stored."""
    with tifffile.TiffFile(file) as tiff:
        page: Any = tiff.pages[0]
        data = page.asarray()
        return {}, [np.moveaxis(data, 0, 2) if page.axes == "SYX" else data]
