"""Reader of depth maps: PNG, JPEG, TIFF, EXR, PFM, NPY, NPZ and DPT files to arrays."""

from __future__ import annotations

import os
import struct
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.files.archives import image_shape, member_array, npy_header, open_archive, open_member
from clsco.files.atomic import raise_file_error
from clsco.files.decoders import IMAGE_FORMATS, check_limits, decode_file, exr_planes, open_format
from clsco.files.layers import depth_channels, image_channels, list_layers, list_names
from clsco.files.ranges import first_of

MOST_ARRAYS = 256  # largest number of arrays in an NPZ file

DEPTH_FORMATS = IMAGE_FORMATS | {".npz": "NPZ", ".dpt": "DPT"}


def read_depth(
    path: str | os.PathLike[str], layer: str | None = None, image: tuple[str, str | None] | None = None
) -> NDArray[Any]:  # fmt: skip
    """Read the numbers of a depth file as stored; `inverse_depth` interprets them.

    Formats: PNG (8 or 16 bits; fewer bits become 8), JPEG, TIFF (integers or floats), PFM, DPT, NPY, NPZ (the array
    `depth`, or the only one with two dimensions) and EXR (a channel of the layer, chosen by
    `clsco.files.layers.depth_channels`; pixels outside of its data window are NaN). Three equal channels count as one.
    The scale in a PFM's header is not applied; readers of Middlebury's files do not apply it either. TIFF and 16-bit
    color PNG need the extra `formats`, EXR needs `exr`. image: file and layer of the map's image, for an EXR with the
    overscan of `clsco.files.images.read_rgba`; if it is the same file, the channels of the image are no depth. Returns
    an array (rows, columns) with row 0 on top, integers as stored or float64, which may include zero, negative numbers,
    NaN and infinity.

    Raises FileError if the file does not hold exactly one depth map: it is unreadable or damaged, has the wrong
    extension, over 2^27 pixels or 65536 a side (rejected from the header), or channels that differ. Validated against
    files written by imagecodecs, Pillow, OpenCV, tifffile, OpenEXR and NumPy, and by hand.
    """
    with open_format(path, DEPTH_FORMATS) as (file, kind):
        if kind == "EXR":
            data = _decode_exr(file, layer, image)
        elif layer is not None:
            raise_file_error(Path(file.name), f"only an EXR has layers, such as {list_names([layer])}", kind)
        elif kind == "NPZ":
            data = _decode_npz(file)
        elif kind == "DPT":
            data = _decode_dpt(file)
        else:
            data = decode_file(file, kind)
        return _single_channel(file, data)


def _single_channel(file: BinaryIO, data: NDArray[Any]) -> NDArray[Any]:
    """Reduce three equal channels to one, and convert floats to float64."""
    path = Path(file.name)
    if data.dtype.kind not in "iuf":
        raise_file_error(path, "values must be integers or floats", data.dtype)
    if data.ndim == 3 and data.shape[2] == 3:
        first = data[..., :1]
        differ = ((data != first) & ~(np.isnan(data) & np.isnan(first))).any(axis=2)
        if differ.any():
            rule = "must hold one depth per pixel: red, green and blue must be equal"
            raise_file_error(path, rule, first_of(data, differ))
        data = data[..., 0]
    if data.ndim != 2:
        raise_file_error(path, "shape must be (rows, columns)", data.shape)
    with np.errstate(invalid="ignore"):  # NaNs of a damaged file may be signaling ones
        return np.ascontiguousarray(data, np.float64 if data.dtype.kind == "f" else data.dtype.newbyteorder("="))


def _decode_exr(file: BinaryIO, layer: str | None, image: tuple[str, str | None] | None) -> NDArray[Any]:
    path = Path(file.name)
    is_image = image is not None and image[0] == str(path)

    def choose(names: list[str]) -> list[str]:
        colors = image_channels(names, image[1]) if image is not None and is_image else ()
        channels = depth_channels(names, layer, colors)
        if not channels:
            rule = "an EXR must hold one depth: a channel Z, V, R or Y, or Z or V of a layer"
            if is_image:
                rule = "an EXR of image and depth must hold a channel Z or Pz, or a layer with depth in its name"
            raise_file_error(path, f"{rule} {list_names([layer])}" if layer else rule, list_layers(names))
        return channels

    first, *others = exr_planes(file, choose, np.nan, overscan=image is not None).items()
    name, data = first
    if any(not np.array_equal(data, plane, equal_nan=data.dtype.kind == "f") for _, plane in others):
        rule = "an EXR must hold one depth, or equal ones, or its layer must be named"
        raise_file_error(path, rule, f"channels {list_names([name, *(other for other, _ in others)])} that differ")
    return data


def _decode_npz(file: BinaryIO) -> NDArray[Any]:
    path = Path(file.name)
    with open_archive(file) as archive:
        names = (name for name in archive.namelist() if name.endswith(".npy"))
        entries = {name.removesuffix(".npy"): name for name in islice(names, MOST_ARRAYS + 1)}
        if "depth.npy" in archive.NameToInfo:
            entries = {"depth": "depth.npy"}
        elif len(entries) > MOST_ARRAYS:
            raise_file_error(path, f"an NPZ must hold an array depth, or at most {MOST_ARRAYS} arrays", "more")
        headers = {}
        for name, entry in entries.items():
            with open_member(archive, entry) as member:
                headers[name] = npy_header(member)
        flat = [name for name, header in headers.items() if len(image_shape(header.shape)) == 2 or name == "depth"]
        if len(flat) != 1:
            rule = "an NPZ must hold an array depth, or one array with two dimensions"
            raise_file_error(path, rule, f"arrays {list_names(flat)}" if flat else "none")
        header = headers[flat[0]]
        shape, dtype = image_shape(header.shape), header.dtype
        if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)) or dtype.kind not in "iuf":
            rule = f"array {list_names(flat)} must hold numbers of shape (rows, columns)"
            raise_file_error(path, rule, f"{dtype} of shape {header.shape}")
        check_limits(path, shape[1], shape[0])
        return member_array(archive, entries[flat[0]], header).reshape(shape)


def _decode_dpt(file: BinaryIO) -> NDArray[Any]:
    """Decode a DPT file of Sintel: a tag (a float), columns, rows, and depths as floats, all little endian."""
    columns, rows = struct.unpack("<4xii", file.read(12))
    check_limits(Path(file.name), columns, rows)
    size, there = 4 * columns * rows, os.fstat(file.fileno()).st_size - 12
    if there != size:
        got = "more" if there > size else f"{there} bytes"
        raise ValueError(f"{got} after a header of {columns} x {rows} pixels, which have {size} bytes")
    return np.frombuffer(file.read(size), "<f4").reshape(rows, columns)
