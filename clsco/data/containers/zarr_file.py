"""Reader of Zarr groups by zarr, called in a process with limits (`run_decoder`), as no header bounds its memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zarr

from clsco.files.decoder_process import Output


def index(file: BinaryIO) -> Output:
    """Numbers of all records, offsets at which descriptions begin and end, and the bytes of all descriptions."""
    return arrays(file, slice(None), ("keys", "meta_ends", "meta"))


def arrays(file: BinaryIO, row: int | slice, names: Sequence[str]) -> Output:
    """Arrays of a record, in the order of `names`; row: index of the record; file: `zarr.json` of the group."""
    group = zarr.open_group(Path(file.name).parent, mode="r", zarr_format=3, use_consolidated=False)
    return {}, [np.asarray(group[name][row]) for name in names]  # type: ignore[index]
