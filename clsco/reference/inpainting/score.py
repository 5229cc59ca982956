"""Scores of the neighbors' mean and median as estimates of known pixels (thesis, chapter 5)."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from clsco.inpainting.rules import COUNTS, Score
from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.neighbors import Mask, count_neighbors, known_neighbors


def score_mean_median(values: Array, known: Mask, scale: float) -> Score:
    """Stage 0: squared errors of the mean and of the median of k neighbors as estimates of the pixel between them.

    values: (H, W, K), which are multiplied by `scale` and rounded to integers; known: (H, W). Errors are summed over
    all known pixels whose 8 neighbors exist and are known, all channels, and all 163 subsets of k = 4..8 neighbors.
    """
    row, column = np.nonzero(known & (count_neighbors(known) == 8))
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
