"""Blur of a round lens in a distorted image: weights of ellipses (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.optics.distortion import Distortion

Array = NDArray[np.float64]
FLAT = 1.5
"""Distance, px, of columns from the end of an ellipse from which on chords up to them are FEW, and nearer by MANY."""
FEW, MANY = (
    ((0.5 - 0.5 / 3.0**0.5, 0.5), (0.5 + 0.5 / 3.0**0.5, 0.5), (0.5, 0.0), (0.5, 0.0)),
    tuple(
        (0.5 + 0.5 * sign * (3.0 / 7.0 + turn * 2.0 / 7.0 * 1.2**0.5) ** 0.5, 0.25 - turn * 30.0**0.5 / 72.0)
        for sign, turn in ((-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0))
    ),
)
"""Gauss-Legendre nodes on 0 to 1, with their weights; as many of both."""
DISC = (1.0, 0.0, 1.0)
"""Shape of a disc, see `shape_of`."""
ROUND, WHOLE = 1.0, 2.0  # px, R up to which blur is a disc, and from which on an ellipse


def shape_of(distortion: Distortion, x: Array, y: Array) -> Array:
    """Quadratic form (..., 3) of the image of a small disc on rays of slopes x and y, down and right: offsets (dx, dy)
    with q0 dx^2 + 2 q1 dx dy + q2 dy^2 <= R^2 are in the image of the disc of the same area, of radius R. It is
    det J times J^-2."""
    xx, xy, yy = distortion.jacobian(x, y)
    over = 1.0 / (xx * yy - xy * xy)
    return np.stack([(yy * yy + xy * xy) * over, xy * (xx + yy) * over, (xx * xx + xy * xy) * over], axis=-1)


def ellipse_share(radius: Array) -> Array:
    """Share of the ellipse in the blur of |radius| px, whose rest is a disc: those of few pixels differ by little."""
    return np.clip((np.abs(radius) - ROUND) / (WHOLE - ROUND), 0.0, 1.0)


def ellipse_weights(dx: Array, dy: Array, radius: Array, shape: Array) -> Array:
    """Share of the light of an ellipse, from a square pixel, in a square pixel at (dx, dy) px.

    Parameters
    ----------
    dx, dy : ndarray
        Integers, right and down.
    radius : ndarray
        |R| of the disc of the same area, px, above 0.
    shape : ndarray of float64, (..., 3)
        See `shape_of`. All broadcast.

    Returns
    -------
    ndarray of float64

    Notes
    -----
    Chords along columns, in closed form over both pixels, times the tent of both pixels across them: before and after
    the middle of a column a few chords, and near the end of the ellipse, where they are steep, more by nodes of the
    root of their distance from it. Sums over pixels differ from 1 by less than 1e-5, second moments from
    R^2/4 J J^T / det J + 1/6 by 4e-3 at R = 2, 4e-4 at 4 and 2e-5 at 10 px. Validated against the integral.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.ellipses import ellipse_weights
    >>> x = np.arange(-9.0, 10.0)
    >>> flat = ellipse_weights(x, x[:, None], np.asarray(6.0), np.array([0.8, 0.0, 1.25]))
    >>> float(flat.sum().round(3)), float((flat * x * x).sum().round(1)), float((flat.T * x * x).sum().round(1))
    (1.0, 11.4, 7.4)
    """
    q0, q1, q2 = np.moveaxis(np.asarray(shape), -1, 0)
    most, total = radius * np.sqrt(q2), np.zeros(np.broadcast(dx, dy, q0, radius).shape)
    for side in (-1.0, 0.0):
        right = dx + side >= 0.0
        near = np.where(right, dx + side, -1.0 - dx - side)  # from the middle of the ellipse, of the two columns
        flat, start = near + 1.0 + FLAT <= most, np.sqrt(np.maximum(most - near - 1.0, 0.0))
        width = np.sqrt(np.maximum(most - near, 0.0)) - start
        for (few, few_parts), (many, many_parts) in zip(FEW, MANY, strict=True):
            at = start + width * many
            rest = np.where(flat, most - near - few, at * at)  # from the end of the ellipse
            v = np.where(right, 1.0, -1.0) * (most - rest)
            half, middle = np.sqrt(rest * (2.0 * most - rest)) / q2, -q1 * v / q2 - dy
            part = np.where(flat, few_parts, 2.0 * at * width * many_parts) * (1.0 - np.abs(v - dx))
            total += part * (_below(middle + half) - _below(middle - half))
    return np.asarray(total / (np.pi * radius * radius))


def point_weights(dx: Array, dy: Array, radius: Array, shape: Array) -> Array:
    """Share of the light of an ellipse, from a point, in a square pixel at (dx, dy) px.

    Parameters
    ----------
    dx, dy : ndarray
        Right and down.
    radius, shape : ndarray
        As for `ellipse_weights`.

    Returns
    -------
    ndarray of float64

    Notes
    -----
    Chords along columns at nodes of the root of their distance from the end of the ellipse. Sums over pixels differ
    from 1 by less than 1e-5. Validated against the integral.
    """
    q0, q1, q2 = np.moveaxis(np.asarray(shape), -1, 0)
    most, total = radius * np.sqrt(q2), np.zeros(np.broadcast(dx, dy, q0, radius).shape)
    near = np.abs(dx) - 0.5
    start = np.sqrt(np.maximum(most - near - 1.0, 0.0))
    width = np.sqrt(np.maximum(most - near, 0.0)) - start
    for many, part in MANY:
        at = start + width * many
        rest = at * at
        half = np.sqrt(np.maximum(rest * (2.0 * most - rest), 0.0)) / q2
        middle = np.where(dx >= 0.0, -q1, q1) * (most - rest) / q2 - dy
        total += 2.0 * at * width * part * (np.clip(middle + half, -0.5, 0.5) - np.clip(middle - half, -0.5, 0.5))
    return np.asarray(total / (np.pi * radius * radius))


def across_of(shape: Array) -> Array:
    """Matrix (..., 3), xx, xy and yy, that takes offsets in ellipses to those in the discs of their areas: the root of
    the form `shape` (..., 3)."""
    xx, xy, yy = np.moveaxis(np.asarray(shape), -1, 0)
    over = 1.0 / np.sqrt(xx + yy + 2.0)  # of a matrix of determinant 1
    return np.stack([(xx + 1.0) * over, xy * over, (yy + 1.0) * over], axis=-1)


def _below(t: Array) -> Array:
    """Integral of the tent of both pixels up to t."""
    t = np.clip(t, -1.0, 1.0)
    return 0.5 + t - 0.5 * t * np.abs(t)
