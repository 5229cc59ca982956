"""The eight neighbors of a pixel, from which a missing pixel is filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.reference.common.geometry import Array

Mask = NDArray[np.bool_]
Bounds = NDArray[np.float32] | None
"""Largest inverse depth (H, W) in 1/mm of neighbors that may fill a pixel, from `far_bounds`; None for no limit."""
Pixels = NDArray[np.int64]

# Rows down, columns right: W E, N S, NW SE, NE SW. Opposite neighbors are pairs.
NEIGHBORS = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1))


def count_neighbors(mask: Mask) -> NDArray[np.uint8]:
    """Number (H, W) of each pixel's neighbors that are True; neighbors outside of the array are not counted."""
    padded, (rows, columns) = np.pad(mask.astype(np.uint8), 1), mask.shape
    return np.sum([padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns] for i, j in NEIGHBORS], 0, np.uint8)


def known_neighbors(
    values: Array, known: Mask, row: Pixels, column: Pixels, bounds: Bounds = None
) -> tuple[Array, Mask]:
    """Values (8, N, K) of the neighbors of N pixels, and a mask (8, N) of known ones within the array and the bounds.

    values: (H, W, K), with the inverse depth last; bounds: on the neighbors' inverse depth.
    """
    padded_values, padded_known = np.pad(values, ((1, 1), (1, 1), (0, 0))), np.pad(known, 1)
    at = [(row + 1 + i, column + 1 + j) for i, j in NEIGHBORS]
    near, near_known = np.stack([padded_values[p] for p in at]), np.stack([padded_known[p] for p in at])
    if bounds is not None:
        near_known &= near[..., -1].astype(np.float32) <= bounds[row, column]
    return near, near_known


def neighbor_numbers(k: Pixels, row: Pixels, column: Pixels, width: int) -> Pixels:
    """Pixel numbers (N,), row by row, of the neighbors k (N,) of N pixels in an array `width` columns wide."""
    down, right = np.array(NEIGHBORS)[k].T
    return np.asarray((row + down) * width + column + right)
