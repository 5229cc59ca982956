"""Weights of round openings by chords: of the ellipses that a distorted image has, and of what rims leave open
(float64, pure)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Circle = tuple[Array, Array, Array]
DISC = np.array([1.0, 0.0, 1.0])
"""Shape of a disc, see `clsco.optics.ellipses.shape_of`."""
FLAT = 1.5
"""Distance, px, of columns from the ends of an opening from which on chords between them are FLAT_CHORDS."""
FLAT_CHORDS, STEEP_CHORDS, AREA_CHORDS = 2, 5, 48
"""Chords between two columns: where flat, and else; and for the area of half an opening."""


@cache
def chord_nodes(count: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes of 0 to 1, and their parts of the sum."""
    nodes, parts = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * parts


def chord_weights(
    dx: Array, dy: Array, radius: Array, shape: Array = DISC, rims: Sequence[Circle] = (), point: bool = False
) -> Array:  # fmt: skip
    """Share of the light of a round lens, from a square pixel or a point, in a square pixel at (dx, dy) px.

    Parameters
    ----------
    dx, dy : ndarray
        Right and down; integers, but of a point.
    radius : ndarray
        |R| of the disc of the same area, px, above 0.
    shape : ndarray of float64, (..., 3)
        Form of the ellipse, see `clsco.optics.ellipses.shape_of`. All broadcast.
    rims : sequence of (x, y, radius)
        Circles that light comes through as well: x and y of the middle, right and down, and the radius of the disc of
        the same area, px.
    point : bool
        The source is a point.

    Returns
    -------
    ndarray of float64

    Notes
    -----
    Lens and rims together are convex: a column has one chord, from the last of their beginnings to the first of their
    ends. Chords are in closed form over both pixels, times the tent of both across them, or the
    detector's pixel. Sums over pixels differ from 1 by less than 3e-5, with rims from the area of the opening by less
    than 5e-4. Validated against the integral.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.chords import chord_weights
    >>> x = np.arange(-9.0, 10.0)
    >>> flat = chord_weights(x, x[:, None], np.asarray(6.0), np.array([0.8, 0.0, 1.25]))
    >>> float(flat.sum().round(3)), float((flat * x * x).sum().round(1)), float((flat.T * x * x).sum().round(1))
    (1.0, 11.4, 7.4)
    """
    opening = _Opening(radius, shape, rims)
    total = np.zeros(np.broadcast(dx, dy, opening.far[0]).shape)
    below = _in_pixel if point else _below
    for side in (-0.5,) if point else (-1.0, 0.0):
        left = dx + side
        start, end = (np.clip(at, opening.low, opening.high) for at in (left, left + 1.0))
        flat = np.zeros(start.shape, np.bool_) if point else opening.is_flat(left)
        for v, parts in opening.places(start, end, flat, total.ndim):
            beginning, ending = opening.chords(v)
            light = below(ending - dy) - below(beginning - dy)
            across = 1.0 if point else 1.0 - np.abs(v - dx)
            total += (parts * across * light).sum(axis=0)
    return np.asarray(total / (np.pi * radius * radius))


def open_share(rims: Sequence[Circle]) -> Array:
    """Share of the light of a round lens that passes all rims, circles in lens radii; to 3e-5."""
    opening = _Opening(np.ones_like(rims[0][0]), DISC, rims)
    total = np.zeros_like(rims[0][0])
    flat = np.zeros(total.shape, np.bool_)
    for v, parts in opening.places(opening.low, opening.high, flat, total.ndim, AREA_CHORDS):
        beginning, ending = opening.chords(v)
        total += (parts * (ending - beginning)).sum(axis=0)
    return np.asarray(total / np.pi)


def _stacked(values: NDArray[Any], axes: int) -> Array:
    """Values along an axis before so many others."""
    return values.astype(np.float64).reshape(-1, *[1] * axes)


class _Opening:
    """A lens and rims as a source sees them, px: where columns see something of it, `low` to `high`."""

    def __init__(self, radius: Array, shape: Array, rims: Sequence[Circle]) -> None:
        q1, q2 = np.asarray(shape)[..., 1], np.asarray(shape)[..., 2]
        self.lean, self.over, root = -q1 / q2, 1.0 / q2, np.sqrt(q2)
        none = np.zeros_like(radius)
        self.circles = ((none, none, radius), *rims)
        self.far = [size * root for _, _, size in self.circles]
        ends = [(x - far, x + far) for (x, _, _), far in zip(self.circles, self.far, strict=True)]
        self.low, high = (np.stack(np.broadcast_arrays(*each)) for each in zip(*ends, strict=True))
        self.low, self.high = self.low.max(axis=0), np.maximum(high.min(axis=0), self.low.max(axis=0))

    def _ends(self, v: Array) -> tuple[Array, Array]:
        """Beginnings and ends of chords of each circle down the column at v px, px."""
        middles, halves = [], []
        for (x, y, _), far in zip(self.circles, self.far, strict=True):
            halves.append(np.sqrt(np.maximum((far - (v - x)) * (far + (v - x)), 0.0)) * self.over)
            middles.append(y + self.lean * (v - x))
        middle, half = np.stack(np.broadcast_arrays(*middles)), np.stack(np.broadcast_arrays(*halves))
        return middle - half, middle + half

    def chords(self, v: Array) -> tuple[Array, Array]:
        """Beginnings and ends of chords of the opening."""
        beginnings, ends = self._ends(v)
        beginning = beginnings.max(axis=0)
        return beginning, np.maximum(ends.min(axis=0), beginning)

    def places(
        self, start: Array, end: Array, flat: NDArray[np.bool_], axes: int, count: int = STEEP_CHORDS
    ) -> Iterator[tuple[Array, Array]]:  # fmt: skip
        """Places (count, ...) of chords from `start` to `end`, and their parts: as many px as they stand for.

        axes: of weights, which the first is before.

        Chords grow with the square root of the distance from an end of the opening: where they are not flat, nodes are
        by that root from the nearer end, and columns over the middle have some from both.
        """
        middle = 0.5 * (self.low + self.high)
        both = ~flat & (start < middle) & (middle < end)
        places, parts = (_stacked(each, axes) for each in chord_nodes(count))
        few = _stacked(np.pad(chord_nodes(FLAT_CHORDS)[0], (0, count - FLAT_CHORDS)), axes)
        even = _stacked(np.arange(count) < FLAT_CHORDS, axes) / FLAT_CHORDS
        for second in range(2 if both.any() else 1):
            right = both if second else start >= middle
            near, far = np.where(right, end, start), np.where(right, np.maximum(start, middle), np.minimum(end, middle))
            origin, sign = np.where(right, self.high, self.low), np.where(right, -1.0, 1.0)
            first, last = (np.sqrt(np.maximum(sign * (at - origin), 0.0)) for at in (near, far))
            root = first + (last - first) * places
            v = np.where(flat, start + (end - start) * few, origin + sign * root * root)
            steep = 2.0 * (last - first) * root * parts
            yield v, np.where(flat, (end - start) * even, steep) * (both if second else 1.0)

    def is_flat(self, left: Array) -> NDArray[np.bool_]:
        """True where chords of the column from `left` to 1 px right of it all begin on one circle, and end on one, and
        the ends of the opening are not near."""
        flat = (left - self.low >= FLAT) & (self.high - left - 1.0 >= FLAT)
        if len(self.circles) == 1:
            return np.asarray(flat)
        (first, first_end), (last, last_end) = (self._ends(at) for at in (left, left + 1.0))
        for one, other in ((first, last), (-first_end, -last_end)):
            flat = flat & (one.argmax(axis=0) == other.argmax(axis=0))
        for one, other in ((first, first_end), (last, last_end)):
            flat = flat & (one.max(axis=0) < other.min(axis=0))
        return np.asarray(flat)


def _below(t: Array) -> Array:
    """Integral of the tent of both pixels up to t, less 1/2."""
    t = np.clip(t, -1.0, 1.0)
    return t - 0.5 * t * np.abs(t)


def _in_pixel(t: Array) -> Array:
    """Part of the detector's pixel up to t, less 1/2."""
    return np.clip(t, -0.5, 0.5)
