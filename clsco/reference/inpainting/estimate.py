"""Mean and median of a pixel's known neighbors (thesis, chapter 5)."""

from __future__ import annotations

import numpy as np

from clsco.inpainting.rules import COUNTS
from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.neighbors import Mask


def median_of_known(near: Array, near_known: Mask) -> Array:
    """Median (N, K), over the first axis, of the known values among `near` (8, N, K).

    For an even number of known values, it is the mean of the middle two. near_known: (8, N), one or more True per
    pixel.
    """
    ordered, count = np.sort(np.where(near_known[..., None], near, np.inf), axis=0), near_known.sum(axis=0)
    pixel = np.arange(count.size)
    return np.asarray(0.5 * (ordered[(count - 1) // 2, pixel] + ordered[count // 2, pixel]))


def _mean_of_known(near: Array, near_known: Mask) -> Array:
    """Mean (N, K), over the first axis, of the known values among `near` (8, N, K); near_known: (8, N)."""
    total = np.zeros_like(near[0])
    for value, used in zip(near, near_known, strict=True):  # one after another: sum() may take another order
        total += np.where(used[:, None], value, 0.0)
    return np.asarray(total / near_known.sum(axis=0)[:, None].astype(near.dtype))


def estimate(near: Array, near_known: Mask, median_wins: Mask) -> Array:
    """Mean or median (N, K), over the first axis, of the known values among `near` (8, N, K).

    near_known: (8, N), at least one True per pixel; median_wins: (9,), True to use the median, indexed by the number of
    known values. Below 4 known values the mean is used.
    """
    take_median = (median_wins & (np.arange(9) >= COUNTS.start))[near_known.sum(axis=0)]
    return np.where(take_median[:, None], median_of_known(near, near_known), _mean_of_known(near, near_known))
