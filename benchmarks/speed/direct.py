"""Direct scatter in numba, as one would write it without OpenCL, in the two usual ways; needs the extra `bench`.

A private image per thread, added up at the end; and bands of rows, each thread taking what falls into its own.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

# Idle threads must not spin while something else is timed.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

from clsco.optics.point_spread import point_spread
from clsco.scene.model import Psf

Array = NDArray[Any]
THREADS = get_num_threads()
BLOCK = 2**18  # weights at a time: their intermediate results stay small


@njit(inline="always")
def _disc_taps(r):  # type: ignore[no-untyped-def]
    """Pixel centers within r, which the weights of a sampled disc are normalized by."""
    k, count = int(r), 0
    for a in range(-k, k + 1):
        for b in range(-k, k + 1):
            if a * a + b * b <= r * r:
                count += 1
    return count


@njit(inline="always")
def _tabulated(table, u, dx, dy):  # type: ignore[no-untyped-def]
    """Weight at (dx, dy), linear between the two nearest radii of a dense table."""
    k = int(u)
    t = u - k
    a, b = abs(dx), abs(dy)
    return table[k, a, b] + t * (table[k + 1, a, b] - table[k, a, b])


class Scatter(NamedTuple):
    """Direct scatter of discs for images (rows, columns, channels): the thesis' disc by (image, radius, threads), and
    the integrated one with tilt, by (image, radius, gx, gy, table, steps, threads); see `dense_table`."""

    sampled_private: Callable[..., Array]
    sampled_bands: Callable[..., Array]
    exact_private: Callable[..., Array]
    exact_bands: Callable[..., Array]


@lru_cache(maxsize=2)
def scatter(channels: int) -> Scatter:
    """Compiled for a number of channels, which share each tap's weight."""

    @njit(parallel=True)
    def sampled_private(image, radius, threads):  # type: ignore[no-untyped-def]
        rows, columns = radius.shape
        parts = np.zeros((threads, rows, columns, channels), np.float32)
        for t in prange(threads):
            v = np.empty(channels, np.float32)
            for i in range(t * rows // threads, (t + 1) * rows // threads):
                for j in range(columns):
                    r = radius[i, j]
                    k = 0 if r < 0.5 else int(r)
                    count = _disc_taps(r) if k else 1
                    for c in range(channels):
                        v[c] = image[i, j, c] / count
                    for a in range(max(-k, -i), min(k, rows - 1 - i) + 1):
                        for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                            if a * a + b * b <= r * r or k == 0:
                                for c in range(channels):
                                    parts[t, i + a, j + b, c] += v[c]
        return parts.sum(axis=0)

    @njit(parallel=True)
    def sampled_bands(image, radius, threads):  # type: ignore[no-untyped-def]
        rows, columns = radius.shape
        out = np.zeros((rows, columns, channels), np.float32)
        reach = int(radius.max()) + 1
        for t in prange(threads):
            low, high = t * rows // threads, (t + 1) * rows // threads
            v = np.empty(channels, np.float32)
            for i in range(max(0, low - reach), min(rows, high + reach)):
                for j in range(columns):
                    r = radius[i, j]
                    k = 0 if r < 0.5 else int(r)
                    count = _disc_taps(r) if k else 1
                    for c in range(channels):
                        v[c] = image[i, j, c] / count
                    for a in range(max(-k, low - i), min(k, high - 1 - i) + 1):
                        for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                            if a * a + b * b <= r * r or k == 0:
                                for c in range(channels):
                                    out[i + a, j + b, c] += v[c]
        return out

    @njit(parallel=True)
    def exact_private(image, radius, gx, gy, table, steps, threads):  # type: ignore[no-untyped-def]
        rows, columns = radius.shape
        parts = np.zeros((threads, rows, columns, channels), np.float32)
        for t in prange(threads):
            for i in range(t * rows // threads, (t + 1) * rows // threads):
                for j in range(columns):
                    r = radius[i, j]
                    k, u, s = int(np.ceil(r + 1.0)) - 1, r * steps, max(r, 1.0)
                    x, y = gx[i, j] / s, gy[i, j] / s
                    for a in range(max(-k, -i), min(k, rows - 1 - i) + 1):
                        for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                            w = max(0.0, 1.0 + b * x + a * y) * _tabulated(table, u, b, a)
                            for c in range(channels):
                                parts[t, i + a, j + b, c] += w * image[i, j, c]
        return parts.sum(axis=0)

    @njit(parallel=True)
    def exact_bands(image, radius, gx, gy, table, steps, threads):  # type: ignore[no-untyped-def]
        rows, columns = radius.shape
        out = np.zeros((rows, columns, channels), np.float32)
        reach = int(radius.max()) + 2
        for t in prange(threads):
            low, high = t * rows // threads, (t + 1) * rows // threads
            for i in range(max(0, low - reach), min(rows, high + reach)):
                for j in range(columns):
                    r = radius[i, j]
                    k, u, s = int(np.ceil(r + 1.0)) - 1, r * steps, max(r, 1.0)
                    x, y = gx[i, j] / s, gy[i, j] / s
                    for a in range(max(-k, low - i), min(k, high - 1 - i) + 1):
                        for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                            w = max(0.0, 1.0 + b * x + a * y) * _tabulated(table, u, b, a)
                            for c in range(channels):
                                out[i + a, j + b, c] += w * image[i, j, c]
        return out

    return Scatter(sampled_private, sampled_bands, exact_private, exact_bands)


@njit(parallel=True)
def gaussian_bands(image, radius, table, steps, cut, threads):  # type: ignore[no-untyped-def]
    """Direct scatter of the integrated Gaussian without tilt, each thread into its own rows.

    table (radii, |d|): weights along an axis, whose products are those of the PSF; it ends `cut` radii away, and 1 px.
    """
    rows, columns = image.shape
    out = np.zeros((rows, columns), np.float32)
    reach = int(radius.max() * cut) + 2
    for t in prange(threads):
        low, high = t * rows // threads, (t + 1) * rows // threads
        axis = np.zeros(2 * reach + 1, np.float32)
        for i in range(max(0, low - reach), min(rows, high + reach)):
            for j in range(columns):
                u = radius[i, j] * steps
                n, k = int(u), int(np.ceil(radius[i, j] * cut + 1.0)) - 1
                s = u - n
                for a in range(k + 1):
                    axis[reach + a] = axis[reach - a] = table[n, a] + s * (table[n + 1, a] - table[n, a])
                left, right = max(-k, -j), min(k, columns - 1 - j) + 1
                for a in range(max(-k, low - i), min(k, high - 1 - i) + 1):
                    v = image[i, j] * axis[reach + a]
                    for b in range(left, right):
                        out[i + a, j + b] += v * axis[reach + b]
    return out


@lru_cache(maxsize=2)
def axis_table(psf: Psf, largest: float, steps: int) -> Array:
    """Weights of a Gaussian along an axis (radii, |d|) at every 1/steps px, as a user would tabulate them."""
    offsets = np.arange(point_spread(psf).reach(largest) + 2, dtype=float)
    return (
        point_spread(psf).axis_weights(offsets, np.arange(int(largest * steps) + 3)[:, None] / steps).astype(np.float32)
    )


@lru_cache(maxsize=2)
def dense_table(largest: float, steps: int) -> Array:
    """Weights of the integrated disc (radii, |dx|, |dy|) at every 1/steps px, as a user would tabulate them."""
    offsets = np.arange(int(np.ceil(largest)) + 2, dtype=float)
    radii = np.arange(int(largest * steps) + 3) / steps
    table = np.empty((radii.size, offsets.size, offsets.size), np.float32)
    together = max(1, BLOCK // offsets.size**2)
    for start in range(0, radii.size, together):
        block = slice(start, start + together)
        table[block] = point_spread(Psf()).weights(
            offsets[None, :, None], offsets[None, None, :], radii[block, None, None]
        )
    return table
