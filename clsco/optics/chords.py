"""PSF weights as integrals along chords (float64, pure).

Used for blur ellipses in a distorted image, and for lenses that rims cut if they are round or have `Borders`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.pupil import Borders, pixel_integral, unit_nodes

Array = NDArray[np.float64]
Circle = tuple[Array, Array, Array]
DISC = np.array([1.0, 0.0, 1.0])
"""Shape of a disc, see `clsco.optics.ellipses.shape_of`."""
FLAT = 1.5
"""Least distance in px from both ends of an opening at which FLAT_CHORDS chords may be enough for a column."""
UPRIGHT, FAR = 1e-6, 1e6
"""UPRIGHT: an edge whose unit normal has a smaller |y| counts as vertical. FAR: a distance beyond all openings, px."""
FLAT_CHORDS, STEEP_CHORDS, AREA_CHORDS = 2, 5, 48
"""Numbers of chords in a column of 1 px that is flat, in one that is not, and for the area of half an opening."""


def chord_weights(
    dx: Array, dy: Array, radius: Array, shape: Array = DISC, rims: Sequence[Circle] = (), point: bool = False,
    borders: Borders | None = None,
) -> Array:  # fmt: skip
    """Weight of a pixel at (dx, dy) px for light from a square pixel or a point, relative to all light of a round lens.

    dx, dy: offset of the pixel from the source, right and down; integers unless `point`. radius: |R| of the disc with
    the area of the blur, px, above 0; with `borders`, R with its sign. shape: quadratic form (..., 3) of the ellipse by
    `clsco.optics.ellipses.shape_of`; all arrays broadcast. rims: circles that the light must also pass: x, y of the
    center, right and down from the source, and the radius that they have for a round blur, px. point: True for a point
    source. borders: for a lens that is not round.

    The light of holes is subtracted. Without holes, the part of a lens inside all rims is convex, so a column has one
    chord: it begins where the last of all borders' chords begins, and ends where the first of them ends. Along a chord,
    the response of both pixels is integrated in closed form; across chords, it is weighted by the convolution of both
    pixels, a tent, or for a point source by the detector's pixel. Sums over pixels differ from 1 by less than 3e-5;
    with rims, they differ from the area of the opening by less than 5e-4.
    """
    total = np.zeros(np.broadcast(dx, dy, radius).shape)
    for sign, hole in _parts(borders):
        total += sign * _light(_Opening(radius, shape, rims, borders, hole), dx, dy, point)
    return np.asarray(total / (np.pi * radius * radius))


def _parts(borders: Borders | None) -> list[tuple[float, Array | None]]:
    """Convex parts of an opening with their signs: (1, None) for all of it without holes, (-1, circle) for a hole."""
    return [(1.0, None), *((-1.0, np.array(hole)) for hole in (borders.holes if borders else ()))]


def _light(opening: _Opening, dx: Array, dy: Array, point: bool) -> Array:
    """Light of a convex opening in pixels at (dx, dy), px^2."""
    total = np.zeros(np.broadcast(dx, dy, opening.low).shape)
    for side in (-0.5,) if point else (-1.0, 0.0):
        column = dx + side
        start, end = (np.clip(at, opening.low, opening.high) for at in (column, column + 1.0))
        flat = np.zeros(start.shape, np.bool_) if point else opening.is_flat(column)
        for low, high in opening.pieces:
            ends = np.clip(start, low, high), np.clip(end, low, high)
            for v, parts in opening.places(*ends, flat, total.ndim):
                beginning, ending = opening.chords(v)
                light = pixel_integral(ending - dy, not point) - pixel_integral(beginning - dy, not point)
                across = 1.0 if point else 1.0 - np.abs(v - dx)
                total += (parts * across * light).sum(axis=0)
    return np.asarray(total)


def open_share(rims: Sequence[Circle], borders: Borders | None = None) -> Array:
    """Fraction of a round lens's light that passes the lens and all rims, within 3e-5; rims: circles in lens radii."""
    total = np.zeros_like(rims[0][0])
    flat = np.zeros(total.shape, np.bool_)
    for sign, hole in _parts(borders):
        opening = _Opening(np.ones_like(total), DISC, rims, borders, hole)
        for piece in opening.pieces:
            start, end = (np.clip(at, *piece) for at in (opening.low, opening.high))
            for v, parts in opening.places(start, end, flat, total.ndim, AREA_CHORDS):
                beginning, ending = opening.chords(v)
                total += sign * (parts * (ending - beginning)).sum(axis=0)
    return np.asarray(total / np.pi)


def _stacked(values: NDArray[Any], axes: int) -> Array:
    """Reshape values to an axis followed by `axes` axes of length 1."""
    return values.astype(np.float64).reshape(-1, *[1] * axes)


class _Opening:
    """Opening of a lens that rims cut, or with `hole` only the part of it that this circle covers.

    It extends from column `low` to column `high`, px to the right of the source.
    """

    def __init__(
        self, radius: Array, shape: Array, rims: Sequence[Circle], borders: Borders | None = None,
        hole: Array | None = None,
    ) -> None:  # fmt: skip
        q1, q2 = np.asarray(shape)[..., 1], np.asarray(shape)[..., 2]
        root, none = np.sqrt(q2), np.zeros_like(radius)
        self.lean, self.edges = -q1 / q2, list[Circle]()
        self.circles: list[tuple[Any, ...]] = [
            (x, y, size * root, 1.0 / q2) for x, y, size in ((none, none, radius), *rims)
        ]
        if borders:
            inner, over, size = borders.circles, borders.squeeze, np.abs(radius)
            lens = [np.asarray(bounds) for bounds in (inner if hole is None else (*inner, hole))]
            within = [(x / over * radius, y * radius, r / over * size, over) for x, y, r in lens]
            self.circles = [*within, *self.circles[1:]]
            self.edges = [(x * radius, y * radius, d * size * size) for x, y, d in borders.edges if abs(y) > UPRIGHT]
        ends: list[Any] = [(x - far, x + far) for x, _, far, _ in self.circles]
        self.pieces: list[Any] = [(-FAR, FAR)]  # between columns at which the opening has a corner
        if borders:
            corners = borders.columns
            ends.append(np.sort([radius * end for end in (corners[0], corners[-1])], axis=0))
            self.pieces = [np.sort([radius * first, radius * second], axis=0) for first, second in pairwise(corners)]
        self.low, high = (np.stack(np.broadcast_arrays(*bounds)) for bounds in zip(*ends, strict=True))
        self.low, self.high = self.low.max(axis=0), np.maximum(high.min(axis=0), self.low.max(axis=0))

    def _circle_chords(self, v: Array) -> Iterator[tuple[Array | float, Array | float]]:
        """For each circle and edge: beginning and end in px of the chord inside it, along the column at v px."""
        for x, y, far, over in self.circles:
            aside = v - x
            half, middle = np.sqrt(np.maximum((far - aside) * (far + aside), 0.0)) * over, y + self.lean * aside
            yield middle - half, middle + half
        for across, down, reach in self.edges:
            at = (reach - across * v) / down
            yield np.where(down < 0.0, at, -FAR), np.where(down < 0.0, FAR, at)

    def _ends(self, v: Array) -> tuple[Array, Array]:
        """Beginnings (borders, ...) and ends (borders, ...) of the chords inside each border, in the column at v px."""
        beginnings, ends = zip(*self._circle_chords(v), strict=True)
        return np.stack(np.broadcast_arrays(*beginnings)), np.stack(np.broadcast_arrays(*ends))

    def chords(self, v: Array) -> tuple[Array, Array]:
        """Beginning and end in px of the opening's chord in the column at v px; equal if there is none."""
        beginning, ending = np.full(v.shape, -FAR), np.full(v.shape, FAR)
        for first, last in self._circle_chords(v):
            beginning, ending = np.maximum(beginning, first), np.minimum(ending, last)
        return beginning, np.maximum(ending, beginning)

    def places(
        self, start: Array, end: Array, flat: NDArray[np.bool_], axes: int, count: int = STEEP_CHORDS
    ) -> Iterator[tuple[Array, Array]]:  # fmt: skip
        """Positions (count, ...) of chords from `start` to `end`, and their quadrature weights in px; one or two
        batches.

        axes: number of axes of the results after the first axis, which is that of the chords. Chords grow with the
        square root of the distance from an end of the opening. So where a column is not `flat`, the variable of the
        quadrature is the square root of the distance from the nearer end. A column that crosses the middle of the
        opening is split there: the first batch has its left half, the second batch its right half. The second batch is
        yielded only if there are such columns, and its weights are 0 for all other columns.
        """
        middle = 0.5 * (self.low + self.high)
        straddles = ~flat & (start < middle) & (middle < end)
        places, parts = (_stacked(values, axes) for values in unit_nodes(count))
        few = _stacked(np.pad(unit_nodes(FLAT_CHORDS)[0], (0, count - FLAT_CHORDS)), axes)
        even = _stacked(np.arange(count) < FLAT_CHORDS, axes) / FLAT_CHORDS
        for second in range(2 if straddles.any() else 1):
            right = straddles if second else start >= middle
            near, far = np.where(right, end, start), np.where(right, np.maximum(start, middle), np.minimum(end, middle))
            origin, sign = np.where(right, self.high, self.low), np.where(right, -1.0, 1.0)
            first, last = (np.sqrt(np.maximum(sign * (at - origin), 0.0)) for at in (near, far))
            root = first + (last - first) * places
            v = np.where(flat, start + (end - start) * few, origin + sign * root * root)
            steep = 2.0 * (last - first) * root * parts
            yield v, np.where(flat, (end - start) * even, steep) * (straddles if second else 1.0)

    def is_flat(self, column: Array) -> NDArray[np.bool_]:
        """True if all chords in the 1 px to the right of `column` begin on the same border and end on the same border,
        and the ends of the opening are at least FLAT px away.
        """
        flat = (column - self.low >= FLAT) & (self.high - column - 1.0 >= FLAT)
        if len(self.circles) + len(self.edges) == 1:
            return np.asarray(flat)
        (first, first_end), (last, last_end) = (self._ends(at) for at in (column, column + 1.0))
        for first_edges, second_edges in ((first, last), (-first_end, -last_end)):
            flat = flat & (first_edges.argmax(axis=0) == second_edges.argmax(axis=0))
        for first_edges, second_edges in ((first, first_end), (last, last_end)):
            flat = flat & (first_edges.max(axis=0) < second_edges.min(axis=0))
        return np.asarray(flat)
