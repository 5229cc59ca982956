"""Tags of image files: orientation of the camera, and color space of the codes."""

from __future__ import annotations

import contextlib
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.files.color import LARGEST_PROFILE, Color, chunk_color, exr_color, icc_color

MOST_CHUNKS = 2**20  # largest number of chunks of a PNG, enough for 1 GB of pixels in pieces of 1 kB
LONGEST = 2**22  # largest tag that is read, bytes
_PNG_COLORS = (b"cICP", b"sRGB", b"gAMA", b"cHRM")
_PNG_TAGS = (b"eXIf", b"iTXt", b"iCCP", *_PNG_COLORS)
_JPEG_ICC = b"ICC_PROFILE\0"
_JPEG_EXIF, _JPEG_XMP, _PNG_XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0", b"XML:com.adobe.xmp\0\0\0\0\0"
_XMP_ORIENTATION = re.compile(rb'tiff:Orientation(?:="|>)([1-8])["<]')
ORIENTATION = 0x0112  # number of the tag in EXIF and TIFF


@dataclass(frozen=True)
class Tags:
    """Orientation of an image file, 1 to 8 as in EXIF and TIFF; and data on its color space: an ICC profile, or kind
    and content of PNG chunks, or the attribute `chromaticities` of an EXR.
    """

    orientation: int = 1
    icc: bytes = b""
    chunks: tuple[tuple[bytes, bytes], ...] = ()
    chromaticities: tuple[float, ...] = ()

    def color(self, channels: int) -> Color:
        """Color space of the image, which has 1 or 3 channels."""
        if self.chromaticities:
            return exr_color(self.chromaticities)
        chunks = dict(self.chunks)
        return icc_color(self.icc, channels) if self.icc and b"cICP" not in chunks else chunk_color(chunks)


def turn_upright(data: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Stored pixels (rows, columns[, channels]) turned upright: row 0 on top, column 0 on the left."""
    if orientation in (2, 3, 7):
        data = data[:, ::-1]
    if orientation in (3, 4, 7):
        data = data[::-1]
    if orientation in (5, 7):
        return data.swapaxes(0, 1)
    return np.rot90(data, {6: -1, 8: 1}.get(orientation, 0))


def png_tags(file: BinaryIO) -> Tags:
    exif = xmp = icc = b""
    colors: dict[bytes, bytes] = {}
    file.seek(8)
    for _ in range(MOST_CHUNKS):
        head = file.read(8)
        if len(head) < 8 or head[4:] == b"IEND":
            return Tags(_orientation(exif, xmp), icc, tuple(colors.items()))
        length, kind = struct.unpack(">I4s", head)
        body = file.read(length) if kind in _PNG_TAGS and length <= LONGEST else b""
        file.seek(length - len(body) + 4, 1)
        if kind == b"eXIf":
            exif = exif or body
        elif kind == b"iCCP":
            icc = icc or _inflated(body)
        elif kind in _PNG_COLORS:
            colors.setdefault(kind, body)
        elif body.startswith(_PNG_XMP):
            xmp = xmp or body
    raise ValueError(f"more than {MOST_CHUNKS} chunks")


def jpeg_tags(file: BinaryIO) -> Tags:
    exif = xmp = b""
    parts: dict[int, bytes] = {}
    for kind, body in jpeg_segments(file):
        if kind == 0xE1 and body.startswith(_JPEG_EXIF):
            exif = exif or body.removeprefix(_JPEG_EXIF)
        elif kind == 0xE1 and body.startswith(_JPEG_XMP):
            xmp = xmp or body
        elif kind == 0xE2 and body.startswith(_JPEG_ICC) and len(body) > len(_JPEG_ICC) + 2:
            parts.setdefault(body[len(_JPEG_ICC)], body[len(_JPEG_ICC) + 2 :])
    return Tags(_orientation(exif, xmp), b"".join(parts[number] for number in sorted(parts)))


def jpeg_segments(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Kind and content of the segments of a JPEG before its pixels. Raises ValueError or struct.error for damage."""
    file.seek(2)
    while True:
        mark, kind, length = struct.unpack(">BBH", file.read(4))
        if kind == 0xFF:  # padding
            file.seek(-3, 1)
            continue
        if mark != 0xFF or kind == 0xD9 or length < 2:
            raise ValueError("no frame header")
        if kind == 0xDA:
            return
        yield kind, file.read(length - 2)


def _inflated(chunk: bytes) -> bytes:
    """The profile in a chunk iCCP. A damaged or too large chunk gives bytes that are rejected later."""
    packed = chunk.partition(b"\0")[2][1:]
    try:
        return zlib.decompressobj().decompress(packed, LARGEST_PROFILE + 1) or b"empty"
    except zlib.error:
        return b"damaged"


def _orientation(exif: bytes, xmp: bytes) -> int:
    """Orientation in the EXIF data, else in the XMP data; 1 if neither has a valid one."""
    orientation: Any = None
    if exif:
        from PIL import Image

        with contextlib.suppress(Exception):  # pixels may be intact if a tag is damaged; Pillow raises many types
            known = Image.Exif()
            known.load(exif)
            orientation = known.get(ORIENTATION)
    if orientation is None and (match := _XMP_ORIENTATION.search(xmp)):
        orientation = int(match[1])
    return orientation if orientation in range(1, 9) else 1
