"""Reader of named arrays in untrusted NPZ and EXR files, whose headers limit the bytes that are read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clsco.files.archives import member_array, npy_header, open_archive, open_member
from clsco.files.atomic import raise_file_error
from clsco.files.decoders import check_limits, exr_planes, open_format


def read_npz(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.floating]]:
    """Read arrays of floats (rows, columns[, 2 or 3]) of at most 2^27 pixels from an NPZ. Raises FileError."""
    with open_format(path, {".npz": "NPZ"}) as (file, _), open_archive(file) as archive:
        arrays = {}
        for name in names:
            if f"{name}.npy" not in archive.NameToInfo:
                raise_file_error(path, f"must hold the array {name}", "none of this name")
            with open_member(archive, f"{name}.npy") as member:
                header = npy_header(member)
            shape, dtype = header.shape, header.dtype
            if len(shape) not in (2, 3) or shape[2:] not in ((), (2,), (3,)) or dtype.kind != "f" or dtype.itemsize > 8:
                rule = f"array {name} must hold floats of shape (rows, columns[, 2 or 3])"
                raise_file_error(path, rule, f"{dtype} of shape {shape}")
            check_limits(path, shape[1], shape[0])
            arrays[name] = member_array(archive, f"{name}.npy", header)
        return arrays


def read_exr(path: Path, names: Sequence[str], view: str = "") -> list[NDArray[np.floating]]:
    """Read channels (rows, columns) of floats from an EXR, or from one of its views. Raises FileError."""
    own = [f"{view}.{name}" if view else name for name in names]

    def choose(there: list[str]) -> list[str]:
        if lost := [name for name, full in zip(names, own, strict=True) if full not in there]:
            raise_file_error(
                path, f"must hold the channel {lost[0]}", f"none of this name{f' in the view {view}' if view else ''}"
            )
        return own

    with open_format(path, {".exr": "EXR"}) as (file, _):
        planes = list(exr_planes(file, choose, np.nan).values())
    for name, plane in zip(names, planes, strict=True):
        if plane.dtype.kind != "f":
            raise_file_error(path, f"channel {name} must hold floats", plane.dtype)
    return planes
