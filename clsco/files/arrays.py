"""Arrays by name from NPZ and EXR files, which strangers may have made: headers limit what is read."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.atomic import refuse
from clsco.files.decoders import LARGEST_EXR, check_limits, codec, opened


def read_npz(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.floating]]:
    """Read arrays of floats (rows, columns[, 2 or 3]) from an NPZ.

    Raises ImageError where one is not there, is no such array, or has over 2^27 pixels.
    """
    with opened(path, {".npz": "NPZ"}) as (file, _), zipfile.ZipFile(file) as archive:
        found = {}
        for name in names:
            if f"{name}.npy" not in archive.NameToInfo:
                refuse(path, f"must hold the array {name}", "none of this name")
            shape, dtype = npy_header(archive, f"{name}.npy")
            if len(shape) not in (2, 3) or shape[2:] not in ((), (2,), (3,)) or dtype.kind != "f" or dtype.itemsize > 8:
                rule = f"array {name} must hold floats of shape (rows, columns[, 2 or 3])"
                refuse(path, rule, f"{dtype} of shape {shape}")
            check_limits(path, shape[1], shape[0])
            with archive.open(f"{name}.npy") as member:
                found[name] = np.lib.format.read_array(member, allow_pickle=False)
                if member.read(1):  # the archive checks its sum at the end alone
                    raise ValueError("bytes after the array")
        return found


def npy_header(archive: zipfile.ZipFile, entry: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array in an NPZ, from its header alone."""
    with archive.open(entry) as member:
        version = np.lib.format.read_magic(member)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _fortran, dtype = read_header(member)
    return shape, dtype


def read_exr(path: Path, names: Sequence[str], view: str = "") -> list[NDArray[np.floating]]:
    """Read channels (rows, columns) of floats from an EXR, of one with several views those of `view`.

    Raises ImageError where one is not there or holds no floats, and for over 2^27 pixels or 2^29 values in all.
    """
    with opened(path, {".exr": "EXR"}):
        exr = codec(path, "OpenEXR", "exr")
        values, parts = 0, exr.File(str(path), header_only=True).parts
        for part in parts:
            (left, top), (right, bottom) = (corner.tolist() for corner in part.header["dataWindow"])
            check_limits(path, right - left + 1, bottom - top + 1)
            values += (right - left + 1) * (bottom - top + 1) * len(part.header["channels"])
        if values > LARGEST_EXR:
            refuse(path, f"an EXR must hold at most {LARGEST_EXR} values", values)
        pages = exr.File(str(path), separate_channels=True).parts
        if len(pages) != len(parts):  # a part that cannot be decoded is left out by the library
            raise ValueError(f"{len(pages)} readable parts of {len(parts)}")
        chosen = [page for page in pages if not view or page.header.get("view") == view]
        if len(chosen) != 1:
            refuse(path, f"must hold one view {view}".rstrip(), f"{len(chosen)} of {len(pages)} parts")
        channels = {name: channel.pixels for name, channel in chosen[0].channels.items()}
        for name in names:
            if name not in channels:
                refuse(path, f"must hold the channel {name}", "none of this name")
            if channels[name].dtype.kind != "f":
                refuse(path, f"channel {name} must hold floats", channels[name].dtype)
        if len({channels[name].shape for name in names}) > 1:
            refuse(path, f"channels {' '.join(names)} must have one size", [channels[name].shape for name in names])
        return [channels[name] for name in names]
