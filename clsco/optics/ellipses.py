"""Shapes of the blur of a round lens in a distorted image, which are ellipses (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.optics.distortion import Distortion

Array = NDArray[np.float64]


def shape_of(distortion: Distortion, x: Array, y: Array) -> Array:
    """Blur ellipses on rays of slopes x and y, as quadratic forms (..., 3): offsets (dx right, dy down) with q0 dx^2 +
    2 q1 dx dy + q2 dy^2 <= R^2 are inside, where R is the radius of the disc of the same area. The form is det J times
    J^-2, with J the Jacobian of the distortion.
    """
    xx, xy, yy = distortion.jacobian(x, y)
    over = 1.0 / (xx * yy - xy * xy)
    return np.stack([(yy * yy + xy * xy) * over, xy * (xx + yy) * over, (xx * xx + xy * xy) * over], axis=-1)


def across_of(shape: Array) -> Array:
    """Matrix (..., 3), xx, xy and yy, that maps offsets in ellipses to offsets in discs of the same area: the square
    root of `shape` (..., 3).
    """
    xx, xy, yy = np.moveaxis(np.asarray(shape), -1, 0)
    over = 1.0 / np.sqrt(xx + yy + 2.0)  # of a matrix of determinant 1
    return np.stack([(xx + 1.0) * over, xy * over, (yy + 1.0) * over], axis=-1)
