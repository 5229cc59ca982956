"""Weights of round openings by chords: of the ellipses that a distorted image has, and of what rims leave open
(float64, pure)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from clsco.constants import NARROW_OPENING

Array = NDArray[np.float64]
Circle = tuple[Array, Array, Array]
DISC = np.array([1.0, 0.0, 1.0])
"""Shape of a disc, see `clsco.optics.ellipses.shape_of`."""
FLAT = 1.5
"""Distance, px, of columns from the ends of an opening from which on chords between them are FLAT_CHORDS."""
FLAT_CHORDS, STEEP_CHORDS, CUT_CHORDS, AREA_CHORDS = 2, 5, 8, 96
"""Chords between two columns: where flat, else, else where there are rims, and for the area of an opening."""


@cache
def chord_nodes(count: int) -> tuple[Array, Array]:
    """Places of chords between two columns, 0 to 1, and their parts of the sum: Gauss-Legendre nodes that crowd to both
    ends, as chords are steep where an opening ends."""
    nodes, parts = np.polynomial.legendre.leggauss(count)
    parts = parts * np.cos(0.5 * np.pi * nodes)
    return 0.5 + 0.5 * np.sin(0.5 * np.pi * nodes), parts / parts.sum()


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
    places, parts = (_stacked(each, total) for each in chord_nodes(CUT_CHORDS if rims else STEEP_CHORDS))
    few = np.array([0.5 - 0.5 / 3.0**0.5, 0.5 + 0.5 / 3.0**0.5, *[0.0] * (len(places) - FLAT_CHORDS)])
    flat_places = _stacked(few, total)
    flat_parts = _stacked(np.array([0.5, 0.5, *[0.0] * (len(places) - FLAT_CHORDS)]), total)
    narrow, below = opening.far[0] < NARROW_OPENING, _in_pixel if point else _below
    for side in (-0.5,) if point else (-1.0, 0.0):
        left = dx + side
        start, end = (np.clip(at, opening.low, opening.high) for at in (left, left + 1.0))
        flat = np.zeros(start.shape, np.bool_) if point else opening.is_flat(left)
        for half in range(2 if rims and narrow.any() else 1):
            width = np.where(flat | ~narrow, 1.0 - half, 0.5 if rims else 1.0) * (end - start)
            v = start + width * (half + np.where(flat, flat_places, places))
            beginning, ending = opening.chords(v)
            light = below(ending - dy) - below(beginning - dy)
            across = 1.0 if point else 1.0 - np.abs(v - dx)
            total += width * (np.where(flat, flat_parts, parts) * across * light).sum(axis=0)
    return np.asarray(total / (np.pi * radius * radius))


def open_share(rims: Sequence[Circle]) -> Array:
    """Share of the light of a round lens that passes all rims, circles in lens radii; to 3e-5."""
    opening = _Opening(np.ones_like(rims[0][0]), DISC, rims)
    total, width = np.zeros_like(rims[0][0]), opening.high - opening.low
    for place, part in zip(*chord_nodes(AREA_CHORDS), strict=True):
        beginning, ending = opening.chords(opening.low + width * place)
        total += part * (ending - beginning)
    return np.asarray(np.where(width > 0.0, width * total / np.pi, 0.0))


def _stacked(values: NDArray[np.floating], like: Array) -> Array:
    """Values along an axis before those of another array."""
    return values.astype(np.float64).reshape(-1, *[1] * like.ndim)


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
