"""Reader of TIFF pages by tifffile, called by `run_decoder`, with limits, because no header bounds its memory."""

from __future__ import annotations

import logging
from typing import Any, BinaryIO

import numpy as np
import tifffile
from numpy.typing import NDArray
from tifffile import TiffPage

from clsco.files.tags import tiff_tags

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # its findings are reported once, as an error


def header(file: BinaryIO) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Read the tags of a TIFF's first page, the number of its pages, and the bytes of the page's color profile."""
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages[0]
        assert isinstance(page, TiffPage)  # the first one always is
        tags = tiff_tags(page.tags)
        return {
            "pages": len(tiff.pages),
            "columns": int(page.imagewidth),
            "rows": int(page.imagelength),
            "planes": int(page.imagedepth),
            "samples": int(page.samplesperpixel),
            "extra": len(page.extrasamples),
            "bits": page.bitspersample if isinstance(page.bitspersample, int) else 0,
            "photometric": str(getattr(page.photometric, "name", page.photometric)),
            "orientation": tags.orientation,
        }, [np.frombuffer(tags.icc, np.uint8)]


def pixels(file: BinaryIO) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """The only page of a TIFF, (rows, columns[, samples]) as stored."""
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages[0]
        assert isinstance(page, TiffPage)
        data = page.asarray()
        return {}, [np.moveaxis(data, 0, 2) if page.axes == "SYX" else data]
