"""Reader of Zarr groups by zarr, called in a process with limits (`run_decoder`) because no header bounds its
memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zarr
from numpy.typing import NDArray


def index(file: BinaryIO) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Numbers of all records, the start and end of each description, and the bytes of all descriptions."""
    return arrays(file, slice(None), ("keys", "meta_ends", "meta"))


def arrays(file: BinaryIO, row: int | slice, names: Sequence[str]) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Arrays of a record; file: `zarr.json` of the group."""
    group = zarr.open_group(Path(file.name).parent, mode="r", zarr_format=3, use_consolidated=False)
    return {}, [np.asarray(group[name][row]) for name in names]  # type: ignore[index]
