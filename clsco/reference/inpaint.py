"""Inpainting by mean and median (thesis, chapter 5), all stages over whole images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.holes import Histogram, MeanMedian, Score, border_histogram, score_scale
from clsco.reference.mean_median import (
    blend_border,
    fill_mean_median,
    score_mean_median,
    settle_holes,
    smooth_median,
)
from clsco.reference.neighbors import NEIGHBORS, Mask


@dataclass(frozen=True, eq=False)
class Inpainted:
    """Images (H, W, K) float32 after stages 1, 2 and 3, and what they were made by; sweeps that fill nothing do not
    count; border: (H, W), known pixels beside holes; histogram: None where there are none."""

    filled: NDArray[np.float32]
    smoothed: NDArray[np.float32]
    blended: NDArray[np.float32]
    score: Score
    sweeps: int
    border: Mask
    histogram: Histogram | None


def inpaint(image: NDArray[np.float32], missing: Mask, span: float, constants: MeanMedian) -> Inpainted:
    """Fill missing pixels of an image, all arithmetic in float32.

    image: (H, W, K), what missing pixels hold does not matter; missing: (H, W), not all of it; span: range of
    the values (`clsco.holes.value_span`).
    """
    known = ~missing
    values = np.where(missing[..., None], np.float32(0), image)
    score = score_mean_median(values, known, score_scale(span))
    wins, valid, sweeps = score.median_wins(constants.estimator), known, 0
    while not valid.all():
        for minimum in range(constants.minimum, 0, -1):  # fewer neighbors will do where the filling would stall
            swept, new, _ = fill_mean_median(values, valid, ~valid, wins, minimum)
            if new.any():
                break
        values, sweeps = swept, sweeps + 1
        valid, _ = settle_holes(valid, ~valid, new)
    smoothed = values
    for _ in range(constants.smoothing_rounds):
        smoothed = smooth_median(smoothed, missing, valid)
    border, histogram, blended = beside(missing), None, smoothed.copy()
    if border.any():
        steepness, medians = blend_border(smoothed, border)
        gradients = np.sqrt(steepness.astype(np.float64))
        histogram = border_histogram(gradients, span / 255, constants.border_share)
        if histogram.threshold is not None:
            taken = gradients >= histogram.threshold
            blended[tuple(np.argwhere(border)[taken].T)] = medians[taken]
    return Inpainted(values, smoothed, blended, score, sweeps, border, histogram)


def beside(missing: Mask) -> Mask:
    """Known pixels (H, W) with a missing one among their 8 neighbors."""
    padded, (rows, columns) = np.pad(missing, 1), missing.shape
    near = [padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns] for i, j in NEIGHBORS]
    return np.logical_or.reduce(near) & ~missing
