"""Mean/median filling of warped frames (thesis, chapter 5); mean_median.py fills images with a mask.

Values are arrays (H, W, K) of any number of channels, for radiance and inverse depth, in float32 or float64. The type
of the values is used for all computation; in float32 every step is rounded as on a device.
"""

from __future__ import annotations

import numpy as np

from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.estimate import estimate, median_of_known
from clsco.reference.inpainting.neighbors import Bounds, Mask, Pixels, known_neighbors, neighbor_numbers


def fill_mean_median(
    values: Array, known: Mask, missing: Mask, median_wins: Mask, minimum: int, bounds: Bounds = None
) -> tuple[Array, Mask, Pixels]:
    """Stage 1, one sweep: values (H, W, K) with newly filled pixels, a mask (H, W) of these pixels, and source pixels.

    values: (H, W, K), with the inverse depth last; known, missing: (H, W), before the sweep; median_wins: (9,), True to
    use the median, indexed by the number of known neighbors (below 4 the mean is always used); minimum: number of known
    neighbors that a pixel needs; bounds: on the inverse depth of neighbors. Source pixels (H, W): for a filled pixel,
    the number of the first neighbor used; for others, their own number.
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
    """Stage 2: one round of the 3x3 median, without the middle pixel, over the filled pixels.

    values: (H, W, K), with the inverse depth last; filled: (H, W), pixels to change; valid: (H, W), known or filled
    pixels, which may be read; bounds: on the inverse depth of pixels that are read. All pixels read the previous round.
    """
    row, column = np.nonzero(filled)
    near, near_known = known_neighbors(values, valid, row, column, bounds)
    usable = near_known.any(axis=0)
    result = values.copy()
    result[row[usable], column[usable]] = median_of_known(near[:, usable], near_known[:, usable])
    return result
