"""Mean/median filling of warped frames (thesis, chapter 5); mean_median.py fills images with a mask.

Values are arrays (H, W, K) of any channels, radiance and inverse depth alike, in float32 or float64, in which all is
computed: in float32 every step is rounded as on a device.
"""

from __future__ import annotations

import numpy as np

from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.estimate import estimate, median_of_known
from clsco.reference.inpainting.neighbors import Bounds, Mask, Pixels, known_neighbors, neighbor_numbers


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
    value = estimate(near, near_known, median_wins)
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
    result[row[some], column[some]] = median_of_known(near[:, some], near_known[:, some])
    return result
