"""Missing pixels: adaptive interpolation (thesis, 4.3.5) and mean/median filling (chapter 5).

Values are arrays (H, W, K) of any channels, radiance and inverse depth alike. A pixel filled in a sweep
serves others from the next sweep on, so the order of pixels within a sweep does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.reference.geometry import Array

Mask = NDArray[np.bool_]
Method = Literal["ait", "mean_median", "none"]

# Rows down, columns right: W E, N S, NW SE, NE SW. Opposite neighbors are pairs.
NEIGHBORS = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1))
MINIMUM_COUNT = 4  # known neighbors that a pixel needs (chapter 5), fewer only where the filling would stall
SMOOTHING_ROUNDS = 20

KNOWN, FILLED, UNFILLED = np.uint8(0), np.uint8(1), np.uint8(2)


@dataclass(frozen=True)
class FillReport:
    """Missing pixels within the frame: all, filled, left, filled in the first sweep; number of sweeps."""

    missing_pixels: int = 0
    filled_pixels: int = 0
    unfilled_pixels: int = 0
    sweeps: int = 0
    filled_first_sweep: int = 0


def find_spans(known: Mask) -> NDArray[np.int64]:
    """First and last known pixel (H + W, 2) of each row and then of each column; (H + W, -1) for none.

    known: (H, W).
    """

    def ends(lines: Mask) -> NDArray[np.int64]:
        some = lines.any(axis=1)
        first = np.where(some, lines.argmax(axis=1), sum(known.shape))
        last = np.where(some, lines.shape[1] - 1 - lines[:, ::-1].argmax(axis=1), -1)
        return np.stack([first, last], axis=1)

    return np.concatenate([ends(known), ends(known.T)])


def mark_missing(known: Mask, allowed: Mask | None) -> Mask:
    """Missing pixels (H, W): unknown, strictly between the first and last known of their row, else column.

    known: (H, W); allowed: (H, W), only these may be missing (domain "surface"), or None (domain "span").
    """
    (rows, columns), spans = known.shape, find_spans(known)
    i, j = np.arange(rows)[:, None], np.arange(columns)[None, :]
    first, last = spans[:rows, :1], spans[:rows, 1:]
    top, bottom = spans[rows:].T
    missing = ~known & (((first < j) & (j < last)) | ((top < i) & (i < bottom)))
    return missing if allowed is None else missing & allowed


def settle_sweep(known: Mask, missing: Mask, filled: Mask) -> tuple[Mask, Mask]:
    """Known and missing pixels (H, W) after a sweep that has filled some.

    known, missing: (H, W), before the sweep; filled: (H, W).
    """
    return known | filled, missing & ~filled


def mark_grown(known: Mask, missing: Mask, allowed: Mask | None) -> Mask:
    """Missing pixels (H, W) after known pixels were added to those between which `missing` (H, W) were.

    known, allowed: as for `mark_missing`. There are new ones where a pixel was filled for the sake of its row,
    which lies beyond what was known of its column, or the other way round.
    """
    return missing | mark_missing(known, allowed)


def _neighbors(values: Array, known: Mask, row: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[Array, Mask]:
    """Values (8, N, K) and knowledge (8, N) of the neighbors of N pixels, unknown outside of the array."""
    edge = ((1, 1), (1, 1))
    padded_values = np.pad(values, (*edge, (0, 0)))
    padded_known = np.pad(known, edge)
    at = [(row + 1 + i, column + 1 + j) for i, j in NEIGHBORS]
    return np.stack([padded_values[p] for p in at]), np.stack([padded_known[p] for p in at])


def _nearest_known(known: Mask) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Column of the nearest known pixel to the left (-1: none) and right (width: none) of every pixel."""
    width = known.shape[1]
    column = np.arange(width)
    left = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, column, width)[:, ::-1], axis=1)[:, ::-1]
    return left, right


def _between_known(values: Array, known: Mask) -> tuple[Array, Mask]:
    """Linear interpolation along each row between the nearest known pixels, and where both exist."""
    left, right = _nearest_known(known)
    both = (left >= 0) & (right < known.shape[1])
    left, right = np.where(both, left, 0), np.where(both, right, 0)
    row, column = np.arange(known.shape[0])[:, None], np.arange(known.shape[1])[None, :]
    share = (column - left) / np.maximum(right - left, 1)
    low, high = values[row, left], values[row, right]
    return low + (high - low) * share[..., None], both


def fill_ait(values: Array, known: Mask, missing: Mask) -> tuple[Array, Mask]:
    """One sweep of AIT: values (H, W, K) with what could be filled, and which pixels those are (H, W).

    values: (H, W, K); known: (H, W), before the sweep; missing: (H, W), not yet filled. Inside: the mean of
    the first opposite pair of known neighbors (horizontal, vertical, the two diagonals), else a copy of the
    first known neighbor. On the outermost rows and columns: linear between the nearest known pixels of the
    row, else of the column. Validated on the thesis' figures 4.14 and 4.15 and on random masks.
    """
    inside = missing.copy()
    inside[[0, -1], :] = inside[:, [0, -1]] = False
    row, column = np.nonzero(inside)
    near, near_known = _neighbors(values, known, row, column)
    result, filled = values.copy(), np.zeros_like(known)
    value, found = np.zeros((row.size, values.shape[2])), np.zeros(row.size, dtype=bool)
    for pair in range(0, 8, 2):
        use = near_known[pair] & near_known[pair + 1] & ~found
        value[use] = 0.5 * (near[pair] + near[pair + 1])[use]
        found |= use
    for k in range(8):
        use = near_known[k] & ~found
        value[use] = near[k][use]
        found |= use
    result[row[found], column[found]] = value[found]
    filled[row[found], column[found]] = True
    border = missing & ~inside
    if border.any():
        along_row, in_row = _between_known(values, known)
        along_column, in_column = _between_known(values.swapaxes(0, 1), known.T)
        usable = border & (in_row | in_column.T)
        line = np.where(in_row[..., None], along_row, along_column.swapaxes(0, 1))
        result[usable] = line[usable]
        filled |= usable
    return result, filled


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
    near, _ = _neighbors(values, known, row, column)
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


def fill_mean_median(values: Array, known: Mask, missing: Mask, median_wins: Mask, minimum: int) -> tuple[Array, Mask]:
    """Stage 1: one sweep; values (H, W, K) with what could be filled, and which pixels those are (H, W).

    values: (H, W, K); known, missing: (H, W), before the sweep; median_wins: (9,), per count of known
    neighbors; minimum: known neighbors that a pixel needs. Below 4 of them the mean is taken.
    """
    row, column = np.nonzero(missing)
    near, near_known = _neighbors(values, known, row, column)
    count = near_known.sum(axis=0)
    use = count >= max(minimum, 1)
    row, column, near, near_known, count = row[use], column[use], near[:, use], near_known[:, use], count[use]
    take_median = (median_wins & (np.arange(9) >= MINIMUM_COUNT))[count]
    value = np.where(take_median[:, None], _median_of_known(near, near_known), _mean_of_known(near, near_known))
    result, filled = values.copy(), np.zeros_like(known)
    result[row, column] = value
    filled[row, column] = True
    return result, filled


def smooth_median(values: Array, filled: Mask, valid: Mask) -> Array:
    """Stage 2: one round of the 3x3 median without the center over the filled pixels.

    values: (H, W, K); filled: (H, W), only these change; valid: (H, W), known or filled, only these serve.
    All pixels read the former round.
    """
    row, column = np.nonzero(filled)
    near, near_known = _neighbors(values, valid, row, column)
    some = near_known.any(axis=0)
    result = values.copy()
    result[row[some], column[some]] = _median_of_known(near[:, some], near_known[:, some])
    return result


def fill(
    values: Array, known: Mask, allowed: Mask | None, method: Method, guard: int
) -> tuple[Array, NDArray[np.uint8], FillReport]:
    """Fill what a forward warp left: values (H, W, K), status (H, W) and the report.

    values: (H, W, K), radiance and then inverse depth; known: (H, W); allowed: as for `mark_missing`; guard:
    px of the padded grid that do not count in the report. Status: 0 known or outside, 1 filled, 2 missing but
    could not be filled. "mean_median" scores on the radiance and fills inverse depth by the same rule.
    Before each sweep missing pixels are those between known or filled ones. Sweeps that fill nothing do not
    count.
    """
    left, valid = mark_missing(known, allowed), known
    frame = (slice(guard, known.shape[0] - guard), slice(guard, known.shape[1] - guard))
    sweeps = first = 0
    median_wins = np.zeros(9, dtype=bool)
    if method == "mean_median" and left.any():
        mean_error, median_error = score_mean_median(values[..., :-1], known)
        median_wins = median_error < mean_error
    while method != "none" and left.any():
        if method == "ait":
            values, filled = fill_ait(values, valid, left)
        else:
            for minimum in range(MINIMUM_COUNT, 0, -1):
                swept, filled = fill_mean_median(values, valid, left, median_wins, minimum)
                if filled.any():
                    break
            values = swept
        if not filled.any():
            break
        sweeps += 1
        if sweeps == 1:
            first = int(filled[frame].sum())
        valid, left = settle_sweep(valid, left, filled)
        left = mark_grown(valid, left, allowed)
    done = valid & ~known
    if method == "mean_median" and done.any():
        for _ in range(SMOOTHING_ROUNDS):
            values = smooth_median(values, done, valid)
    status = np.where(done, FILLED, np.where(left, UNFILLED, KNOWN))
    done_pixels, left_pixels = int(done[frame].sum()), int(left[frame].sum())
    report = FillReport(done_pixels + left_pixels, done_pixels, left_pixels, sweeps, first)
    return values, status, report
