"""Missing pixels: their definition, adaptive interpolation (thesis, 4.3.5), and complete filling by either method.

Values are arrays (H, W, K) of any number of channels: the radiance, then the inverse depth. A pixel filled in a sweep
is used for others from the next sweep on, so the order of pixels within a sweep does not matter.

A moving edge uncovers the surface behind it. If a scene has surfaces at several depths, a hole is therefore filled from
its farther side only: for every missing pixel, `far_bounds` gives the largest inverse depth of the neighbors that may
be used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.constants import WIDEST_GAP
from clsco.inpainting.rules import MeanMedian, score_scale
from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.fill_mean_median import fill_mean_median, smooth_median
from clsco.reference.inpainting.neighbors import NEIGHBORS, Bounds, Mask, Pixels, known_neighbors, neighbor_numbers
from clsco.reference.inpainting.score import score_mean_median

Method = Literal["ait", "mean_median", "none"]
CHAPTER5 = MeanMedian()

FAR_SLACK = np.float32(1.02)  # relative; a surface at 45 degrees changes less over two pixels of 0.5 degrees each

KNOWN, FILLED, UNFILLED = np.uint8(0), np.uint8(1), np.uint8(2)


@dataclass(frozen=True)
class FillReport:
    """Counts of missing pixels in the frame: all, filled, unfilled, filled in the first sweep; and number of sweeps."""

    missing_pixels: int = 0
    filled_pixels: int = 0
    unfilled_pixels: int = 0
    sweeps: int = 0
    filled_first_sweep: int = 0


def find_spans(known: Mask) -> NDArray[np.int64]:
    """First and last known pixel (H + W, 2) of each row, then of each column; H + W and -1 for a line without any."""

    def ends(lines: Mask) -> NDArray[np.int64]:
        occupied = lines.any(axis=1)
        first = np.where(occupied, lines.argmax(axis=1), sum(known.shape))
        last = np.where(occupied, lines.shape[1] - 1 - lines[:, ::-1].argmax(axis=1), -1)
        return np.stack([first, last], axis=1)

    return np.concatenate([ends(known), ends(known.T)])


def mark_missing(known: Mask, allowed: Mask | None) -> Mask:
    """Mask of missing pixels (H, W): unknown ones between the first and last known pixel of their row or column.

    allowed: (H, W), mask of the pixels that may be missing (domain "surface"), or None for all (domain "span").
    """
    (rows, columns), spans = known.shape, find_spans(known)
    i, j = np.arange(rows)[:, None], np.arange(columns)[None, :]
    first, last = spans[:rows, :1], spans[:rows, 1:]
    top, bottom = spans[rows:].T
    missing: Mask = ~known & (((first < j) & (j < last)) | ((top < i) & (i < bottom)))
    return missing if allowed is None else missing & allowed


def far_bounds(w: Array, known: Mask, pixels: Mask) -> NDArray[np.float32]:
    """Largest inverse depth (H, W) in 1/mm of neighbors that `pixels` may be filled from; infinite elsewhere.

    w: (H, W) 1/mm. From each of `pixels`, known pixels are searched in both directions of the row, the column and both
    diagonals. The first of these four lines that finds a known pixel on both sides within the fewest steps is used: the
    bound is 1.02 times the smaller inverse depth of its two known pixels. Beside an edge that has moved away, this is
    the inverse depth of the far side; in a gap that a growing surface leaves, at most WIDEST_GAP px to each side, it is
    the inverse depth of the surface itself. A wider hole whose sides are equally deep may lie between two near objects.
    For such a hole, the line is used whose inverse depth, interpolated at the pixel between its ends, is the farthest,
    if it differs by more than the slack. Inverse depths are compared in float32, as on every device.
    """
    height, width = known.shape
    bound = np.full(known.shape, np.inf, dtype=np.float32)
    row, column = np.nonzero(pixels)
    ends = np.full((8, row.size), np.nan, dtype=np.float32)
    steps = np.zeros((8, row.size), dtype=np.float32)
    bounds, farthest = (np.full(row.size, np.inf, dtype=np.float32) for _ in range(2))
    settled, paired = np.zeros(row.size, dtype=bool), np.zeros(row.size, dtype=bool)
    for step in range(1, max(height, width)):
        for k, (i, j) in enumerate(NEIGHBORS):
            y, x = row + step * i, column + step * j
            reached = (y >= 0) & (y < height) & (x >= 0) & (x < width) & np.isnan(ends[k])
            reached[reached] = known[y[reached], x[reached]]
            ends[k, reached] = w[y[reached], x[reached]]
            steps[k, reached] = step
            if k % 2:
                (first_w, second_w), (near, far) = ends[k - 1 : k + 1], steps[k - 1 : k + 1]
                pair = ~settled & ~np.isnan(first_w) & ~np.isnan(second_w) & (np.maximum(near, far) == step)
                smaller, larger = np.minimum(first_w, second_w), np.maximum(first_w, second_w)
                interpolated = (first_w * far + second_w * near) / np.maximum(near + far, np.float32(1))
                first = pair & ~paired
                better = first | (pair & (FAR_SLACK * interpolated < farthest))
                bounds[better], farthest[better] = smaller[better], interpolated[better]
                settled |= first & ((larger > FAR_SLACK * smaller) | (step <= WIDEST_GAP))
                paired |= pair
        if settled.all():
            break
    bound[row[paired], column[paired]] = FAR_SLACK * bounds[paired]
    return bound


def _between_known(values: Array, known: Mask, far: bool) -> tuple[Array, Mask, Pixels]:
    """Linear interpolation along each row between the nearest known pixels on both sides.

    Also returns a mask of pixels that have known pixels on both sides, and the column of the first known pixel used.
    far: True to copy the known pixel at the greater depth instead if the depths differ by more than the slack.
    """
    (row, column), width = np.indices(known.shape), known.shape[1]
    left = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, column, width)[:, ::-1], axis=1)[:, ::-1]
    enclosed = (left >= 0) & (right < width)
    left, right = np.where(enclosed, left, 0), np.where(enclosed, right, 0)
    share = (column - left) / np.maximum(right - left, 1)
    if far:
        at_left, at_right = (values[row, end, -1].astype(np.float32) for end in (left, right))
        nearer_left, nearer_right = at_left > FAR_SLACK * at_right, at_right > FAR_SLACK * at_left
        left, right = np.where(nearer_left, right, left), np.where(nearer_right, left, right)
    low, high = values[row, left], values[row, right]
    return low + (high - low) * share[..., None], enclosed, left


def fill_ait(values: Array, known: Mask, missing: Mask, bounds: Bounds = None) -> tuple[Array, Mask, Pixels]:
    """One sweep of AIT: values (H, W, K) with newly filled pixels, a mask (H, W) of these, and source pixels (H, W).

    values: with the inverse depth last; known: before the sweep; bounds: on the inverse depth of neighbors. Inside the
    image, a pixel is the mean of the first opposite pair of known neighbors (horizontal, vertical, the two diagonals),
    or else a copy of the first known neighbor. On the outermost rows and columns, it is interpolated linearly between
    the nearest known pixels of the row, or else of the column; with bounds, the deeper of the two is copied if their
    depths differ by a factor above 1.02. Source pixels: for a filled pixel, the number of the first neighbor used; for
    others, their own number.
    """
    inside = missing.copy()
    inside[[0, -1], :] = inside[:, [0, -1]] = False
    row, column = np.nonzero(inside)
    near, near_known = known_neighbors(values, known, row, column, bounds)
    result, filled, source = values.copy(), np.zeros_like(known), np.arange(known.size).reshape(known.shape)
    paired = near_known[::2] & near_known[1::2]
    # The first of pairs, else of single neighbors, which then are the mean of themselves.
    first = np.where(paired.any(axis=0), 2 * paired.argmax(axis=0), near_known.argmax(axis=0))
    pixel, second = np.arange(row.size), first + paired.any(axis=0)
    value, valued = 0.5 * (near[first, pixel] + near[second, pixel]), near_known.any(axis=0)
    result[row[valued], column[valued]] = value[valued]
    filled[row[valued], column[valued]] = True
    source[row[valued], column[valued]] = neighbor_numbers(first, row, column, known.shape[1])[valued]
    border = missing & ~inside
    if border.any():
        far = bounds is not None
        along_row, in_row, left = _between_known(values, known, far)
        along_column, in_column, top = _between_known(values.swapaxes(0, 1), known.T, far)
        usable = border & (in_row | in_column.T)
        line = np.where(in_row[..., None], along_row, along_column.swapaxes(0, 1))
        result[usable] = line[usable]
        (at_row, at_column), width = np.indices(known.shape), known.shape[1]
        source[usable] = np.where(in_row, at_row * width + left, top.T * width + at_column)[usable]
        filled |= usable
    return result, filled, source


def fill_objects(
    values: Array, objects: NDArray[np.uint8], known: Mask, allowed: Mask | None, method: Method, guard: int,
    far: bool = True, brightest: float = 1.0,
) -> tuple[Array, NDArray[np.uint8], NDArray[np.uint8], FillReport]:  # fmt: skip
    """Fill pixels that a forward warp left missing: values (H, W, K), objects and status (H, W), and the report.

    values: radiance, then inverse depth; objects: number of the visible object, which a filled pixel copies from its
    source pixel; allowed: as for `mark_missing`; guard: px of the padded grid not counted in the report; far: True to
    fill holes from their farther side (`far_bounds`, computed when a pixel becomes missing); if that fills no more
    pixels, nearer neighbors are allowed for one sweep; brightest: largest radiance, for scores. Status: 0 known or
    outside, 1 filled, 2 missing but not filled. "mean_median" computes its scores from the radiance, and uses the same
    estimator for inverse depth. Sweeps that fill nothing do not count.
    """
    holes, valid = mark_missing(known, allowed), known
    frame = (slice(guard, known.shape[0] - guard), slice(guard, known.shape[1] - guard))
    bounds = far_bounds(values[..., -1], valid, holes) if far else None
    sweeps = first = 0
    median_wins = np.zeros(9, dtype=bool)
    if method == "mean_median" and holes.any():
        median_wins = score_mean_median(values[..., :-1], known, score_scale(brightest)).median_wins()
    while method != "none" and holes.any():
        # If no pixel can be filled, fewer neighbors are accepted, and finally (0) nearer ones.
        for minimum in range(1 if method == "ait" else CHAPTER5.minimum, -1 if far else 0, -1):
            within = bounds if minimum or bounds is None else np.full_like(bounds, np.inf)
            if method == "ait":
                swept, filled, source = fill_ait(values, valid, holes, within)
            else:
                swept, filled, source = fill_mean_median(values, valid, holes, median_wins, minimum, within)
            if filled.any():
                break
        if not filled.any():
            break
        values, objects = swept, objects.ravel()[source]
        sweeps += 1
        if sweeps == 1:
            first = int(filled[frame].sum())
        valid, missing = valid | filled, holes & ~filled
        # A pixel filled because of its row may be beyond the known pixels of its column, or vice versa.
        holes = missing | mark_missing(valid, allowed)
        if bounds is not None:
            new = holes & ~missing
            bounds = np.where(new, far_bounds(values[..., -1], valid, new), bounds)
    done = valid & ~known
    if method == "mean_median" and done.any():
        for _ in range(CHAPTER5.smoothing_rounds):
            values = smooth_median(values, done, valid, bounds)
    status = np.where(done, FILLED, np.where(holes, UNFILLED, KNOWN))
    done_pixels, left_pixels = int(done[frame].sum()), int(holes[frame].sum())
    report = FillReport(done_pixels + left_pixels, done_pixels, left_pixels, sweeps, first)
    return values, objects, status, report
