"""Between the codes of 8- and 16-bit images and linear light (pure NumPy)."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

TRANSFERS = ("srgb", "linear")
AT_A_TIME = 2**20  # values, so that what is between light and codes takes little


def decode(data: NDArray[np.generic], transfer: str) -> NDArray[np.float64]:
    """Turn stored values into linear light.

    data: any shape; uint8 and uint16 are codes, 0 black and 255 or 65535 white; floats are linear already.
    transfer: "srgb" (IEC 61966-2-1, piecewise) or "linear"; it says nothing about floats.
    Returns float64 of the same shape, 1 = white.
    Validated against the formula of the standard for every code, and as the inverse of `encode`.
    """
    if data.dtype.kind == "f":
        return data.astype(np.float64)
    light: NDArray[np.float64] = _light_of_codes(8 * data.dtype.itemsize, transfer)[data]
    return light


def encode(linear: NDArray[np.floating], bits: int, transfer: str) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Turn linear light into codes, rounded half up in code values; the inverse of `decode` for every code.

    linear: any shape, float32 or float64, 1 = white; below 0 becomes 0, above 1 the largest code, NaN 0.
    bits: 8 or 16. transfer: "srgb" or "linear".
    Returns uint8 or uint16 of the same shape.
    A code starts where the light of the half code below it lies, so no power is taken per pixel: the square
    root, along which sRGB codes are nearly even, finds a bin that holds at most one such start, and one
    comparison decides.
    """
    codes: NDArray[Any] = np.empty(linear.shape, f"u{bits // 8}")
    given, out = linear.reshape(-1), codes.reshape(-1)
    for first in range(0, given.size, AT_A_TIME):
        out[first : first + AT_A_TIME] = _codes_of(given[first : first + AT_A_TIME], bits, transfer)
    return codes


def _codes_of(linear: NDArray[np.floating], bits: int, transfer: str) -> NDArray[Any]:
    top = 2**bits - 1
    light = np.fmin(np.fmax(linear, 0), 1)
    codes: NDArray[Any]
    if transfer == "linear":
        codes = (light.astype(np.float64) * top + 0.5).astype(f"u{bits // 8}")
        return codes
    first_code, start = _bins(bits, transfer, light.dtype.char)
    codes = first_code[_bin_of(light, top)]
    codes += light >= start[codes]
    return codes


def _light_of(value: NDArray[np.float64], transfer: str) -> NDArray[np.float64]:
    """Electro-optical transfer function: coded value in [0, 1] -> linear light."""
    if transfer == "linear":
        return value
    if transfer == "srgb":
        return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    raise ValueError(f"transfer: must be one of {', '.join(TRANSFERS)}; got {transfer!r}")


@functools.cache
def _light_of_codes(bits: int, transfer: str) -> NDArray[np.float64]:
    return _light_of(np.arange(2**bits) / (2**bits - 1), transfer)


def _bin_of(light: NDArray[np.floating], top: int) -> NDArray[np.intp]:
    # Two bins per code: along the square root the steepest part of sRGB has 1.45 codes in 1 / top.
    bins: NDArray[np.intp] = (np.sqrt(light) * light.dtype.type(2 * top)).astype(np.intp)
    return bins


@functools.cache
def _bins(bits: int, transfer: str, dtype: str) -> tuple[NDArray[np.unsignedinteger], NDArray[np.floating]]:
    """Per bin the smallest code in it; per code the light where the next one starts, rounded up."""
    top = 2**bits - 1
    exact = _light_of((np.arange(top) + 0.5) / top, transfer)
    start = exact.astype(dtype)
    start = np.where(start < exact, np.nextafter(start, start.dtype.type(2)), start)
    first_code = np.searchsorted(_bin_of(start, top), np.arange(2 * top + 1), side="left")
    return first_code.astype(f"u{bits // 8}"), np.append(start, start.dtype.type(np.inf))
