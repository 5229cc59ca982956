"""Fills holes of an image tile by tile, so that memory besides the image does not depend on the image's size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ArgumentError

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Progress = Callable[[float], None]

TILE = 832
MARGIN = 96  # px around a tile that are read to fill it; an image of up to TILE + 2 MARGIN px is one tile


def no_progress(done: float) -> None:
    """Ignore the progress."""


def fill_in_tiles(
    image: NDArray[Any], missing: Mask, fill: Callable[[Image, Mask], Image], progress: Progress = no_progress
) -> Image:
    """Values (N, K) of the N missing pixels (H, W) of an image (H, W, K) of any type, row by row.

    fill: function of a part of the image and a mask of its holes that returns the part with its holes filled. Known
    values in the part are scaled to 0 to 1 in each channel, and results are clipped to 0 to 1. Tiles are filled row by
    row, each with a margin of MARGIN px in which previously filled values count as known; tiles without a known pixel
    are deferred. Only one tile at a time is held as floats. Raises ArgumentError if no pixel of the image is known.
    """
    if missing.all():
        raise ArgumentError(f"missing: must leave a pixel known; got all {missing.size} missing")
    left, pixels = missing.copy(), np.flatnonzero(missing)
    values = np.zeros((pixels.size, image.shape[2]), np.float32)
    tiles = [tile for tile in _tiles(missing.shape) if missing[tile[0]].any()]
    total, done = len(tiles), 0
    while tiles:
        waiting = []
        for tile, around in tiles:
            if left[around].all():
                waiting.append((tile, around))
                continue
            part = image[around].astype(np.float32)
            among, row, column = _within(around, pixels, missing.shape[1])
            part[row, column] = values[among]
            part = _filled(part, left[around], fill)
            axes = zip(tile, around, (row, column), strict=True)
            own = np.logical_and(*((a.start + k >= t.start) & (a.start + k < t.stop) for t, a, k in axes))
            values[among[own]] = part[row[own], column[own]]
            left[tile] = False
            done += 1
            progress(done / total)
        tiles = waiting
    return values


def _within(
    part: tuple[slice, ...], pixels: NDArray[np.int64], columns: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Indices of those pixels that are in a part of an image, and their rows and columns in the part.

    pixels: (N,), ascending numbers of pixels in an image of `columns` columns; the indices are those in this array.
    """
    first, end = np.searchsorted(pixels, (part[0].start * columns, part[0].stop * columns))
    row, column = np.divmod(pixels[first:end], columns)
    inside = np.flatnonzero((column >= part[1].start) & (column < part[1].stop))
    return first + inside, row[inside] - part[0].start, column[inside] - part[1].start


def _tiles(shape: tuple[int, ...]) -> list[tuple[tuple[slice, ...], tuple[slice, ...]]]:
    """Rows and columns of each tile, without and with its margin."""
    axes: list[list[tuple[slice, slice]]] = []
    for size in shape:
        step = TILE if size > TILE + 2 * MARGIN else size
        starts = range(0, size, step)
        ends = [(start, min(start + step, size)) for start in starts]
        axes.append([(slice(a, b), slice(max(a - MARGIN, 0), min(b + MARGIN, size))) for a, b in ends])
    return [((rows[0], columns[0]), (rows[1], columns[1])) for rows in axes[0] for columns in axes[1]]


def _filled(image: Image, missing: Mask, fill: Callable[[Image, Mask], Image]) -> Image:
    known: Any = image[~missing]
    low, high = known.min(axis=0), known.max(axis=0)
    scale = np.where(high > low, high - low, np.float32(1))
    return np.clip(fill((image - low) / scale, missing) * scale + low, low, high)
