"""Transfer curves between codes of 8- and 16-bit images and linear radiance (pure NumPy)."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

TRANSFERS = ("srgb", "linear")
AT_A_TIME = 2**20  # values, which bounds the memory of intermediate results


def decode(data: NDArray[np.generic], transfer: str) -> NDArray[np.float64]:
    """Linear radiance of stored values.

    Parameters
    ----------
    data : ndarray, any shape
        uint8 and uint16 are codes, 0 black and 255 or 65535 white; floats are linear already.
    transfer : {"srgb", "linear"}
        IEC 61966-2-1, piecewise, or none; without effect on floats.

    Returns
    -------
    ndarray of float64
        Of the same shape, 1 = white.

    Notes
    -----
    Validated against the standard's formula for every code, and as the inverse of `encode`.
    """
    if data.dtype.kind == "f":
        return data.astype(np.float64)
    radiance: NDArray[np.float64] = _radiance_of_codes(8 * data.dtype.itemsize, transfer)[data]
    return radiance


def encode(linear: NDArray[np.floating], bits: int, transfer: str) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Codes of linear radiance, rounded half up in code values; the inverse of `decode` for every code.

    Parameters
    ----------
    linear : ndarray of float32 or float64, any shape
        1 = white; below 0 becomes 0, above 1 the largest code, NaN 0.
    bits : {8, 16}
    transfer : {"srgb", "linear"}

    Returns
    -------
    ndarray of uint8 or uint16
        Of the same shape.

    Notes
    -----
    A code starts at the radiance of the half code below it, so no power is taken per pixel: the square root, along
    which sRGB codes are nearly even, finds a bin with at most one such start, and one comparison decides.
    """
    codes: NDArray[Any] = np.empty(linear.shape, f"u{bits // 8}")
    given, out = linear.reshape(-1), codes.reshape(-1)
    for first in range(0, given.size, AT_A_TIME):
        out[first : first + AT_A_TIME] = _codes_of(given[first : first + AT_A_TIME], bits, transfer)
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
    """Electro-optical transfer function: coded value in [0, 1] to linear radiance."""
    if transfer == "linear":
        return value
    if transfer == "srgb":
        return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    raise ValueError(f"transfer: must be one of {', '.join(TRANSFERS)}; got {transfer!r}")


@functools.cache
def _radiance_of_codes(bits: int, transfer: str) -> NDArray[np.float64]:
    return _radiance_of(np.arange(2**bits) / (2**bits - 1), transfer)


def _bin_of(radiance: NDArray[np.floating], top: int) -> NDArray[np.intp]:
    # Two bins per code: along the square root the steepest part of sRGB has 1.45 codes in 1 / top.
    bins: NDArray[np.intp] = (np.sqrt(radiance) * radiance.dtype.type(2 * top)).astype(np.intp)
    return bins


@functools.cache
def _bins(bits: int, transfer: str, dtype: str) -> tuple[NDArray[np.unsignedinteger], NDArray[np.floating]]:
    """Per bin its smallest code; per code the radiance where the next one starts, rounded up."""
    top = 2**bits - 1
    exact = _radiance_of((np.arange(top) + 0.5) / top, transfer)
    start = exact.astype(dtype)
    start = np.where(start < exact, np.nextafter(start, start.dtype.type(2)), start)
    first_code = np.searchsorted(_bin_of(start, top), np.arange(2 * top + 1), side="left")
    return first_code.astype(f"u{bits // 8}"), np.append(start, start.dtype.type(np.inf))
