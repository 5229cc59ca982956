"""Holes of an image: their filling order, and changes of resolution; shared by device and reference."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Mask = NDArray[np.bool_]

# Settings of the biharmonic solver. FINER_GAIN is the weight of splines relative to splines of half the size, as they
# have 1/4 of the energy. FIRST_GAIN is the weight of the smallest splines relative to single pixels. It is larger, as
# pixels are no splines; the number of steps hardly changes if it is 2 to 4 times FINER_GAIN.
FIRST_GAIN, FINER_GAIN = 12.0, 4.0
TOLERANCE = 1e-4  # ratio of final to first residual, in the preconditioner's norm: errors are then about -60 dB
MOST_STEPS = 500  # limit of the number of steps; holes from single pixels to 300 px need 12 to 90


def block_turns(missing: Mask, block: int) -> NDArray[np.int64]:
    """Turn, from 0, in which each block (ceil(H / block), ceil(W / block)) is filled; -1 without missing pixels.

    missing: (H, W), not all True; block: side of a block, px. Filling goes inwards ring by ring; within a ring, first
    the black squares of a chessboard of blocks are filled, then the white ones. A block with known pixels is in ring 0;
    a fully missing block is in ring n if its chessboard distance to the nearest block with known pixels is n blocks.
    Two passes compute this exactly (Rosenfeld and Pfaltz 1968).
    """
    rows, columns = missing.shape
    padding = ((0, -rows % block), (0, -columns % block))
    shape = (-(-rows // block), block, -(-columns // block), block)
    wholly = np.pad(missing, padding, constant_values=True).reshape(shape).all(axis=(1, 3))
    partly = np.pad(missing, padding).reshape(shape).any(axis=(1, 3))
    place = np.arange(shape[2])
    rings = np.where(wholly, rows + columns, 0)
    for order in (np.s_[:], np.s_[::-1]):
        turned = rings[order, order]
        before = np.full(shape[2] + 2, rows + columns)
        for row in turned:
            nearest = np.minimum(np.minimum(before[:-2], before[1:-1]), before[2:]) + 1
            row[:] = np.minimum.accumulate(np.minimum(row, nearest) - place) + place
            before[1:-1] = row
    return np.where(partly, 2 * rings + (np.arange(shape[0])[:, None] + place) % 2, -1)


def halved(image: Array, missing: Mask) -> tuple[Array, Mask]:
    """An image (H, W, K) and its holes (H, W) at half the size, rounded up: means of known pixels in 2 x 2 blocks."""
    rows, columns = missing.shape
    padding = ((0, rows % 2), (0, columns % 2))
    known = np.pad(~missing, padding)
    values = np.where(known[..., None], np.pad(image, (*padding, (0, 0))), 0)
    corners = [np.s_[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    count = sum(known[corner].astype(image.dtype) for corner in corners)
    total = sum(values[corner] for corner in corners)
    return np.asarray(total / np.maximum(count, 1)[..., None]), np.asarray(count == 0)


def doubled(coarse: Array, missing: Mask) -> Array:
    """Values (N, K) of a half-size image (ceil(H / 2), ceil(W / 2), K) at the N pixels of `missing` (H, W), row by row.

    They are interpolated linearly between the centers of coarse pixels, and are constant beyond the outermost centers.
    """
    row, column = np.nonzero(missing)
    result: Array = np.zeros((row.size, coarse.shape[2]), coarse.dtype)
    ends = [size - 1 for size in coarse.shape[:2]]
    for i in (0, 1):
        for j in (0, 1):
            # The nearer coarse pixel counts 3/4, the other 1/4, along each axis.
            y = np.clip(row // 2 + (row % 2 * 2 - 1) * i, 0, ends[0])
            x = np.clip(column // 2 + (column % 2 * 2 - 1) * j, 0, ends[1])
            result += (0.25 if i else 0.75) * (0.25 if j else 0.75) * coarse[y, x]
    return result


def spline_holes(missing: Mask) -> Mask:
    """Mask (ceil(H / 2), ceil(W / 2)) of coarse pixels whose quadratic B-splines lie entirely in the holes (H, W).

    A coarse pixel is twice as wide as a fine one. Along each axis, the spline of coarse pixel k is a sum of the splines
    of the fine pixels 2 k - 1 to 2 k + 2; pixels beyond the border are ignored.
    """
    for _ in range(2):
        half = (len(missing) + 1) // 2
        padded = np.pad(missing, ((1, 2), (0, 0)), constant_values=True)
        parts = [padded[k : k + 2 * half : 2] for k in range(4)]
        missing = np.logical_and.reduce(parts).T
    return missing
