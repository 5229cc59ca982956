"""Color spaces of image files: curves that decode codes, and profiles that make an output look like its input.

Codes become linear radiance in the primaries of their own profile, and outputs get the same curve and profile. If
images with different profiles are used together, a matrix converts each to the primaries of sRGB.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.transfer import CODES, Curve, decode

Matrix = NDArray[np.float64]

LARGEST_PROFILE = 2**22  # bytes
MOST_TAGS = 256
LARGEST_FALL = 1e-3  # largest decrease in radiance, by rounding where two parts of a curve meet
SRGB_LIKE = 2e-4  # largest difference in radiance from sRGB; half a code of 8 bits next to black is 1.5e-4
_CHANNELS = {b"GRAY": 1, b"RGB ": 3}
# Parameters g, a, b, c, d, e, f of a curve that is (a x + b)^g + e for x >= d, and c x + f for x < d.
_ALPHA, _BETA = 1.09929682680944, 0.018053968510807  # digits of BT.2020, with which the curve of BT.709 is continuous
_BT709 = (1 / 0.45, 1 / _ALPHA, 1 - 1 / _ALPHA, 1 / 4.5, 4.5 * _BETA, 0.0, 0.0)
_LINEAR = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_CICP = {1: _BT709, 6: _BT709, 14: _BT709, 15: _BT709, 4: (2.2, *_LINEAR[1:]), 5: (2.8, *_LINEAR[1:]), 8: _LINEAR}
_CICP_SRGB, _CICP_BT709_PRIMARIES = 13, 1
ALIKE = 1e-3  # a matrix this close to the identity counts as the identity: under half a code of 8 bits at white
D50 = np.array([0.9642, 1.0, 0.8249])  # white of the profile connection space (ICC.1:2022, 7.2.16)
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_D65, _C = (0.3127, 0.329), (0.31, 0.316)
SRGB_CHROMATICITIES = (*_D65, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)
_OF_1953, _OF_525_LINES = (0.67, 0.33, 0.21, 0.71, 0.14, 0.08), (0.63, 0.34, 0.31, 0.595, 0.155, 0.07)
_P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06)
CICP_CHROMATICITIES = {  # ITU-T H.273, table 2: x and y of white, red, green and blue
    1: SRGB_CHROMATICITIES,
    4: (*_C, *_OF_1953),
    5: (*_D65, 0.64, 0.33, 0.29, 0.6, 0.15, 0.06),
    6: (*_D65, *_OF_525_LINES),
    7: (*_D65, *_OF_525_LINES),
    8: (*_C, 0.681, 0.319, 0.243, 0.692, 0.145, 0.049),
    9: (*_D65, 0.708, 0.292, 0.17, 0.797, 0.131, 0.046),
    11: (0.314, 0.351, *_P3),
    12: (*_D65, *_P3),
    22: (*_D65, 0.63, 0.34, 0.295, 0.605, 0.155, 0.077),
}


@dataclass(frozen=True)
class Color:
    """Color space of an image file; by default sRGB, which needs no profile.

    name: printable. icc: the ICC profile, or b"". chunks: kind and content of PNG chunks that act as a profile.
    channels: number that images need for the profile, 0 for any. curve: None for the curve of sRGB. chromaticities: x
    and y of white, red, green and blue; None if unknown or equal to sRGB. note: why a profile was not read, or "".
    """

    name: str = "sRGB"
    icc: bytes = b""
    chunks: tuple[tuple[bytes, bytes], ...] = ()
    channels: int = 0
    curve: Curve | None = field(default=None, compare=False)
    chromaticities: tuple[float, ...] | None = None
    note: str = ""

    @property
    def is_plain(self) -> bool:
        """True if an output looks the same without a profile."""
        return not self.icc and not self.chunks and self.chromaticities is None

    @cached_property
    def to_srgb(self) -> Matrix | None:
        """Matrix (3, 3) from linear values in this color space to sRGB; None if no conversion is needed or known."""
        return None if self.chromaticities is None else chromaticities_to_srgb(self.chromaticities)

    def converts(self, transfer: str) -> bool:
        """True if images are converted to the primaries of sRGB; False for codes that a scene declares "linear"."""
        return self.to_srgb is not None and (transfer == "srgb" or not (self.icc or self.chunks))

    @property
    def size(self) -> int:
        """Size in memory, bytes."""
        return len(self.icc) + (0 if self.curve is None else self.curve.radiance.nbytes)

    def transfer(self, curve_of_scene: str) -> str | Curve:
        """Transfer curve of codes: that of the scene; but the curve of this color space, if any, replaces "srgb"."""
        return self.curve if curve_of_scene == "srgb" and self.curve is not None else curve_of_scene

    def profile(self, linear: bool) -> bytes:
        """ICC profile of an RGB image: the file's, or one made of primaries for codes or `linear` values, or b""."""
        if self.icc or self.chromaticities is None:
            return self.icc
        return _profile(self.name, self.chromaticities, _curve_tag(self.curve, linear))

    def png_chunks(self, colored: bool) -> tuple[tuple[bytes, bytes], ...]:
        """Kind and content of chunks that store this color space in a PNG; colored: False for a gray PNG."""
        icc = self.icc or (self.profile(False) if colored and not self.chunks else b"")
        return ((b"iCCP", b"icc\0\0" + zlib.compress(icc, 9)),) if icc else self.chunks

    def exr_attributes(self) -> dict[str, Any]:
        """Attributes of an EXR with these primaries; empty for sRGB, which is the default of EXR."""
        known = self.chromaticities
        return {} if known is None else {"chromaticities": (*known[2:], *known[:2])}


SRGB = Color()


def icc_color(icc: bytes, channels: int) -> Color:
    """The color space of an ICC profile, for an image with 1 or 3 channels; an unusable profile gives a note."""
    try:
        name, colors, tables, primaries = _parsed(icc)
    except (ValueError, struct.error, IndexError, ArithmeticError) as error:
        got = " ".join(str(error).split()) or type(error).__name__
        return Color(note=f"the color profile is left out, as it cannot be read: {got}")
    if colors != channels:
        kind = {1: "gray images", 3: "RGB"}.get(colors, "neither gray images nor RGB")
        return Color(note=f"the color profile {name} is left out: it is for {kind}")
    if tables is None:
        note = f"the color profile {name} has no curves: codes are taken as sRGB's"
        return Color(name, icc, channels=channels, chromaticities=primaries, note=note)
    return Color(name, icc, channels=channels, curve=_unless_srgb(tables), chromaticities=primaries)


def exr_color(chromaticities: Sequence[float]) -> Color:
    """The color space of linear values in an EXR; chromaticities: x and y of red, green, blue and white, or ()."""
    if not chromaticities:
        return SRGB
    numbers = tuple(map(float, chromaticities))
    known = numbers[6:] + numbers[:6]
    matrix = chromaticities_to_srgb(known)
    named = " ".join(f"{number:.6g}" for number in numbers)
    if matrix is None:
        return Color(note=f"the chromaticities {named} are left out: they span no colors")
    if (matrix == np.eye(3)).all():
        return SRGB
    return Color(f"of chromaticities {named}", chromaticities=known)


def chunk_color(chunks: Mapping[bytes, bytes]) -> Color:
    """The color space from the chunks of a PNG: from the first that exists of cICP, sRGB, gAMA and cHRM."""
    carried: tuple[tuple[bytes, bytes], ...]
    cicp, gamma = chunks.get(b"cICP", b""), chunks.get(b"gAMA", b"")
    if len(cicp) == 4:
        carried = ((b"cICP", cicp),)
        known = CICP_CHROMATICITIES.get(cicp[0])
        if (cicp[0], cicp[1]) == (_CICP_BT709_PRIMARIES, _CICP_SRGB):
            return SRGB
        curve = _unless_srgb([_parametric(_CICP[cicp[1]])]) if cicp[1] in _CICP else None
        note = f"the transfer curve {cicp[1]} of the chunk cICP is not known: codes are taken as sRGB's"
        note = "" if cicp[1] in (_CICP_SRGB, *_CICP) else note
        return Color("of cICP", chunks=carried, curve=curve, chromaticities=known, note=note)
    if b"sRGB" in chunks:
        return SRGB
    exponent = int.from_bytes(gamma, "big") / 1e5 if len(gamma) == 4 else 0.0
    kinds = (b"gAMA", b"cHRM") if exponent > 0.0 else (b"cHRM",)  # without gAMA, the curve is that of sRGB
    carried = tuple((kind, chunks[kind]) for kind in kinds if kind in chunks)
    chrm, numbers = chunks.get(b"cHRM"), SRGB_CHROMATICITIES
    if chrm is not None:
        numbers = tuple((np.frombuffer(chrm, ">u4") / 1e5).tolist()) if len(chrm) == 32 else (0.0,) * 8
    known = None if chromaticities_to_srgb(numbers) is None else numbers
    if exponent <= 0.0:
        return SRGB if known in (None, SRGB_CHROMATICITIES) else Color("of cHRM", chunks=carried, chromaticities=known)
    if abs(exponent - 0.45455) < 5e-5:  # this exponent stands for sRGB (PNG, third edition, 11.3.2.2)
        return SRGB if chrm is None else Color("of gAMA", chunks=carried, chromaticities=known)
    curve = Curve(_parametric((1 / exponent, *_LINEAR[1:]))[None])
    return Color("of gAMA", chunks=carried, curve=curve, chromaticities=known)


def _unless_srgb(tables: list[NDArray[np.float64]]) -> Curve | None:
    """The curve from tables of radiance, one for all channels or one for each; None if it is the curve of sRGB."""
    srgb = decode(CODES, "srgb")
    if all(float(np.abs(table - srgb).max()) <= SRGB_LIKE for table in tables):
        return None
    same = all(np.array_equal(table, tables[0]) for table in tables)
    return Curve(np.stack(tables[:1] if same else tables))


def _parsed(icc: bytes) -> tuple[str, int, list[NDArray[np.float64]] | None, tuple[float, ...] | None]:
    """Parse a profile (ICC.1:2022): name, channels, radiance by 16-bit code or None, and chromaticities or None."""
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
    is_lab = channels == 1 and icc[20:24] == b"Lab "  # the curve gives lightness, not radiance
    tables = None if is_lab or not all(name in tags for name in names) else [_table(tags[name]) for name in names]
    primaries = _primaries(tags, icc[8]) if icc[16:24] == b"RGB XYZ " else None
    return _name(tags.get(b"desc", b"")), channels, tables, primaries


def _primaries(tags: Mapping[bytes, bytes], version: int) -> tuple[float, ...] | None:
    """Chromaticities of an RGB profile, or None if unknown. Its colorants are adapted to D50; the white before this
    adaptation is computed from the tag `chad`, or, before version 4, from `wtpt`.
    """
    columns = [tags.get(name, b"") for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
    if not all(tag[:4] == b"XYZ " and len(tag) >= 20 for tag in columns):
        return None
    xyz = np.stack([np.frombuffer(tag, ">i4", 3, 8) / 65536 for tag in columns], axis=-1)
    chad, medium, white = tags.get(b"chad", b""), tags.get(b"wtpt", b""), D50
    if len(chad) >= 44 and np.linalg.cond(adapted := np.frombuffer(chad, ">i4", 9, 8).reshape(3, 3) / 65536) < 1e6:
        white = np.linalg.solve(adapted, D50)
    elif version < 4 and len(medium) >= 20:
        white = np.frombuffer(medium, ">i4", 3, 8) / 65536
    numbers = colorants_to_chromaticities(xyz, white if (white > 0).all() else D50)
    return numbers if chromaticities_to_srgb(numbers) is not None else None


def _profile(name: str, chromaticities: Sequence[float], curve: bytes) -> bytes:
    """An ICC profile of version 4.4; curve: content of the tag of its curve."""

    def text(words: str) -> bytes:
        coded = words.encode("utf-16-be")
        return b"mluc\0\0\0\0" + struct.pack(">II4sII", 1, 12, b"enUS", len(coded), 28) + coded

    def numbers(kind: bytes, values: Matrix) -> bytes:
        return kind + bytes(4) + np.rint(65536 * values).astype(">i4").tobytes()

    xyz = colorants(chromaticities)
    assert xyz is not None
    tags = {b"desc": text(name), b"cprt": text("CC0"), b"wtpt": numbers(b"XYZ ", D50)}
    tags[b"chad"] = numbers(b"sf32", adaptation(white_of(chromaticities)))
    tags |= {b"rgb"[k : k + 1] + b"XYZ": numbers(b"XYZ ", xyz[:, k]) for k in range(3)}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    table, body, start = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    places: dict[bytes, int] = {}
    for kind, content in tags.items():
        if content not in places:
            places[content] = start + len(body)
            body += content + bytes(-len(content) % 4)
        table += struct.pack(">4sII", kind, places[content], len(content))
    head = struct.pack(">I4xI4s4s4s6H4s28x", start + len(body), 0x04400000, b"mntr", b"RGB ", b"XYZ ", 2026, 1, 1, 0, 0,
        0, b"acsp")  # fmt: skip
    return head + numbers(b"", D50)[4:] + bytes(48) + table + body


def _curve_tag(curve: Curve | None, linear: bool) -> bytes:
    """Tag of a curve; None stands for the curve of sRGB."""
    if linear:
        return b"curv" + bytes(8)
    if curve is None:
        numbers = np.rint(65536 * np.array([2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045])).astype(">i4")
        return b"para" + struct.pack(">4xHH", 3, 0) + numbers.tobytes()
    samples = np.interp(np.linspace(0, CODES[-1], 4096), CODES, curve.radiance[0])
    return b"curv" + struct.pack(">4xI", 4096) + np.rint(65535 * samples).astype(">u2").tobytes()


def _name(desc: bytes) -> str:
    """The name in a tag `desc` of version 2 or 4, made printable and short."""
    if desc[:4] == b"mluc" and len(desc) >= 28:
        size, start = struct.unpack_from(">II", desc, 20)
        text = desc[start : start + min(size, 200)].decode("utf-16-be", "replace")
    else:
        text = desc[12:112].split(b"\0")[0].decode("latin1")
    shown = "".join(letter for letter in text if letter.isprintable())[:60].strip()
    return shown or "without a name"


def _table(tag: bytes) -> NDArray[np.float64]:
    """Radiance of all 2^16 codes from a tag of an ICC profile, a curveType or a parametricCurveType."""
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
    with np.errstate(all="ignore"):  # NaN and infinity are rejected next
        return _increasing(np.where(x >= d, np.maximum(a * x + b, 0.0) ** g + e, c * x + f))


def _increasing(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """The table of a curve, clipped to 0 to 1, without falls by rounding. Raises ValueError if it has no inverse."""
    highest = np.maximum.accumulate(table)
    if not np.isfinite(table).all() or (highest - table).max() > LARGEST_FALL or highest[-1] <= highest[0]:
        raise ValueError("a curve that does not increase")
    return np.asarray(np.clip(highest, 0.0, 1.0))


def chromaticities_to_srgb(chromaticities: Sequence[float] | Matrix) -> Matrix | None:
    """Matrix (3, 3) that converts to linear sRGB; None if the primaries are collinear. White stays white, by Bradford's
    adaptation. chromaticities: x and y of white, red, green, blue; if nearly those of sRGB, the matrix is the identity.
    """
    xyz, srgb = colorants(chromaticities), colorants(SRGB_CHROMATICITIES)
    if xyz is None or srgb is None:
        return None
    matrix = np.asarray(np.linalg.solve(srgb, xyz), np.float64)
    return np.eye(3) if np.abs(matrix - np.eye(3)).max() <= ALIKE else matrix


def colorants_to_chromaticities(xyz: Matrix, white: Matrix = D50) -> tuple[float, ...]:
    """Chromaticities x and y of white and of the primaries, before adaptation.

    xyz: columns X, Y, Z of the primaries, adapted to D50. white: X, Y, Z of the white from which they were adapted.
    """
    with np.errstate(all="ignore"):  # `colorants` rejects chromaticities that are not finite
        native = np.linalg.inv(adaptation(white)) @ np.column_stack([xyz.sum(axis=1), xyz])
        return tuple((native[:2] / native.sum(axis=0)).T.ravel().tolist())


def adaptation(white: Matrix) -> Matrix:
    """Bradford's matrix, which converts X, Y and Z under a white to X, Y and Z under D50."""
    return np.asarray(np.linalg.solve(_BRADFORD, ((_BRADFORD @ D50) / (_BRADFORD @ white))[:, None] * _BRADFORD))


def white_of(chromaticities: Sequence[float] | Matrix) -> Matrix:
    x, y = chromaticities[:2]
    return np.array([x / y, 1.0, (1 - x - y) / y])


def colorants(chromaticities: Sequence[float] | Matrix) -> Matrix | None:
    """Matrix with columns X, Y and Z of red, green and blue, adapted to D50; None if the primaries are collinear."""
    x, y = np.asarray(chromaticities, np.float64).reshape(4, 2).T
    if not np.isfinite([x, y]).all() or y[0] <= 0:
        return None
    white, columns = white_of((x[0], y[0])), np.stack([x, y, 1 - x - y])[:, 1:]  # y of a primary may be below 0
    if np.linalg.cond(columns) > 1e6 or (_BRADFORD @ white <= 0).any():
        return None
    matrix: Matrix = adaptation(white) @ (columns * np.linalg.solve(columns, white))
    return matrix
