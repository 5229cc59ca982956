"""Transfer curves between codes of 8- and 16-bit images and linear radiance (pure NumPy)."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

TRANSFERS = ("srgb", "linear")
AT_A_TIME = 2**20  # values processed at once, to bound the memory of intermediate results
CODES = np.arange(2**16, dtype=np.uint16)


@dataclass(frozen=True, eq=False)
class Curve:
    """A transfer curve that is not in `TRANSFERS`. radiance: linear radiance of each 16-bit code, never decreasing;
    (1, 65536) for all channels together, or (3, 65536) for red, green and blue.
    """

    radiance: NDArray[np.float64]
    _starts: dict[int, NDArray[np.float64]] = field(default_factory=dict, init=False, repr=False)

    def of_codes(self, bits: int) -> NDArray[np.float64]:
        """Radiance of each code of 8 or 16 bits, (1 or 3, 2^bits)."""
        return self.radiance[:, :: 257 if bits == 8 else 1]

    def starts(self, bits: int) -> NDArray[np.float64]:
        """Radiance at which each code but the first starts, (1 or 3, 2^bits - 1): half a code below the code. Where the
        curve is flat, it is just above the radiance of the previous code, so that encoding is the inverse of decoding.
        """
        if bits not in self._starts:
            half = 0.5 * (self.radiance[:, :-1] + self.radiance[:, 1:])
            starts = half[:, 128::257] if bits == 8 else half
            below, above = self.of_codes(bits)[:, :-1], self.of_codes(bits)[:, 1:]
            least = np.maximum(0.5 * (below + above), np.nextafter(below, 2.0))
            self._starts[bits] = np.where(starts > below, starts, least)
        return self._starts[bits]


Transfer = str | Curve


def decode(data: NDArray[np.generic], transfer: Transfer) -> NDArray[np.float64]:
    """Convert stored values of any shape to linear radiance (float64, 1 = white).

    data: codes (uint8 or uint16, the largest code is white), or floats, which are linear already. transfer: "srgb" (IEC
    61966-2-1), "linear", or a Curve; if it has a curve for each color, the colors must be the last axis.
    """
    if data.dtype.kind == "f":
        return data.astype(np.float64)
    bits = 8 * data.dtype.itemsize
    if isinstance(transfer, Curve):
        tables = transfer.of_codes(bits)
        by_channel = np.moveaxis(data, -1, 0) if len(tables) == 3 else data[None]
        planes = [table[codes] for table, codes in zip(tables, by_channel, strict=True)]
        return np.stack(planes, axis=-1) if len(tables) == 3 else planes[0]
    radiance: NDArray[np.float64] = _radiance_of_codes(bits, transfer)[data]
    return radiance


def decode_channels(image: NDArray[np.generic], transfer: Transfer) -> NDArray[np.float64]:
    """`decode` of an image with any number of channels: with 2 or 4, the last one is alpha, which is linear."""
    linear = decode(image, transfer)
    if has_alpha(image):
        linear[..., -1] = decode(image[..., -1], "linear")
    return linear


def encode_channels(linear: NDArray[np.floating], bits: int, transfer: Transfer) -> NDArray[Any]:
    """Codes of an image with any number of channels; the inverse of `decode_channels`."""
    codes = encode(linear, bits, transfer)
    if has_alpha(linear):
        codes[..., -1] = encode(linear[..., -1], bits, "linear")
    return codes


def has_alpha(image: NDArray[np.generic]) -> bool:
    """True for an image of 2 or 4 channels: gray or RGB, and alpha."""
    return image.ndim == 3 and image.shape[2] in (2, 4)


def encode(linear: NDArray[np.floating], bits: int, transfer: Transfer) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Convert linear radiance to codes of 8 or 16 bits, rounded half up in code values; the inverse of `decode`.

    linear: float32 or float64 of any shape, 1 = white. Values below 0 and NaN become code 0, values above 1 the largest
    code.

    A code starts at the radiance half a code below it. No power is computed per pixel: the square root of radiance, in
    which sRGB codes are nearly evenly spaced, selects a bin with at most one start, and one comparison decides.
    """
    codes: NDArray[Any] = np.empty(linear.shape, f"u{bits // 8}")
    if isinstance(transfer, Curve):
        starts = transfer.starts(bits)
        for channel, start in enumerate(starts):
            at = (..., channel) if len(starts) == 3 else ...
            codes[at] = np.searchsorted(start, np.fmax(linear[at], 0), side="right")
        return codes
    values, out = linear.reshape(-1), codes.reshape(-1)
    for first in range(0, values.size, AT_A_TIME):
        out[first : first + AT_A_TIME] = _codes_of(values[first : first + AT_A_TIME], bits, transfer)
    return codes


def _codes_of(linear: NDArray[np.floating], bits: int, transfer: str) -> NDArray[Any]:
    top = 2**bits - 1
    radiance = np.fmin(np.fmax(linear, 0), 1)
    codes: NDArray[Any]
    if transfer == "linear":
        codes = (radiance.astype(np.float64) * top + 0.5).astype(f"u{bits // 8}")
        return codes
    first_code, start = _bins(bits, transfer, radiance.dtype.char)
    codes = first_code[_bin_of(radiance, top)]
    codes += radiance >= start[codes]
    return codes


def _radiance_of(value: NDArray[np.float64], transfer: str) -> NDArray[np.float64]:
    """Electro-optical transfer function, from coded values in [0, 1] to linear radiance."""
    if transfer == "linear":
        return value
    if transfer == "srgb":
        return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    raise ValueError(f"transfer: must be one of {', '.join(TRANSFERS)}; got {transfer!r}")


@functools.cache
def _radiance_of_codes(bits: int, transfer: str) -> NDArray[np.float64]:
    return _radiance_of(np.arange(2**bits) / (2**bits - 1), transfer)


def _bin_of(radiance: NDArray[np.floating], top: int) -> NDArray[np.intp]:
    # Two bins per code are enough: in the square root of radiance, an interval of 1 / top has at most 1.45 sRGB codes.
    bins: NDArray[np.intp] = (np.sqrt(radiance) * radiance.dtype.type(2 * top)).astype(np.intp)
    return bins


@functools.cache
def _bins(bits: int, transfer: str, dtype: str) -> tuple[NDArray[np.unsignedinteger], NDArray[np.floating]]:
    """For each bin, its smallest code; and for each code, the radiance at which the next code starts, rounded up."""
    top = 2**bits - 1
    exact = _radiance_of((np.arange(top) + 0.5) / top, transfer)
    start = exact.astype(dtype)
    start = np.where(start < exact, np.nextafter(start, start.dtype.type(2)), start)
    first_code = np.searchsorted(_bin_of(start, top), np.arange(2 * top + 1), side="left")
    return first_code.astype(f"u{bits // 8}"), np.append(start, start.dtype.type(np.inf))
