"""Decoders of image files: check the extension, the first bytes and the size in the header, then decode."""

from __future__ import annotations

import contextlib
import math
import os
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ClscoError, import_extra, require_extra
from clsco.files.archives import image_shape, npy_header
from clsco.files.atomic import AnyPath, raise_file_error
from clsco.files.decoder_process import run_decoder
from clsco.files.layers import full_names, image_channels, list_names
from clsco.files.png import GRAY, PALETTE, SIGNATURE, check_png, png_size
from clsco.files.tags import Tags, jpeg_segments, jpeg_tags, png_tags, turn_upright
from clsco.resources import DEVICE, open_regular

MAX_PIXELS = 2**27
MAX_SIDE = 65536
LARGEST_EXR = 2**29  # largest number of values in all channels of an EXR, which are decoded together
DENSEST_EXR = 2**15  # most values per byte of an EXR; DWAB, the densest compression, reaches half of it for one color
MOST_WINDOW = 4  # most pixels in the data window of a part of an EXR, as a multiple of those in the display window
MOST_OVERSCAN = 512  # most pixels beyond each border of the display window that are read, the largest blur radius
LONGEST_PFM = 256  # largest header of a PFM, bytes
MOST_SCANS = 100  # most scans of a JPEG, each of which processes all pixels; encoders make about 20 at most
PIXEL_BYTES = 32  # largest size of a file per pixel: four float64
MOST_TAG = 2**24  # largest color profile read from a TIFF, bytes; profiles above LARGEST_PROFILE are rejected later
OTHER_BYTES = 2**26  # largest size of a file besides its pixels

IMAGE_FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".exr": "EXR",
    ".pfm": "PFM",
    ".npy": "NPY",
}
_FIRST_BYTES = {
    "PNG": (SIGNATURE,),
    "JPEG": (b"\xff\xd8\xff",),
    "TIFF": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    "EXR": (b"v/1\x01",),
    "PFM": (b"PF", b"Pf"),
    "NPY": (b"\x93NUMPY",),
    "NPZ": (b"PK\x03\x04",),
    "DPT": (b"PIEH",),
}


_DECODED: ContextVar[dict[str, Any] | None] = ContextVar("decoded", default=None)


@contextlib.contextmanager
def decode_once() -> Iterator[None]:
    """Decode an EXR once in the block if its layers are read one after another."""
    token = _DECODED.set({})
    try:
        yield
    finally:
        _DECODED.reset(token)


@contextlib.contextmanager
def open_format(path: AnyPath, formats: Mapping[str, str] = IMAGE_FORMATS) -> Iterator[tuple[BinaryIO, str]]:
    """Open a file whose extension and first bytes agree on a format; yields it, at its first byte, and the format.

    Errors of the file or of a codec, also those raised in the body of the `with` statement, become FileError.
    """
    path = Path(path)
    kind = formats.get(path.suffix.lower(), "")
    try:
        with open_regular(path, follow=True) as file:
            if not kind:
                raise_file_error(path, f"the extension must be one of {' '.join(formats)}", repr(path.suffix))
            head = file.read(8)
            if not head.startswith(_FIRST_BYTES[kind]):
                content = next((name for name, first in _FIRST_BYTES.items() if head.startswith(first)), None)
                got = content or (f"the first bytes {head!r}" if head else "an empty file")
                raise_file_error(path, f"the content must be {kind}, as the extension says", got)
            file.seek(0)
            yield file, kind
    except ClscoError:
        raise
    except OSError as error:
        if error.strerror == DEVICE or isinstance(error, IsADirectoryError):
            raise_file_error(path, "must be an image file", DEVICE if error.strerror == DEVICE else "a folder")
        rule = "must be a file that can be read" if error.errno else f"must be a whole {kind}"
        raise_file_error(path, rule, error, error)
    except Exception as error:  # damage: each codec has exceptions of its own, and none documents them all
        raise_file_error(path, f"must be a whole {kind}", error, error)


def path_of(file: BinaryIO) -> Path:
    return Path(file.name)


def unzstd(path: Path, content: bytes, most: int) -> memoryview:
    """Decompress a Zstandard frame of at most `most` bytes. Raises an error of imagecodecs if it has more."""
    unpacked = np.empty(most, np.uint8)  # the system allocates its pages only when they are written
    return memoryview(import_extra(path, "imagecodecs", "formats").zstd_decode(content, out=unpacked.data))


def read_size(file: BinaryIO, kind: str) -> tuple[int, int]:
    """Columns and rows of the upright image, from an open file's header; rewinds the file. Raises as `image_size`."""
    columns, rows = _stored_size(file, kind)
    lies_on_side = read_tags(file, kind).orientation >= 5  # stored rows are columns of the upright image
    return (rows, columns) if lies_on_side else (columns, rows)


def _stored_size(file: BinaryIO, kind: str) -> tuple[int, int]:
    columns, rows = _CODECS[kind][0](file)
    file.seek(0)
    check_limits(path_of(file), columns, rows)
    size, most = os.fstat(file.fileno()).st_size, PIXEL_BYTES * columns * rows + OTHER_BYTES
    if size > most and kind != "EXR":  # an EXR may hold many layers
        raise_file_error(path_of(file), f"a file of {columns} x {rows} pixels must have at most {most} bytes", size)
    return columns, rows


def read_tags(file: BinaryIO, kind: str) -> Tags:
    """Read the tags of an open file; rewinds the file."""
    file.seek(0)
    file_tags = _TAGS.get(kind, lambda _: Tags())(file)
    file.seek(0)
    return file_tags


def check_limits(path: Path, columns: int, rows: int) -> None:
    """Raise FileError for an empty image, or one of over 2^27 pixels or 65536 a side."""
    if not (1 <= columns <= MAX_SIDE and 1 <= rows <= MAX_SIDE and columns * rows <= MAX_PIXELS):
        rule = f"columns and rows must be from 1 to {MAX_SIDE}, and at most {MAX_PIXELS} pixels"
        raise_file_error(path, rule, f"{columns} x {rows}")


def decode_file(file: BinaryIO, kind: str, layer: str | None = None, whole: bool = False) -> NDArray[Any]:
    """Decode an open file within the limits; returns stored values (rows, columns[, channels]), turned upright.

    layer: layer of an EXR, as for `clsco.files.layers.image_channels`. whole: True for the alpha of PNG and EXR as the
    last channel, and for the overscan of an EXR (`exr_planes`). `open_format` turns errors into FileError.
    """
    columns, rows = _stored_size(file, kind)
    orientation = read_tags(file, kind).orientation
    if layer is not None and kind != "EXR":
        raise_file_error(path_of(file), f"only an EXR has layers, such as {list_names([layer])}", kind)
    data: NDArray[Any] = _decode_exr(file, layer, whole) if kind == "EXR" else _CODECS[kind][1](file)
    if data.shape[:2] != (rows, columns) and not (whole and kind == "EXR"):
        raise ValueError(f"{data.shape[1]} x {data.shape[0]} pixels under a header of {columns} x {rows}")
    if data.ndim == 3 and data.shape[2] in (2, 4) and not whole:
        data = _without_alpha(file, data)
    return turn_upright(data, orientation)


def _without_alpha(file: BinaryIO, data: NDArray[Any]) -> NDArray[Any]:
    """Drop the last channel if it is opaque everywhere; gray with such alpha becomes (rows, columns)."""
    alpha = data[..., -1]
    seen_through = alpha != (1 if alpha.dtype.kind == "f" else np.iinfo(alpha.dtype).max)
    if seen_through.any():
        rule = "alpha must be opaque everywhere, except for clsco defocus --layer"
        raise_file_error(path_of(file), rule, f"{int(seen_through.sum())} other pixels")
    return data[..., 0] if data.shape[2] == 2 else data[..., :-1]


def _decode_png(file: BinaryIO) -> NDArray[Any]:
    png, depth, color, transparency = check_png(file)
    if depth == 16 and color != GRAY:  # Pillow silently drops the lower 8 bits
        data = import_extra(path_of(file), "imagecodecs", "formats").png_decode(png)
    else:
        data = _by_imageio(png, ".png")
    if data.dtype == bool:
        data = data.astype(np.uint8) * np.uint8(255)
    if transparency is not None and (count := _keyed(png, data, depth, color, transparency)):
        raise_file_error(path_of(file), "pixels must be opaque", f"{count} of a transparent color (chunk tRNS)")
    return data


def _keyed(png: bytes, data: NDArray[Any], depth: int, color: int, transparency: bytes) -> int:
    """Count the pixels of a PNG whose color its chunk tRNS makes transparent."""
    if color == PALETTE:
        seen_through = np.frombuffer(transparency.ljust(256, b"\xff")[:256], np.uint8) < 255
        return int(seen_through[_by_imageio(png, ".png", mode="P")].sum()) if seen_through.any() else 0
    samples = np.array(struct.unpack(">H" if color == GRAY else ">HHH", transparency)) & (2**depth - 1)
    key = samples * (255 // (2**depth - 1)) if depth < 8 else samples
    return int((data == key[0] if color == GRAY else (data == key).all(axis=-1)).sum())


def _by_imageio(content: bytes, extension: str, mode: str | None = None) -> NDArray[Any]:
    import imageio.v3  # 75 ms, and most commands read no image

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Image size")  # our own limit has been checked from the header
        options: dict[str, Any] = {"mode": mode, "writeable_output": False}  # otherwise imageio makes another copy
        return imageio.v3.imread(content, plugin="pillow", extension=extension, **options)


def _jpeg_size(file: BinaryIO) -> tuple[int, int]:
    for kind, body in jpeg_segments(file):
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            rows, columns = struct.unpack(">HH", body[1:5])
            return columns, rows
    raise ValueError("no frame header")


def _scans(content: bytes) -> int:
    """Number of scans of a JPEG. For a scan of a few bytes, a decoder may have to process all pixels again."""
    scans, at, mark = 0, 2, re.compile(rb"\xff+([\x01-\xcf\xd8-\xfe])")  # markers that do not occur within a scan
    while (match := mark.search(content, at)) is not None and match[1] != b"\xd9":
        scans += match[1] == b"\xda"
        at = match.end() + int.from_bytes(content[match.end() : match.end() + 2], "big")
    return scans


def _decode_jpeg(file: BinaryIO) -> NDArray[Any]:
    content = file.read()
    if (scans := _scans(content)) > MOST_SCANS:
        raise_file_error(path_of(file), f"a JPEG must have at most {MOST_SCANS} scans", scans)
    data: NDArray[Any] = _by_imageio(content, ".jpg")
    if data.ndim == 3 and data.shape[2] == 4:
        raise_file_error(path_of(file), "a JPEG must be gray or RGB", "CMYK")
    return data


def _tiff_header(file: BinaryIO) -> tuple[dict[str, Any], bytes]:
    """Tags of a TIFF's page, and its color profile."""
    require_extra(path_of(file), "tifffile", "formats")
    header, (profile,) = run_decoder("clsco.files.tiff:header", file, MOST_TAG)
    if header["pages"] != 1:
        raise_file_error(path_of(file), "must be a single image", f"{header['pages']} pages")
    return header, profile.tobytes()


def _tiff_tags(file: BinaryIO) -> Tags:
    header, profile = _tiff_header(file)
    return Tags(header["orientation"], profile)


def _decode_tiff(file: BinaryIO) -> NDArray[Any]:
    header, _ = _tiff_header(file)
    samples, extra, bits = header["samples"], header["extra"], header["bits"]
    kind = (header["photometric"], samples - extra)
    if kind not in (("MINISBLACK", 1), ("RGB", 3)) or extra > 1 or header["planes"] != 1:
        got = f"{kind[0]} with {samples} samples per pixel"
        raise_file_error(path_of(file), "a TIFF must be gray (0 is black) or RGB, with at most an alpha channel", got)
    if bits not in (8, 16, 32, 64):
        raise_file_error(path_of(file), "a TIFF must have 8 or 16 bits, or floats", f"{bits} bits")
    most = header["columns"] * header["rows"] * samples * bits // 8
    data = run_decoder("clsco.files.tiff:pixels", file, most)[1][0]
    return _without_alpha(file, data) if extra else data


def exr_parts(file: BinaryIO) -> Sequence[Any]:
    """Headers of the parts of an EXR. Raises FileError if the parts, which are decoded together, are too large."""
    parts: Sequence[Any] = import_extra(path_of(file), "OpenEXR", "exr").File(str(file.name), header_only=True).parts
    values, layers = 0, list[str]()
    width, height = _window(parts[0].header["displayWindow"])  # the same for all parts
    check_limits(path_of(file), width, height)
    for part in parts:
        columns, rows = _window(part.header["dataWindow"])
        check_limits(path_of(file), columns, rows)
        if columns * rows > MOST_WINDOW * max(width * height, 1):
            rule = f"a data window must have at most {MOST_WINDOW} times the pixels of the display window"
            raise_file_error(path_of(file), rule, f"{columns} x {rows} of {width} x {height}")
        if "deep" in str(part.header.get("type", "")).lower():
            raise_file_error(path_of(file), "an EXR must not be deep", part.header["type"])
        values += len(part.header["channels"]) * columns * rows
        layers.append(f"{len(part.header['channels'])} channels of {columns} x {rows}")
    if values > LARGEST_EXR:
        raise_file_error(path_of(file), f"an EXR must hold at most {LARGEST_EXR} values", " and ".join(layers[:3]))
    if (size := os.fstat(file.fileno()).st_size) * DENSEST_EXR < values:
        raise ValueError(f"{size} bytes of {' and '.join(layers[:3])}")
    return parts


def _exr_tags(file: BinaryIO) -> Tags:
    named = (part.header["chromaticities"] for part in exr_parts(file) if "chromaticities" in part.header)
    return Tags(chromaticities=tuple(next(named, ())))  # the same for all parts


def _window(corners: Sequence[Any]) -> tuple[int, int]:
    (left, top), (right, bottom) = (corner.tolist() for corner in corners)
    return right - left + 1, bottom - top + 1


def exr_planes(
    file: BinaryIO, choose: Callable[[list[str]], list[str]], outside: float, overscan: bool = False
) -> dict[str, NDArray[Any]]:
    """Decode channels of an EXR, which may be in several parts: (rows, columns) of the display window, by name.

    choose: function that takes the names of all channels, and returns the names of those to decode. outside: value of
    pixels outside of the data window. overscan: True to extend the planes as far as a data window extends beyond a
    border of the display window, but equally on opposite sides, where the planes are mirrored if they have no data.
    """
    parts, path = exr_parts(file), path_of(file)
    named = full_names(
        [(str(part.header.get("name", "")), [c.name for c in part.header["channels"]]) for part in parts]
    )
    chosen = choose([name for names in named for name in names.values()])
    decoded = {} if (shared := _DECODED.get()) is None else shared
    if str(path) not in decoded:
        decoded.clear()
        decoded[str(path)] = import_extra(path, "OpenEXR", "exr").File(str(path), separate_channels=True).parts
    pages = decoded[str(path)]
    if len(pages) != len(parts):  # OpenEXR omits parts that it cannot decode
        raise ValueError(f"{len(pages)} readable parts of {len(parts)}")
    planes = {}
    used = [part for part, names in zip(parts, named, strict=True) if {*names.values()} & {*chosen}]
    margin = _overscan(used) if overscan else (0, 0)
    for part, names, page in zip(parts, named, pages, strict=True):
        for own, name in names.items():
            if name in chosen:
                plane = page.channels[own].pixels
                if plane.shape != _window(part.header["dataWindow"])[::-1]:
                    raise ValueError(f"channel {list_names([name])} of shape {plane.shape}")
                planes[name] = _in_display(part.header, plane, outside, margin)
    return {name: planes[name] for name in chosen}


def _sides(header: Mapping[str, Any]) -> list[tuple[int, int, int, int]]:
    """First and last row of the display window and of the data window, and the same of the columns."""
    corners = [corner.tolist() for window in ("displayWindow", "dataWindow") for corner in header[window]]
    (left, top), (right, bottom), (first, above), (last, below) = corners
    return [(top, bottom, above, below), (left, right, first, last)]


def _overscan(parts: Sequence[Any]) -> tuple[int, int]:
    """Rows and columns by which data windows extend at most beyond a border of the display window."""
    beyond = [[max(a - first, last - b, 0) for a, b, first, last in _sides(part.header)] for part in parts]
    rows, columns = (min(max(side), MOST_OVERSCAN) for side in zip(*beyond, strict=True))
    return rows, columns


def mirrored(at: NDArray[np.intp], length: int) -> NDArray[np.intp]:
    """Indices into an array of a length that is continued by its mirror images."""
    at = at % (2 * length)
    return np.minimum(at, 2 * length - 1 - at)


def _in_display(
    header: Mapping[str, Any], plane: NDArray[Any], outside: float, margin: tuple[int, int]
) -> NDArray[Any]:  # fmt: skip
    """A plane of the data window, cropped and padded with `outside` to the display window, and extended by a margin."""
    for axis, ((a, b, first, last), more) in enumerate(zip(_sides(header), margin, strict=True)):
        if (a - more, b + more) == (first, last):
            continue
        begin, end = min(a, max(first, a - more)), max(b, min(last, b + more)) + 1  # display window and overscan
        at = begin + mirrored(np.arange(a - more, b + more + 1) - begin, end - begin)
        plane = plane.take(np.clip(at - first, 0, last - first), axis)
        if (beyond := (at < first) | (at > last)).any():
            plane = plane if plane.dtype.kind == "f" else plane.astype(np.float64)
            np.moveaxis(plane, axis, 0)[beyond] = outside
    return plane


def _decode_exr(file: BinaryIO, layer: str | None = None, whole: bool = False) -> NDArray[Any]:
    def choose(names: list[str]) -> list[str]:
        try:
            return image_channels(names, layer)
        except LookupError as error:
            rule, got = error.args
            raise_file_error(path_of(file), rule, got)

    planes = exr_planes(file, choose, 0.0, whole)
    for name, plane in planes.items():
        if plane.dtype.kind != "f":
            raise_file_error(path_of(file), "EXR pixels must be floats", f"{plane.dtype} in {list_names([name])}")
    data = np.stack(list(planes.values()), axis=-1)
    return data[..., 0] if len(planes) == 1 else data


def _pfm_header(file: BinaryIO) -> tuple[int, int, int, float]:
    """Header of a PFM: channels, columns, rows, and the scale whose sign is the byte order."""
    head = file.read(LONGEST_PFM)
    match = re.match(rb"(P[Ff])\s+(\S{1,40})\s+(\S{1,40})\s+(\S{1,40})\s", head)
    if match is None:
        raise ValueError(f"a header of {head[:32]!r}")
    file.seek(match.end())
    return (3 if match[1] == b"PF" else 1), int(match[2]), int(match[3]), float(match[4])


def _decode_pfm(file: BinaryIO) -> NDArray[Any]:
    channels, columns, rows, scale = _pfm_header(file)
    needed, there = 4 * channels * columns * rows, os.fstat(file.fileno()).st_size - file.tell()
    if there != needed:
        raise ValueError(f"{there} bytes of {columns} x {rows} x {channels} float32 pixels")
    data = np.frombuffer(file.read(needed), "<f4" if scale < 0 else ">f4").reshape(rows, columns, channels)[::-1]
    return data[..., 0] if channels == 1 else data


def _npy_size(file: BinaryIO) -> tuple[int, int]:
    shape, _fortran, dtype, start = npy_header(file)
    flat = image_shape(shape)
    if len(flat) not in (2, 3) or (len(flat) == 3 and flat[2] != 3) or dtype.kind not in "biuf":
        rule = "an NPY must hold numbers of shape (rows, columns) or (rows, columns, 3)"
        raise_file_error(path_of(file), rule, f"{dtype} of shape {shape}")
    check_limits(path_of(file), flat[1], flat[0])
    needed, size = start + math.prod(shape) * dtype.itemsize, os.fstat(file.fileno()).st_size
    if size < needed:  # checked before memory is allocated
        raise ValueError(f"{size} bytes of {needed}")
    return flat[1], flat[0]


def _decode_npy(file: BinaryIO) -> NDArray[Any]:
    data: NDArray[Any] = np.load(file, allow_pickle=False)
    return data.reshape(image_shape(data.shape))


_CODECS = {
    "PNG": (png_size, _decode_png),
    "JPEG": (_jpeg_size, _decode_jpeg),
    "TIFF": (lambda file: tuple(_tiff_header(file)[0][name] for name in ("columns", "rows")), _decode_tiff),
    "EXR": (lambda file: _window(exr_parts(file)[0].header["displayWindow"]), _decode_exr),
    "PFM": (lambda file: _pfm_header(file)[1:3], _decode_pfm),
    "NPY": (_npy_size, _decode_npy),
}
_TAGS = {"PNG": png_tags, "JPEG": jpeg_tags, "TIFF": _tiff_tags, "EXR": _exr_tags}
