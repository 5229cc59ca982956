"""Missing pixels: mean/median filling (thesis, chapter 5).

Values are arrays (H, W, K) of any channels, radiance and inverse depth alike, in float32 or float64, in which all is
computed: in float32 every step is rounded as on a device.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from clsco.holes import COUNTS, Score
from clsco.reference.geometry import Array
from clsco.reference.neighbors import NEIGHBORS, Bounds, Mask, Pixels, known_neighbors, neighbor_numbers


def _median_of_known(near: Array, near_known: Mask) -> Array:
    """Median (N, K) over the first axis of values (8, N, K) that are known (8, N); of an even count the mean
    of the middle two. At least one is known."""
    ordered = np.sort(np.where(near_known[..., None], near, np.inf), axis=0)
    count = near_known.sum(axis=0)
    pixel = np.arange(count.size)
    return np.asarray(0.5 * (ordered[(count - 1) // 2, pixel] + ordered[count // 2, pixel]))


def _mean_of_known(near: Array, near_known: Mask) -> Array:
    """Mean (N, K) over the first axis of values (8, N, K) that are known (8, N). At least one is known."""
    total = np.zeros_like(near[0])
    for value, used in zip(near, near_known, strict=True):  # one after another: sum() may take another order
        total += np.where(used[:, None], value, 0.0)
    return np.asarray(total / near_known.sum(axis=0)[:, None].astype(near.dtype))


def score_mean_median(values: Array, known: Mask, scale: float) -> Score:
    """Stage 0: squared errors of mean and of median, estimating the center from k neighbors.

    values: (H, W, K), times `scale` rounded to whole numbers; known: (H, W). Over all known pixels whose 8 neighbors
    exist and are known, all channels and all 163 subsets of k = 4..8 neighbors.
    Validated against plain enumeration with numpy.mean and numpy.median.
    """
    whole = known.copy()
    whole[[0, -1], :] = whole[:, [0, -1]] = False
    for i, j in NEIGHBORS:
        whole &= np.roll(known, (-i, -j), axis=(0, 1))
    row, column = np.nonzero(whole)
    near, _ = known_neighbors(values, known, row, column)
    # Subsets of the sorted neighbors are the subsets of the neighbors, and their medians need no sorting.
    near = np.rint(np.sort(near, axis=0) * scale).astype(np.int64)
    center = np.rint(values[row, column] * scale).astype(np.int64)
    mean_error, median_error = [0] * 9, [0] * 9
    for k in COUNTS:
        for subset in combinations(range(8), k):
            mean = 2 * (near[list(subset)].sum(axis=0) - k * center)
            median = k * (near[subset[(k - 1) // 2]] + near[subset[k // 2]] - 2 * center)
            mean_error[k] += int((mean**2).sum())
            median_error[k] += int((median**2).sum())
    return Score(tuple(mean_error), tuple(median_error), center.size, scale)


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
    take_median = (median_wins & (np.arange(9) >= COUNTS.start))[count]
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


def settle_holes(known: Mask, missing: Mask, filled: Mask) -> tuple[Mask, Mask]:
    """Known pixels (H, W) after a sweep that has filled some, and which of the missing ones are beside them.

    known, missing: (H, W), before the sweep; filled: (H, W).
    """
    valid, left = known | filled, missing & ~filled
    row, column = np.nonzero(left)
    _, near_known = known_neighbors(valid[..., None], valid, row, column)
    beside = np.zeros_like(known)
    beside[row, column] = near_known.any(axis=0)
    return valid, beside


def blend_border(values: Array, border: Mask) -> tuple[Array, Array]:
    """Stage 3: squared magnitude of Sobel's gradient (N,), of the channels the largest, and 3x3 medians (N, K).

    values: (H, W, K), border: (H, W), N pixels of it, in the order of rows. Beyond the image its edge goes on.
    Validated against scipy.ndimage.
    """
    row, column = np.nonzero(border)
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    p = [padded[row + i, column + j] for i in range(3) for j in range(3)]
    across = (p[2] + 2 * p[5] + p[8]) - (p[0] + 2 * p[3] + p[6])
    down = (p[6] + 2 * p[7] + p[8]) - (p[0] + 2 * p[1] + p[2])
    square = across * across + down * down
    return square.max(axis=1, initial=0), np.sort(np.stack(p), axis=0)[4]
