"""Image and ground-truth files, in and out; never computes, and a written file is whole or not there."""

from __future__ import annotations

import contextlib
import importlib
import json
import logging
import os
import stat
import struct
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ImageError
from clsco.files.atomic import refuse, whole_file
from clsco.files.png import GREY, GREY_ALPHA, PALETTE, RGB_ALPHA, SIGNATURE, checked_png, png_parts, png_size

MAX_PIXELS = 2**27
MAX_SIDE = 65536
LARGEST_EXR = 2**29  # values in all channels, which are decoded together
logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what it finds is told as an error, and once

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
}


@dataclass(frozen=True, eq=False)
class Picture:
    """An image as its file stores it: uint8 and uint16 codes, or float32 linear radiance (finite, >= 0).

    data: (rows, columns) grey or (rows, columns, 3) red, green, blue; row 0 on top.
    """

    data: NDArray[Any]

    @property
    def bits(self) -> int:
        """8, 16 or 32 per value."""
        return 8 * self.data.dtype.itemsize

    @property
    def is_float(self) -> bool:
        """Whether the values are linear radiance and no codes."""
        return self.data.dtype.kind == "f"


def read_image(path: str | os.PathLike[str], hidden: NDArray[np.bool_] | None = None) -> Picture:
    """Read a grey or RGB image: PNG, JPEG, TIFF, EXR, PFM or NPY.

    hidden: (rows, columns), pixels that do not matter, and may hold any floats; by default none.

    8 and 16 bits come as stored; palettes and 1-, 2- and 4-bit greys become 8 bits, float16 and float64
    become float32. A JPEG is turned upright by its EXIF orientation. Opaque alpha is dropped. Of an EXR the
    channels R G B or Y are read, whatever else it holds. Color profiles, gamma chunks and the scale of a PFM
    are not applied. TIFF and 16-bit color PNG need the extra `formats`, EXR needs `exr`.
    Raises ImageError, in one line, for all that is not exactly one such image: no readable file, wrong
    extension, damaged, over 2^27 pixels or 65536 a side (refused from the header), transparent, CMYK, several
    pages, values that are negative or not finite.
    Validated against files written by Pillow, tifffile, imagecodecs and OpenEXR, and by hand.
    """
    with opened(path) as (file, kind):
        return Picture(np.ascontiguousarray(_as_stored(file, decoded(file, kind), hidden)))


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Read the size of an image, in pixels, from its header alone.

    Returns (columns, rows), as `read_image` would give them. Raises ImageError for what the header shows.
    """
    with opened(path) as (file, kind):
        return checked_size(file, kind)


@contextlib.contextmanager
def opened(path: str | os.PathLike[str], formats: Mapping[str, str] = IMAGE_FORMATS) -> Iterator[tuple[BinaryIO, str]]:
    """Open a file as the format that its extension and first bytes name; any error becomes an ImageError.

    formats: format by extension, as in `IMAGE_FORMATS`. Gives the file at its first byte, and the format.
    """
    path = Path(path)
    kind = formats.get(path.suffix.lower(), "")
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):  # to open a pipe would block for ever
            refuse(path, "must be an image file", "a folder" if stat.S_ISDIR(mode) else "a device or a pipe")
        if not kind:
            refuse(path, f"the extension must be one of {' '.join(formats)}", repr(path.suffix))
        with open(path, "rb") as file:
            head = file.read(8)
            found = next((name for name, first in _FIRST_BYTES.items() if head.startswith(first)), None)
            if found != kind:
                got = found or (f"the first bytes {head!r}" if head else "an empty file")
                refuse(path, f"the content must be {kind}, as the extension says", got)
            file.seek(0)
            yield file, kind
    except ImageError:
        raise
    except OSError as error:
        refuse(
            path,
            "must be a file that can be read" if error.errno else f"must be a whole {kind}",
            error,
            error,
        )
    except Exception as error:  # damage: each codec has its own exceptions for it, and none lists them
        refuse(path, f"must be a whole {kind}", error, error)


def _path(file: BinaryIO) -> Path:
    return Path(file.name)


def codec(path: Path, module: str, extra: str) -> Any:
    """Import what decodes a file; raises ImageError naming the extra of clsco that brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        refuse(path, f"needs {module}: pip install 'clsco[{extra}]'", error, error)


def checked_size(file: BinaryIO, kind: str) -> tuple[int, int]:
    """Read (columns, rows) from an opened file's header, and go back to its first byte; raises as `image_size`."""
    columns, rows = _CODECS[kind][0](file)
    file.seek(0)
    check_limits(Path(file.name), columns, rows)
    return columns, rows


def check_limits(path: Path, columns: int, rows: int) -> None:
    """Raise ImageError for an image of over 2^27 pixels or 65536 a side, or without any."""
    if not (1 <= columns <= MAX_SIDE and 1 <= rows <= MAX_SIDE and columns * rows <= MAX_PIXELS):
        rule = f"columns and rows must be from 1 to {MAX_SIDE}, and at most {MAX_PIXELS} pixels"
        refuse(path, rule, f"{columns} x {rows}")


def decoded(file: BinaryIO, kind: str) -> NDArray[Any]:
    """Decode an opened file whose header is within the limits: (rows, columns[, channels]), values as stored.

    Raises whatever the codecs raise, which `opened` turns into an ImageError.
    """
    columns, rows = checked_size(file, kind)
    data: NDArray[Any] = _CODECS[kind][1](file)
    if data.shape[:2] != (rows, columns):
        raise ValueError(f"{data.shape[1]} x {data.shape[0]} pixels under a header of {columns} x {rows}")
    return data


def _as_stored(file: BinaryIO, data: NDArray[Any], hidden: NDArray[np.bool_] | None) -> NDArray[Any]:
    """Refuse what is no grey or RGB image of 8, 16 or 32 bits, and values that are negative or not finite."""
    if data.ndim not in (2, 3) or (data.ndim == 3 and data.shape[2] != 3):
        refuse(_path(file), "shape must be (rows, columns) or (rows, columns, 3)", data.shape)
    if data.dtype.str[1:] in ("u1", "u2"):
        return data.astype(data.dtype.newbyteorder("="), copy=False)
    if data.dtype.str[1:] not in ("f2", "f4", "f8"):
        refuse(_path(file), "values must be uint8, uint16, float16, float32 or float64", data.dtype)
    with np.errstate(over="ignore"):  # what does not fit becomes infinite, and that is refused next
        data = data.astype(np.float32, copy=False)
    wrong = ~((data >= 0) & (data < np.inf))
    if hidden is not None:
        wrong[hidden] = False
    if wrong.any():
        first = tuple(int(index) for index in np.unravel_index(int(wrong.argmax()), wrong.shape))
        got = f"{data[first]} at row {first[0]}, column {first[1]} ({int(wrong.sum())} in all)"
        refuse(_path(file), "values must be finite and at least 0", got)
    return data


def _without_alpha(file: BinaryIO, data: NDArray[Any]) -> NDArray[Any]:
    """Drop the last channel if it is opaque everywhere; a single channel that is left becomes grey."""
    alpha = data[..., -1]
    seen_through = alpha != (1 if alpha.dtype.kind == "f" else np.iinfo(alpha.dtype).max)
    if seen_through.any():
        refuse(_path(file), "alpha must be opaque everywhere", f"{int(seen_through.sum())} other pixels")
    return data[..., 0] if data.shape[2] == 2 else data[..., :-1]


def _decode_png(file: BinaryIO) -> NDArray[Any]:
    png, depth, color, transparency = checked_png(file)
    if transparency is not None and (color != PALETTE or transparency.strip(b"\xff")):
        refuse(_path(file), "pixels must be opaque", "a transparent color (chunk tRNS)")
    if depth == 16 and color != GREY:  # Pillow drops the lower 8 bits without a word
        data = codec(_path(file), "imagecodecs", "formats").png_decode(png)
    else:
        data = _by_imageio("imread", png, ".png")
    if data.dtype == bool:
        data = data.astype(np.uint8) * np.uint8(255)
    return _without_alpha(file, data) if color in (GREY_ALPHA, RGB_ALPHA) else data


def _by_imageio(function: str, content: bytes, extension: str, **options: bool) -> Any:
    import imageio.v3  # 75 ms, and most commands read no image

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Image size")  # that limit is checked from the header already
        return getattr(imageio.v3, function)(content, plugin="pillow", extension=extension, **options)


def _jpeg_size(file: BinaryIO) -> tuple[int, int]:
    """Walk the segments to the frame header; swap the sides where EXIF lays the image down."""
    file.seek(2)
    while True:
        mark, kind, length = struct.unpack(">BBH", file.read(4))
        if mark != 0xFF or kind in (0xD9, 0xDA):
            raise ValueError("no frame header")
        if kind == 0xFF:  # padding
            file.seek(-3, os.SEEK_CUR)
            continue
        body = file.read(length - 2)
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            break
    rows, columns = struct.unpack(">HH", body[1:5])
    if columns * rows > MAX_PIXELS:
        return columns, rows  # refused by the caller, so nothing else looks at it
    file.seek(0)
    laid_down = _by_imageio("immeta", file.read(), ".jpg", exclude_applied=False).get("Orientation", 1) >= 5
    return (rows, columns) if laid_down else (columns, rows)


def _decode_jpeg(file: BinaryIO) -> NDArray[Any]:
    data: NDArray[Any] = _by_imageio("imread", file.read(), ".jpg", rotate=True)
    if data.ndim == 3 and data.shape[2] == 4:
        refuse(_path(file), "a JPEG must be grey or RGB", "CMYK")
    return data


@contextlib.contextmanager
def _tiff_page(file: BinaryIO) -> Iterator[Any]:
    with codec(_path(file), "tifffile", "formats").TiffFile(file) as tiff:
        if len(tiff.pages) != 1:
            refuse(_path(file), "must be a single image", f"{len(tiff.pages)} pages")
        yield tiff.pages[0]


def _tiff_size(file: BinaryIO) -> tuple[int, int]:
    with _tiff_page(file) as page:
        return page.imagewidth, page.imagelength


def _decode_tiff(file: BinaryIO) -> NDArray[Any]:
    with _tiff_page(file) as page:
        extra = len(page.extrasamples)
        kind = (getattr(page.photometric, "name", page.photometric), page.samplesperpixel - extra)
        if kind not in (("MINISBLACK", 1), ("RGB", 3)) or extra > 1 or page.imagedepth != 1:
            got = f"{kind[0]} with {page.samplesperpixel} samples per pixel"
            refuse(_path(file), "a TIFF must be grey (0 is black) or RGB, with at most an alpha channel", got)
        if page.bitspersample not in (8, 16, 32, 64):
            refuse(_path(file), "a TIFF must have 8 or 16 bits, or floats", f"{page.bitspersample} bits")
        data = np.moveaxis(page.asarray(), 0, 2) if page.axes == "SYX" else page.asarray()
        return _without_alpha(file, data) if extra else data


def _exr_size(file: BinaryIO) -> tuple[int, int]:
    parts = codec(_path(file), "OpenEXR", "exr").File(str(file.name), header_only=True).parts
    header, count = parts[0].header, sum(len(part.header["channels"]) for part in parts)
    window, display = ([corner.tolist() for corner in header[name]] for name in ("dataWindow", "displayWindow"))
    if window != display:
        refuse(_path(file), f"the data window must be the display window, {display}", window)
    (left, top), (right, bottom) = window
    columns, rows = right - left + 1, bottom - top + 1
    if count * columns * rows > LARGEST_EXR and columns * rows <= MAX_PIXELS:  # else its size is told
        got = f"{count} channels of {columns} x {rows}"
        refuse(_path(file), f"an EXR must hold at most {LARGEST_EXR} values", got)
    return columns, rows


def _decode_exr(file: BinaryIO) -> NDArray[Any]:
    exr = codec(_path(file), "OpenEXR", "exr").File(str(file.name), separate_channels=True)
    if len(exr.parts) != 1:  # a part that cannot be decoded is left out by the library
        refuse(_path(file), "must be a single, whole image", f"{len(exr.parts)} readable parts")
    channels = {name: channel.pixels for name, channel in exr.channels().items()}
    names = "RGB" if "R" in channels else "Y"
    if not set(names) <= set(channels) or "RY" in channels:
        refuse(_path(file), "an EXR must hold the channels R G B or Y", " ".join(channels))
    if any(channels[name].dtype.kind != "f" for name in names):
        refuse(_path(file), "EXR pixels must be floats", channels[names[0]].dtype)
    data = np.stack([channels[name] for name in (*names, "A") if name in channels], axis=-1)
    if "A" in channels:
        return _without_alpha(file, data)
    return data[..., 0] if names == "Y" else data


def _pfm_header(file: BinaryIO) -> tuple[int, int, int, float]:
    """Read what precedes the pixels: channels, columns, rows, and the scale whose sign is the byte order."""
    words: list[bytes] = []
    word = b""
    while len(words) < 4:
        byte = file.read(1)
        if not byte or len(word) > 32:
            raise ValueError(f"a header of {[*words, word]}")
        if not byte.isspace():
            word += byte
        elif word:
            words, word = [*words, word], b""
    return (3 if words[0] == b"PF" else 1), int(words[1]), int(words[2]), float(words[3])


def _pfm_size(file: BinaryIO) -> tuple[int, int]:
    columns, rows = _pfm_header(file)[1:3]
    return columns, rows


def _decode_pfm(file: BinaryIO) -> NDArray[Any]:
    channels, columns, rows, scale = _pfm_header(file)
    content = file.read()
    if len(content) != 4 * channels * columns * rows:
        raise ValueError(f"{len(content)} bytes of {columns} x {rows} x {channels} float32 pixels")
    data = np.frombuffer(content, "<f4" if scale < 0 else ">f4").reshape(rows, columns, channels)[::-1]
    return data[..., 0] if channels == 1 else data


def _npy_size(file: BinaryIO) -> tuple[int, int]:
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _fortran, dtype = read_header(file)
    if len(shape) not in (2, 3) or (len(shape) == 3 and shape[2] != 3) or dtype.kind not in "iuf":
        rule = "an NPY must hold numbers of shape (rows, columns) or (rows, columns, 3)"
        refuse(_path(file), rule, f"{dtype} of shape {shape}")
    return shape[1], shape[0]


def _decode_npy(file: BinaryIO) -> NDArray[Any]:
    data: NDArray[Any] = np.load(file, allow_pickle=False)
    return data


_CODECS = {
    "PNG": (png_size, _decode_png),
    "JPEG": (_jpeg_size, _decode_jpeg),
    "TIFF": (_tiff_size, _decode_tiff),
    "EXR": (_exr_size, _decode_exr),
    "PFM": (_pfm_size, _decode_pfm),
    "NPY": (_npy_size, _decode_npy),
}


def write_png(path: str | os.PathLike[str], data: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write codes of shape (rows, columns) or (rows, columns, 3), uint8 or uint16, as a PNG of 8 or 16 bits.

    Raises ImageError where the file cannot be written.
    """
    with whole_file(Path(path)) as file:
        file.writelines(png_parts(data))


def write_tiff(path: str | os.PathLike[str], data: NDArray[Any]) -> None:
    """Write (rows, columns) or (rows, columns, 3), uint8, uint16 or float32, as a TIFF, compressed without loss.

    Needs the extra `formats`. Raises ImageError without it, or where the file cannot be written.
    """
    tifffile = codec(Path(path), "tifffile", "formats")
    options = {"photometric": "rgb" if data.ndim == 3 else "minisblack", "compression": "zlib", "metadata": None}
    with whole_file(Path(path)) as file:
        tifffile.imwrite(file, data, **options)


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write named arrays as an NPZ, for np.load. Raises ImageError where the file cannot be written.

    Masks and numbers of objects are compressed, floats are stored: 15 MB of truth (512 x 512, color) become
    13.6 MB in 16 ms, while compressing all of it leaves 7.1 MB after 210 to 450 ms. The same arrays give the
    same bytes.
    """
    with whole_file(Path(path)) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")  # its fixed date keeps the time of writing out of the file
            entry.compress_type = zipfile.ZIP_STORED if array.dtype.kind == "f" else zipfile.ZIP_DEFLATED
            with archive.open(entry, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)


def write_exr(path: str | os.PathLike[str], *views: Mapping[str, NDArray[Any]], names: Sequence[str] = ()) -> None:
    """Write named channels of shape (rows, columns) as float32 in an OpenEXR file, compressed without loss.

    views: channels of each view; of several ones each is a part with the attribute `view`, as OpenEXR keeps them
    since version 2.0. names: of the views, of stereo pairs "left" and "right"; () for the only one.
    Needs the extra `exr`. Raises ImageError without it, or where the file cannot be written.
    """
    exr = codec(Path(path), "OpenEXR", "exr")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    pixels = [{name: np.ascontiguousarray(plane, np.float32) for name, plane in view.items()} for view in views]
    if names:
        pairs = zip(names, pixels, strict=True)
        content = exr.File([exr.Part({**header, "view": name}, planes, name=name) for name, planes in pairs])
    else:
        (planes,) = pixels
        content = exr.File(header, planes)
    with whole_file(Path(path)) as file:
        told = _Told(file)
        content.write(told)
        if told.error is not None:
            raise told.error


class _Told:
    """A file that keeps the error of a write: OpenEXR drops that of its last one, of the table of lines."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.error: OSError | None = None
        self.seek, self.tell = file.seek, file.tell

    def write(self, part: bytes) -> int:
        try:
            return self.file.write(part)
        except OSError as error:
            self.error = error
            raise


def write_json(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Write a JSON file; raises ImageError where a number is not finite, or the file cannot be written."""
    with whole_file(Path(path)) as file:
        file.write(json.dumps(content, indent=2, allow_nan=False).encode() + b"\n")
