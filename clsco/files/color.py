"""Color spaces that image files name: the curve that decodes their codes, and what an output needs to look the same.

Codes become linear radiance in the primaries of their own profile, and outputs get codes of the same curve with the
profile beside them: pixels that stay as they are have their codes, and their looks. Where images of several profiles
meet, a matrix takes each to the primaries of sRGB.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clsco.files.primaries import CICP_CHROMATICITIES, Matrix, chromaticities_to_srgb, colorants_to_srgb
from clsco.files.transfer import CODES, Curve, decode

LARGEST_PROFILE = 2**22  # bytes
MOST_TAGS = 256
LARGEST_FALL = 1e-3  # of radiance, by rounding where two parts of a curve meet
SRGB_LIKE = 2e-4  # largest difference in radiance from sRGB; half a code of 8 bits next to black is 1.5e-4
_CHANNELS = {b"GRAY": 1, b"RGB ": 3}
# Of a curve (a x + b)^g + e from d on, and c x + f below it.
_ALPHA, _BETA = 1.09929682680944, 0.018053968510807  # of BT.2020, which makes BT.709 continuous
_BT709 = (1 / 0.45, 1 / _ALPHA, 1 - 1 / _ALPHA, 1 / 4.5, 4.5 * _BETA, 0.0, 0.0)
_LINEAR = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_CICP = {1: _BT709, 6: _BT709, 14: _BT709, 15: _BT709, 4: (2.2, *_LINEAR[1:]), 5: (2.8, *_LINEAR[1:]), 8: _LINEAR}
_CICP_SRGB, _CICP_BT709_PRIMARIES = 13, 1


@dataclass(frozen=True)
class Color:
    """Color space of an image file; by default sRGB, of which nothing need be said.

    Attributes
    ----------
    name : str
        As the profile calls itself, printable.
    icc : bytes
        The ICC profile; b"" for none.
    chunks : tuple of (bytes, bytes)
        Chunks of a PNG that stand for a profile: kind and content.
    channels : {0, 1, 3}
        Channels of images that the profile is for; 0 for any.
    curve : Curve, optional
        Curve of its codes; None for that of sRGB.
    to_srgb : ndarray of float64, (3, 3), optional
        Matrix from its linear red, green and blue to those of sRGB; None where there is none, or nothing to convert.
    note : str
        Note on what could not be taken from the file, in one line; "" where all was.
    """

    name: str = "sRGB"
    icc: bytes = b""
    chunks: tuple[tuple[bytes, bytes], ...] = ()
    channels: int = 0
    curve: Curve | None = field(default=None, compare=False)
    to_srgb: Matrix | None = field(default=None, compare=False)
    note: str = ""

    @property
    def is_plain(self) -> bool:
        """True where an output looks the same without a profile."""
        return not self.icc and not self.chunks

    @property
    def size(self) -> int:
        """Bytes that it takes in memory."""
        return len(self.icc) + (0 if self.curve is None else self.curve.radiance.nbytes)

    def transfer(self, wanted: str) -> str | Curve:
        """Transfer curve of codes where a scene wants "srgb" or "linear": its own curve in place of "srgb"."""
        return self.curve if wanted == "srgb" and self.curve is not None else wanted

    def png_chunks(self) -> tuple[tuple[bytes, bytes], ...]:
        """Chunks of a PNG in this color space."""
        if self.icc:
            return ((b"iCCP", b"icc\0\0" + zlib.compress(self.icc, 9)),)
        return self.chunks


SRGB = Color()


def icc_color(icc: bytes, channels: int) -> Color:
    """The color space of an ICC profile, for an image with 1 or 3 channels; a profile that cannot be used is noted."""
    try:
        name, found, tables, matrix = _parsed(icc)
    except (ValueError, struct.error, IndexError, ArithmeticError) as error:
        got = " ".join(str(error).split()) or type(error).__name__
        return Color(note=f"the color profile is left out, as it cannot be read: {got}")
    if found != channels:
        kind = {1: "gray images", 3: "RGB"}.get(found, "neither gray images nor RGB")
        return Color(note=f"the color profile {name} is left out: it is for {kind}")
    if tables is None:
        note = f"the color profile {name} has no curves: codes are taken as sRGB's"
        return Color(name, icc, channels=channels, to_srgb=matrix, note=note)
    return Color(name, icc, channels=channels, curve=_unless_srgb(tables), to_srgb=matrix)


def chunk_color(chunks: Mapping[bytes, bytes]) -> Color:
    """The color space that the chunks cICP, sRGB, gAMA and cHRM of a PNG name, in this order."""
    carried: tuple[tuple[bytes, bytes], ...]
    cicp, gamma = chunks.get(b"cICP", b""), chunks.get(b"gAMA", b"")
    if len(cicp) == 4:
        carried = ((b"cICP", cicp),)
        known = CICP_CHROMATICITIES.get(cicp[0])
        matrix = None if known is None else chromaticities_to_srgb(known)
        if cicp[1] == _CICP_SRGB:
            return SRGB if cicp[0] == _CICP_BT709_PRIMARIES else Color("of cICP", chunks=carried, to_srgb=matrix)
        if cicp[1] in _CICP:
            curve = _unless_srgb([_parametric(_CICP[cicp[1]])])
            return Color("of cICP", chunks=carried, curve=curve, to_srgb=matrix)
        note = f"the transfer curve {cicp[1]} of the chunk cICP is not known: codes are taken as sRGB's"
        return Color("of cICP", chunks=carried, to_srgb=matrix, note=note)
    if b"sRGB" in chunks:
        return SRGB
    carried = tuple((kind, chunks[kind]) for kind in (b"gAMA", b"cHRM") if kind in chunks)
    if len(gamma) == 4 and (exponent := int.from_bytes(gamma, "big") / 1e5) > 0:
        chrm = chunks.get(b"cHRM")
        if chrm is None:
            matrix = np.eye(3)
        else:
            matrix = chromaticities_to_srgb(np.frombuffer(chrm, ">u4") / 1e5) if len(chrm) == 32 else None
        if abs(exponent - 0.45455) < 5e-5:  # which stands for sRGB (PNG, third edition, 11.3.2.2)
            return SRGB if chrm is None else Color("of gAMA", chunks=carried, to_srgb=matrix)
        curve = Curve(_parametric((1 / exponent, *_LINEAR[1:]))[None])
        return Color("of gAMA", chunks=carried, curve=curve, to_srgb=matrix)
    return SRGB


def _unless_srgb(tables: list[NDArray[np.float64]]) -> Curve | None:
    """The curve of each channel, or of all; None where they are that of sRGB."""
    srgb = decode(CODES, "srgb")
    if all(float(np.abs(table - srgb).max()) <= SRGB_LIKE for table in tables):
        return None
    alike = all(np.array_equal(table, tables[0]) for table in tables)
    return Curve(np.stack(tables[:1] if alike else tables))


def _parsed(icc: bytes) -> tuple[str, int, list[NDArray[np.float64]] | None, Matrix | None]:
    """Name, channels, radiance of 2^16 codes of each, and matrix to sRGB, of an ICC profile (ICC.1:2022).

    None without curves, and without a matrix.
    """
    if len(icc) > LARGEST_PROFILE:
        raise ValueError(f"over {LARGEST_PROFILE} bytes")
    if len(icc) < 132 or icc[36:40] != b"acsp":
        raise ValueError("no ICC profile")
    (count,) = struct.unpack_from(">I", icc, 128)
    if count > MOST_TAGS:
        raise ValueError(f"more than {MOST_TAGS} tags")
    tags = {}
    for number in range(count):
        kind, start, size = struct.unpack_from(">4sII", icc, 132 + 12 * number)
        if start + size > len(icc):
            raise ValueError("a tag beyond its end")
        tags[kind] = icc[start : start + size]
    channels = _CHANNELS.get(icc[16:20], 0)
    names = [b"kTRC"] if channels == 1 else [b"rTRC", b"gTRC", b"bTRC"]
    is_lab = channels == 1 and icc[20:24] == b"Lab "  # whose curve gives lightness
    tables = None if is_lab or not all(name in tags for name in names) else [_table(tags[name]) for name in names]
    return _name(tags.get(b"desc", b"")), channels, tables, _matrix(tags) if icc[16:24] == b"RGB XYZ " else None


def _matrix(tags: Mapping[bytes, bytes]) -> Matrix | None:
    """The matrix to sRGB by the colorants of an RGB profile, which are X, Y and Z under D50."""
    colorants = [tags.get(name, b"") for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
    if not all(tag[:4] == b"XYZ " and len(tag) >= 20 for tag in colorants):
        return None
    return colorants_to_srgb(np.stack([np.frombuffer(tag, ">i4", 3, 8) / 65536 for tag in colorants], axis=-1))


def _name(desc: bytes) -> str:
    """Name in a profile of version 2 or 4, printable and short."""
    if desc[:4] == b"mluc" and len(desc) >= 28:
        size, start = struct.unpack_from(">II", desc, 20)
        text = desc[start : start + min(size, 200)].decode("utf-16-be", "replace")
    else:
        text = desc[12:112].split(b"\0")[0].decode("latin1")
    shown = "".join(letter for letter in text if letter.isprintable())[:60].strip()
    return shown or "without a name"


def _table(tag: bytes) -> NDArray[np.float64]:
    """Radiance of 2^16 codes by a curveType or a parametricCurveType."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return _parametric(_LINEAR)
        if count == 1:
            return _parametric((struct.unpack_from(">H", tag, 12)[0] / 256, *_LINEAR[1:]))
        samples = np.frombuffer(tag, ">u2", count, 12) / 65535
        return _increasing(np.interp(np.linspace(0, count - 1, len(CODES)), np.arange(count), samples))
    if tag[:4] != b"para":
        raise ValueError(f"a curve of kind {tag[:4]!r}")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind > 4:
        raise ValueError(f"a parametric curve of kind {kind}")
    g, *rest = (number / 65536 for number in struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", tag, 12))
    if kind in (1, 2):
        a, b, offset = rest[0], rest[1], rest[2] if kind == 2 else 0.0
        return _parametric((g, a, b, 0.0, -b / a, offset, offset))
    a, b, c, d, e, f = [*rest, 0.0, 0.0][:6] if rest else _LINEAR[1:]
    return _parametric((g, a, b, c, d, e, f))


def _parametric(parameters: tuple[float, ...]) -> NDArray[np.float64]:
    g, a, b, c, d, e, f = parameters
    x = np.arange(len(CODES)) / (len(CODES) - 1)
    with np.errstate(all="ignore"):  # what is no number is refused next
        return _increasing(np.where(x >= d, np.maximum(a * x + b, 0.0) ** g + e, c * x + f))


def _increasing(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Refuse a curve that has no inverse: outputs could not be encoded."""
    highest = np.maximum.accumulate(table)
    if not np.isfinite(table).all() or (highest - table).max() > LARGEST_FALL or highest[-1] <= highest[0]:
        raise ValueError("a curve that does not increase")
    return np.asarray(np.clip(highest, 0.0, 1.0))
