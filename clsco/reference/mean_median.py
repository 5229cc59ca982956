"""Missing pixels: mean/median filling (thesis, chapter 5).

Values are arrays (H, W, K) of any channels, radiance and inverse depth alike.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from clsco.reference.geometry import Array
from clsco.reference.neighbors import NEIGHBORS, Bounds, Mask, Pixels, known_neighbors, neighbor_numbers

MINIMUM_COUNT = 4  # known neighbors that a pixel needs (chapter 5), fewer only where the filling would stall
SMOOTHING_ROUNDS = 20


def _median_of_known(near: Array, near_known: Mask) -> Array:
    """Median (N, K) over the first axis of values (8, N, K) that are known (8, N); of an even count the mean
    of the middle two. At least one is known."""
    ordered = np.sort(np.where(near_known[..., None], near, np.inf), axis=0)
    count = near_known.sum(axis=0)
    pixel = np.arange(count.size)
    return np.asarray(0.5 * (ordered[(count - 1) // 2, pixel] + ordered[count // 2, pixel]))


def _mean_of_known(near: Array, near_known: Mask) -> Array:
    """Mean (N, K) over the first axis of values (8, N, K) that are known (8, N). At least one is known."""
    return np.asarray(np.where(near_known[..., None], near, 0.0).sum(axis=0) / near_known.sum(axis=0)[:, None])


def score_mean_median(values: Array, known: Mask) -> tuple[Array, Array]:
    """Stage 0: sums of squared errors (9,) of mean and of median, estimating the center from k neighbors.

    values: (H, W, K); known: (H, W). Over all known pixels whose 8 neighbors exist and are known, all
    channels and all 163 subsets of k = 4..8 neighbors; entries below 4 are 0. The median wins a k only where
    its sum is strictly smaller. Validated against plain enumeration with numpy.mean and numpy.median.
    """
    whole = known.copy()
    whole[[0, -1], :] = whole[:, [0, -1]] = False
    for i, j in NEIGHBORS:
        whole &= np.roll(known, (-i, -j), axis=(0, 1))
    row, column = np.nonzero(whole)
    near, _ = known_neighbors(values, known, row, column)
    # Subsets of the sorted neighbors are the subsets of the neighbors, and their medians need no sorting.
    near = np.sort(near, axis=0)
    center = values[row, column]
    mean_error, median_error = np.zeros(9), np.zeros(9)
    for k in range(MINIMUM_COUNT, 9):
        for subset in combinations(range(8), k):
            mean = near[list(subset)].sum(axis=0) / k
            median = 0.5 * (near[subset[(k - 1) // 2]] + near[subset[k // 2]])
            mean_error[k] += float(((mean - center) ** 2).sum())
            median_error[k] += float(((median - center) ** 2).sum())
    return mean_error, median_error


def fill_mean_median(
    values: Array, known: Mask, missing: Mask, median_wins: Mask, minimum: int, bounds: Bounds = None
) -> tuple[Array, Mask, Pixels]:
    """Stage 1: one sweep; values (H, W, K) with what could be filled, which pixels those are (H, W), and from where.

    values: (H, W, K), inverse depth last; known, missing: (H, W), before the sweep; median_wins: (9,), per count of
    known neighbors; minimum: known neighbors that a pixel needs; bounds: on the inverse depth of those. Below 4 of
    them the mean is taken. From where: (H, W), number of the first of them, the pixel's own elsewhere.
    """
    row, column = np.nonzero(missing)
    near, near_known = known_neighbors(values, known, row, column, bounds)
    count = near_known.sum(axis=0)
    use = count >= max(minimum, 1)
    row, column, near, near_known, count = row[use], column[use], near[:, use], near_known[:, use], count[use]
    take_median = (median_wins & (np.arange(9) >= MINIMUM_COUNT))[count]
    value = np.where(take_median[:, None], _median_of_known(near, near_known), _mean_of_known(near, near_known))
    result, filled, source = values.copy(), np.zeros_like(known), np.arange(known.size).reshape(known.shape)
    result[row, column] = value
    filled[row, column] = True
    source[row, column] = neighbor_numbers(near_known.argmax(axis=0), row, column, known.shape[1])
    return result, filled, source


def smooth_median(values: Array, filled: Mask, valid: Mask, bounds: Bounds = None) -> Array:
    """Stage 2: one round of the 3x3 median without the center over the filled pixels.

    values: (H, W, K), inverse depth last; filled: (H, W), only these change; valid: (H, W), known or filled, only
    these serve, with bounds on their inverse depth.
    All pixels read the former round.
    """
    row, column = np.nonzero(filled)
    near, near_known = known_neighbors(values, valid, row, column, bounds)
    some = near_known.any(axis=0)
    result = values.copy()
    result[row[some], column[some]] = _median_of_known(near[:, some], near_known[:, some])
    return result
