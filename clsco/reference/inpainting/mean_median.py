"""Mean/median filling of the holes of an image with a mask, all stages (thesis, chapter 5), over whole images.

Values are arrays (H, W, K) in float32; all steps are rounded as on a device.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inpainting.rules import Histogram, MeanMedian, Score, border_histogram, most_sweeps, score_scale
from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.fill_mean_median import fill_mean_median, smooth_median
from clsco.reference.inpainting.neighbors import Mask, count_neighbors
from clsco.reference.inpainting.score import score_mean_median


def sweep_holes(values: Array, known: Mask, missing: Mask, wins: Mask, minimum: int) -> tuple[Array, int]:
    """Stage 1: sweeps until no pixel is missing; values (H, W, K), and the number of sweeps that filled pixels.

    Arguments as for `fill_mean_median`; every missing pixel must be connected to a known one. If a sweep fills nothing,
    the minimum is reduced by one until a sweep fills pixels; after `most_sweeps` sweeps, the minimum is one.
    """
    sweeps, least, limit = 0, minimum, most_sweeps(*missing.shape)
    while missing.any():
        near = count_neighbors(known)
        values, filled, _ = fill_mean_median(values, known, missing & (near >= least), wins, least)
        known, missing = known | filled, missing & ~filled
        sweeps, least = (sweeps + 1, minimum) if filled.any() else (sweeps, least - 1)
        least = least if sweeps < limit else 1
    return values, sweeps


def blend_border(values: Array, border: Mask) -> tuple[Array, Array]:
    """Stage 3: squared magnitude of Sobel's gradient (N,), the largest over channels, and 3x3 medians (N, K).

    values: (H, W, K), border: (H, W), mask of N pixels, row by row. Beyond the image, its outermost pixels are
    repeated.
    """
    row, column = np.nonzero(border)
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    p = [padded[row + i, column + j] for i in range(3) for j in range(3)]
    across = (p[2] + 2 * p[5] + p[8]) - (p[0] + 2 * p[3] + p[6])
    down = (p[6] + 2 * p[7] + p[8]) - (p[0] + 2 * p[1] + p[2])
    square = across * across + down * down
    return square.max(axis=1, initial=0), np.sort(np.stack(p), axis=0)[4]


@dataclass(frozen=True, eq=False)
class Inpainted:
    """Images (H, W, K) after stages 1, 2 and 3, and intermediate results.

    border: (H, W), mask of known pixels beside holes; histogram: None if there are no such pixels.
    """

    filled: Array
    smoothed: Array
    blended: Array
    score: Score
    sweeps: int
    border: Mask
    histogram: Histogram | None


def inpaint(image: NDArray[Any], missing: Mask, span: float, constants: MeanMedian) -> Inpainted:
    """Fill missing pixels of an image.

    image: (H, W, K) float32, with any values at missing pixels; missing: (H, W), not all True; span: range of the
    values (`clsco.inpainting.rules.value_span`).
    """
    values = np.where(missing[..., None], np.float32(0), image)
    score = score_mean_median(values, ~missing, score_scale(span))
    wins = score.median_wins(constants.estimator)
    filled, sweeps = sweep_holes(values, ~missing, missing, wins, constants.minimum)
    smoothed = filled
    for _ in range(constants.smoothing_rounds):
        smoothed = smooth_median(smoothed, missing, np.ones_like(missing))  # stage 2
    border, histogram, blended = border_pixels(missing), None, smoothed.copy()
    if border.any():
        steepness, medians = blend_border(smoothed, border)
        gradients = np.sqrt(steepness.astype(np.float64))
        histogram = border_histogram(gradients, span / 255, constants.border_share)
        if histogram.threshold is not None:
            selected = gradients >= histogram.threshold
            blended[tuple(np.argwhere(border)[selected].T)] = medians[selected]
    return Inpainted(filled, smoothed, blended, score, sweeps, border, histogram)


def border_pixels(missing: Mask) -> Mask:
    """Mask (H, W) of known pixels with a missing one among their 8 neighbors."""
    return (count_neighbors(missing) > 0) & ~missing
