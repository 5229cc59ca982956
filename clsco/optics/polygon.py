"""Blur of a polygonal iris: exact areas by Green's theorem along its edges (float64, pure).

Axes of an image: x to the right, y down. The polygon of one lens radius is scaled by the signed blur radius R, as a ray
through lens point l arrives at x' = x + R l; a negative R mirrors it in its center.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))  # nodes on [0, 1], exact for cubics
# px: weights of smaller radii follow from those of this one, where differences are exact to 1e-14.
SMALL = 0.25
SMALL_POINT = 1e-2  # px: a smaller source within a pixel is a point; pixel edges are at least 1 / 32 px away


def lens_mask(blades: int, rotation: float) -> Array:
    """Edges of a regular polygon inscribed in the unit circle.

    Parameters
    ----------
    blades : int
        Number of edges.
    rotation : float
        deg, counter-clockwise in the image; at 0 an edge faces to the right.

    Returns
    -------
    ndarray (blades, 3)
        x, y of the outward normal, and its distance from the center: inside is n . l <= distance.
    """
    angle = np.deg2rad(rotation) + 2.0 * np.pi * np.arange(blades) / blades
    return np.stack([np.cos(angle), -np.sin(angle), np.full(blades, np.cos(np.pi / blades))], axis=-1)


def vertices(blades: int, rotation: float) -> Array:
    """Corners (blades, 2) of the polygon of `lens_mask`, in its order: each edge ends at its own corner."""
    angle = np.deg2rad(rotation) + 2.0 * np.pi * (np.arange(blades) + 0.5) / blades
    return np.stack([np.cos(angle), -np.sin(angle)], axis=-1)


def _before(start: Array, step: Array, limit: Array) -> tuple[Array, Array]:
    """Ends of t with start + t step < limit, one of them infinite; the three broadcast."""
    flat = step == 0.0
    crossing = (limit - start) / np.where(flat, 1.0, step)
    crossing = np.where(flat, np.where(start < limit, np.inf, -np.inf), crossing)
    rising = flat | (step > 0.0)
    return np.where(rising, -np.inf, crossing), np.where(rising, crossing, np.inf)


def running_integral(corners: Array, radius: Array, x: Array, y: Array, tent: bool) -> Array:
    """Integral over the polygon, per area of it, of what lies left of x and above y.

    H(x, y; R) = (1 / A) times the integral of (x - u)_+^k (y - v)_+^k du dv, k = 0, or 1 for the tent. By Green's
    theorem a sum over edges, of polynomials up to the third degree between where an edge passes x and y: two Gauss
    nodes are exact. First differences of H over a pixel are its area in the polygon, second differences the polygon
    between a square source and a square detector.

    Parameters
    ----------
    corners : ndarray (n, 2)
        Corners of the polygon in a circle of one lens radius.
    radius : ndarray
        Signed, px, not 0.
    x, y : ndarray
        px from the center; the three broadcast.
    tent : bool

    Returns
    -------
    ndarray
    """
    total, area = np.zeros(np.broadcast_shapes(np.shape(radius), np.shape(x), np.shape(y))), 0.0
    for (u0, v0), (u1, v1) in zip(np.roll(corners, 1, axis=0), corners, strict=True):
        area += 0.5 * float(u0 * v1 - u1 * v0)
        if v0 == v1:
            continue
        low_x, high_x = _before(radius * u0, radius * (u1 - u0), x)
        low_y, high_y = _before(radius * v0, radius * (v1 - v0), y)
        low = np.clip(np.maximum(low_x, low_y), 0.0, 1.0)
        length = np.maximum(np.clip(np.minimum(high_x, high_y), 0.0, 1.0) - low, 0.0)
        each = np.zeros_like(total)
        for node in GAUSS:
            t = low + node * length
            left = x - radius * (u0 + t * (u1 - u0))
            each += left * left * (y - radius * (v0 + t * (v1 - v0))) if tent else 2.0 * left
        total -= each * length * (0.25 * radius * (v1 - v0))
    return np.asarray(total / (area * radius * radius))


def _held(radius: Array, tent: bool) -> tuple[Array, Array]:
    """Radii of which integrals are made, and what part of them the radii are."""
    least = SMALL if tent else SMALL_POINT
    held = np.where(np.abs(radius) < least, np.where(radius < 0.0, -least, least), radius)
    return held, np.abs(radius) / np.abs(held)


def _shrunk(share: Array, across: Array, down: Array, center_x: Array, center_y: Array, part: Array) -> Array:
    """Weights of `part` of a radius within SMALL from its own, and their sums per column and row.

    Over |u| < 1 the tents at -1, 0, 1 are linear for either sign of u, so that the weight of a polygon smaller by s is
    (1 - s) of that of a point and s of that of the whole polygon, along each axis.
    """
    rest = 1.0 - part
    inner = rest * (center_x * down + center_y * across) + part * share
    return np.asarray(rest * rest * center_x * center_y + part * inner)


def _share(corners: Array, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
    """Integral of the pixel's response over the polygon, per area of it: along each edge, between the places where the
    response changes its polynomial, that of S(x) T(y) dy, with T the response along an axis and S its integral."""
    knots = (-1.0, 0.0, 1.0) if tent else (-0.5, 0.5)
    total, area = np.zeros(np.broadcast_shapes(dx.shape, dy.shape, radius.shape)), 0.0
    for (u0, v0), (u1, v1) in zip(np.roll(corners, 1, axis=0), corners, strict=True):
        area += 0.5 * float(u0 * v1 - u1 * v0)
        start_x, start_y = radius * u0 - dx, radius * v0 - dy
        step_x, step_y = radius * (u1 - u0), radius * (v1 - v0)
        ends = [np.zeros_like(total), np.ones_like(total)]
        for start, step in ((start_x, step_x), (start_y, step_y)):
            flat = np.abs(step) < 1e-300
            ends += [np.clip(np.where(flat, 0.0, (knot - start) / np.where(flat, 1.0, step)), 0, 1) for knot in knots]
        t = np.sort(np.stack(ends), axis=0)
        length = np.diff(t, axis=0)
        for node in GAUSS:
            at = t[:-1] + node * length
            x, y = start_x + at * step_x, start_y + at * step_y
            if tent:
                inside = np.clip(x, -1.0, 1.0)
                integral = 0.5 + inside - 0.5 * inside * np.abs(inside)
                response = np.maximum(1.0 - np.abs(y), 0.0)
            else:
                integral, response = np.clip(x, -0.5, 0.5) + 0.5, (np.abs(y) < 0.5).astype(np.float64)
            total += (integral * response * length).sum(axis=0) * (0.5 * step_y)
    return np.asarray(np.maximum(total / (area * radius * radius), 0.0))


def polygon_share(corners: Array, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
    """Share of the polygon's energy in a pixel at (dx, dy) px, see `running_integral`; sums to 1 over the pixels.

    With the tent the offsets are whole numbers; else pixel edges are at least SMALL_POINT px away, or the radius is.
    """
    dx, dy, radius = (np.asarray(v, np.float64) for v in np.broadcast_arrays(dx, dy, radius))
    held, part = _held(radius, tent)
    share = _share(corners, dx, dy, held, tent)
    small = part < 1.0
    if tent and small.any():
        x, y, r = dx[small], dy[small], held[small]
        beside = (-1.0, 0.0, 1.0)
        across = np.sum([_share(corners, x, np.full_like(y, j), r, tent) for j in beside], axis=0)
        down = np.sum([_share(corners, np.full_like(x, i), y, r, tent) for i in beside], axis=0)
        share[small] = _shrunk(share[small], across, down, 1.0 * (x == 0), 1.0 * (y == 0), part[small])
    return share


def polygon_grid(corners: Array, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
    """`polygon_share` (radii, dy, dx) where dx and dy rise by 1 px: every running integral is made once."""
    half, order = (1.0, 2) if tent else (0.5, 1)
    held, part = _held(radii[:, None, None], tent)
    x, y = (axis[0] - half + np.arange(len(axis) + order) for axis in (dx, dy))
    whole = running_integral(corners, held, x[None, None, :], y[None, :, None], tent)
    share = np.maximum(np.diff(np.diff(whole, order, axis=1), order, axis=2), 0.0)
    if tent:
        sums = share.sum(axis=1, keepdims=True), share.sum(axis=2, keepdims=True)
        share = np.where(part < 1.0, _shrunk(share, *sums, 1.0 * (dx == 0), 1.0 * (dy == 0)[:, None], part), share)
    return np.asarray(share)
