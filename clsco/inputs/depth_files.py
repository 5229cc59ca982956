"""Files of depth maps: PNG, TIFF, EXR, PFM, NPY, NPZ to arrays."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.files.atomic import refuse
from clsco.files.bounded import member_array, npy_header, open_archive, open_member
from clsco.files.decoders import IMAGE_FORMATS, check_limits, checked_size, codec, decoded, exr_parts, opened

Array = NDArray[np.float64]
MOST_ARRAYS = 256  # in an NPZ

DEPTH_FORMATS = {suffix: kind for suffix, kind in IMAGE_FORMATS.items() if kind != "JPEG"} | {".npz": "NPZ"}


def read_depth(path: str | os.PathLike[str]) -> Array:
    """Read the numbers of a depth file as it stores them; their meaning is for `inverse_depth`.

    PNG (8 or 16 bits; fewer bits become 8), TIFF (integers or floats), PFM, NPY, NPZ (the array `depth`, or
    the only one with two dimensions) and EXR (the channel Z; else that of a layer called depth; else any other
    Z or V, but no third component of a vector; else R G B or Y; else the only channel there is). Three equal
    channels count as one. The scale of a PFM is not applied, as in the readers of Middlebury's files.
    TIFF and 16-bit color PNG need the extra `formats`, EXR needs `exr`.
    Returns (rows, columns), float64, row 0 on top, any value: zero, negative, NaN and infinite ones too.
    Raises ImageError, in one line, for all that is not exactly one such map: no readable file, wrong
    extension, damaged, over 2^27 pixels or 65536 a side (refused from the header), channels that differ.
    Validated against files written by imagecodecs, Pillow, OpenCV, tifffile, OpenEXR and NumPy, and by hand.
    """
    with opened(path, DEPTH_FORMATS) as (file, kind):
        if kind == "EXR":
            data = _decode_exr(file)
        elif kind == "NPZ":
            data = _decode_npz(file)
        else:
            data = decoded(file, kind)
        return _single_channel(file, data)


def _single_channel(file: BinaryIO, data: NDArray[Any]) -> Array:
    """Take one of three equal channels, and turn numbers of any type into float64."""
    path = Path(file.name)
    if data.dtype.kind not in "iuf":
        refuse(path, "values must be integers or floats", data.dtype)
    if data.ndim == 3 and data.shape[2] == 3:
        first = data[..., :1]
        differ = ((data != first) & ~(np.isnan(data) & np.isnan(first))).any(axis=2)
        if differ.any():
            row, column = (int(index) for index in np.unravel_index(int(differ.argmax()), differ.shape))
            got = f"{data[row, column].tolist()} at row {row}, column {column} ({int(differ.sum())} in all)"
            refuse(path, "must hold one depth per pixel: red, green and blue must be equal", got)
        data = data[..., 0]
    if data.ndim != 2:
        refuse(path, "shape must be (rows, columns)", data.shape)
    return np.ascontiguousarray(data, np.float64)


def _decode_exr(file: BinaryIO) -> NDArray[Any]:
    path = Path(file.name)
    columns, rows = checked_size(file, "EXR")
    parts, exr = exr_parts(file), codec(path, "OpenEXR", "exr")
    count = sum(len(part.header["channels"]) for part in parts)
    pages = exr.File(str(path), separate_channels=True).parts
    if len(pages) != len(parts):  # a part that cannot be decoded is left out by the library
        raise ValueError(f"{len(pages)} readable parts of {len(parts)}")
    channels = {name: channel.pixels for page in pages for name, channel in page.channels.items()}
    if len(channels) < count:
        refuse(path, "the channels of an EXR must have different names", _names(list(channels)))
    wanted = _depth_channels(list(channels))
    if not wanted:
        rule = "an EXR must hold one depth: a channel Z, V, R or Y, or Z or V of a layer"
        refuse(path, rule, _names(list(channels)))
    data: NDArray[Any] = channels[wanted[0]]
    if data.shape != (rows, columns):
        raise ValueError(f"channel {_names(wanted[:1])} of shape {data.shape}")
    if any(not np.array_equal(data, channels[name], equal_nan=data.dtype.kind == "f") for name in wanted[1:]):
        refuse(path, "an EXR must hold one depth, or equal ones", f"channels {_names(wanted)} that differ")
    return data


def _depth_channels(names: list[str]) -> list[str]:
    """The channels that are equally likely to be the depth: the best of the kinds that are there."""

    def parts(name: str) -> tuple[str, str]:
        layer, _, last = name.rpartition(".")
        return layer, last

    def is_value(name: str) -> bool:
        layer, last = parts(name)
        prefix = layer + "." if layer else ""
        return last in ("Z", "V") and not {f"{prefix}X", f"{prefix}Y"} <= set(names)

    kinds = (
        [name for name in names if name == "Z" and is_value(name)],
        [
            name
            for name in names
            if parts(name)[1].lower() == "depth" or (is_value(name) and "depth" in parts(name)[0].lower().split("."))
        ],
        [name for name in names if is_value(name)],
        [name for name in names if name in ("R", "G", "B")],
        [name for name in names if name == "Y"],
        names if len(names) == 1 else [],
    )
    return next((kind for kind in kinds if kind), [])


def _names(names: list[str]) -> str:
    shown = [name if name.isprintable() else ascii(name) for name in sorted(names)[:20]]
    return " ".join(shown) + (f" and {len(names) - 20} more" if len(names) > 20 else "")


def _decode_npz(file: BinaryIO) -> NDArray[Any]:
    path = Path(file.name)
    with open_archive(file) as archive:
        names = (name for name in archive.namelist() if name.endswith(".npy"))
        found = {name.removesuffix(".npy"): name for name in islice(names, MOST_ARRAYS + 1)}
        if "depth.npy" in archive.NameToInfo:
            found = {"depth": "depth.npy"}
        elif len(found) > MOST_ARRAYS:
            refuse(path, f"an NPZ must hold an array depth, or at most {MOST_ARRAYS} arrays", "more")
        headers = {}
        for name, entry in found.items():
            with open_member(archive, entry) as member:
                headers[name] = npy_header(member)
        flat = [name for name, header in headers.items() if len(header.shape) == 2 or name == "depth"]
        if len(flat) != 1:
            rule = "an NPZ must hold an array depth, or one array with two dimensions"
            refuse(path, rule, f"arrays {_names(flat)}" if flat else "none")
        header = headers[flat[0]]
        shape, dtype = header.shape, header.dtype
        if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)) or dtype.kind not in "iuf":
            rule = f"array {_names(flat)} must hold numbers of shape (rows, columns)"
            refuse(path, rule, f"{dtype} of shape {shape}")
        check_limits(path, shape[1], shape[0])
        return member_array(archive, found[flat[0]], header)
