"""Exposure of a frame: the weighted sum of the blurred images of its time samples, in linear radiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clsco.reference.common.geometry import Array


def accumulate(total: Array, plane: Array, weights: ArrayLike) -> Array:
    """Running sum of an exposure: `total` plus `weights` times `plane`, both (m, n, C).

    weights: (m,) of rows, (1, n) of columns, or a number for all; those of an exposure sum to 1 in each of them.
    """
    each = np.asarray(weights)
    return np.asarray(total + (each.reshape(-1, 1) if each.ndim < 2 else each)[..., None] * plane)
