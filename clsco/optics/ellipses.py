"""Shapes of the blur of a round lens in a distorted image, which are ellipses (float64, pure)."""

from __future__ import annotations

import numpy as np

from clsco.optics.distortion import Array, Distortion


def shape_of(distortion: Distortion, x: Array, y: Array) -> Array:
    """Quadratic forms q (..., 3) of blur ellipses on rays of slopes x and y: det(J) J^-2, J the distortion's Jacobian.

    An offset (dx right, dy down) is inside if q0 dx^2 + 2 q1 dx dy + q2 dy^2 <= R^2, R the radius for the same area.
    """
    xx, xy, yy = distortion.jacobian(x, y)
    over = 1.0 / (xx * yy - xy * xy)
    return np.stack([(yy * yy + xy * xy) * over, xy * (xx + yy) * over, (xx * xx + xy * xy) * over], axis=-1)


def across_of(shape: Array) -> Array:
    """Square roots of the matrices `shape`, as xx, xy, yy (..., 3): they map offsets in ellipses to those in discs."""
    xx, xy, yy = np.moveaxis(np.asarray(shape), -1, 0)
    over = 1.0 / np.sqrt(xx + yy + 2.0)  # closed form of the root of a matrix of determinant 1
    return np.stack([(xx + 1.0) * over, xy * over, (yy + 1.0) * over], axis=-1)
