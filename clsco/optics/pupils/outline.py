"""Pupils with outlines of straight edges and arcs, and their areas by Green's theorem (float64, pure).

Axes of an image: x to the right, y down. A negative blur radius mirrors the outline in its center.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import atan2, ceil, cos, floor, hypot, pi, sin

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.differences import ROUNDING, Asymmetric
from clsco.optics.pupils.polygon import Polygon, vertices
from clsco.optics.pupils.pupil import Array, Borders, unit_nodes

LONGEST_ARC, NODES = pi / 4.0, 8  # along such an arc, quadrature is exact to 1e-14 for cubics in both coordinates
STRAIGHT = 1e-6  # arcs of a smaller angle are straight
FILLED = 16.0  # px: with point sources and larger radii, pixels inside the outline get one weight, without integrals


@dataclass(frozen=True)
class Arc:
    """Part of an outline that is monotonic in x and in y, directed with the inside always on the same side.

    start, end: points, in aperture radii. center, radius: those of the arc's circle; radius 0 for a straight edge.
    angles: directions of the ends from the center, from x towards y, rad, within one quadrant.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    center: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0
    angles: tuple[float, float] = (0.0, 0.0)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Points (x, y) at t, from 0 at the start to 1 at the end."""
        if not self.radius:
            (x0, y0), (x1, y1) = self.start, self.end
            return x0 + t * (x1 - x0), y0 + t * (y1 - y0)
        angle = self.angles[0] + t * (self.angles[1] - self.angles[0])
        return self.center[0] + self.radius * np.cos(angle), self.center[1] + self.radius * np.sin(angle)

    def slope(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Derivatives of x and y by t, at points of the arc."""
        if not self.radius:
            return np.full_like(x, self.end[0] - self.start[0]), np.full_like(y, self.end[1] - self.start[1])
        turned = self.angles[1] - self.angles[0]
        return -turned * (y - self.center[1]), turned * (x - self.center[0])

    def until(self, axis: int, limit: Array) -> tuple[Array, Array]:
        """Bounds of t between which the coordinate on an axis (0: x) is below a limit."""
        low, high = self.start[axis], self.end[axis]
        if low == high:
            return np.where(low < limit, 0.0, 1.0), np.ones_like(limit)
        crossing = self._crossing(axis, limit) if self.radius else (limit - low) / (high - low)
        crossing = np.clip(crossing, 0.0, 1.0)
        return (np.zeros_like(limit), crossing) if high > low else (crossing, np.ones_like(limit))

    def _crossing(self, axis: int, limit: Array) -> Array:
        first, last = self.angles
        turn, quadrant = divmod(floor((first + last) / pi), 4)
        ratio = np.clip((limit - self.center[axis]) / self.radius, -1.0, 1.0)
        if axis == 0:
            angle = np.arccos(ratio) if quadrant < 2 else 2.0 * pi - np.arccos(ratio)
        else:
            angle = pi - np.arcsin(ratio) if quadrant in (1, 2) else np.arcsin(ratio) + (2.0 * pi if quadrant else 0.0)
        return np.asarray((angle + 2.0 * pi * turn - first) / (last - first))


def arc(center: tuple[float, float], radius: float, first: float, last: float) -> list[Arc]:
    """Arc of a circle between two angles, in monotonic parts no longer than LONGEST_ARC."""
    low, high = min(first, last), max(first, last)
    quarters = [k * pi / 2.0 for k in range(ceil(low / (pi / 2.0)), floor(high / (pi / 2.0)) + 1)]
    stops = [low, *(q for q in quarters if low + STRAIGHT < q < high - STRAIGHT), high]
    parts = []
    for begin, end in pairwise(stops):
        parts += np.linspace(begin, end, ceil((end - begin) / LONGEST_ARC) + 1)[:-1].tolist()
    angles = [*parts, high] if first <= last else [*parts, high][::-1]
    places = [(center[0] + radius * cos(angle), center[1] + radius * sin(angle)) for angle in angles]
    ends = zip(pairwise(places), pairwise(angles), strict=True)
    return [Arc(start, end, center, radius, turns) for (start, end), turns in ends]


def bulging(start: tuple[float, float], end: tuple[float, float], sagitta: float) -> list[Arc]:
    """Arc between two points with height `sagitta` over its chord, away from the origin if positive."""
    half = 0.5 * hypot(end[0] - start[0], end[1] - start[1])
    if abs(sagitta) < STRAIGHT * half:
        return [Arc(start, end)]
    middle = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    away = hypot(*middle)
    radius = (half * half + sagitta * sagitta) / (2.0 * abs(sagitta))
    shift = sagitta - radius if sagitta > 0.0 else sagitta + radius
    center = middle[0] * (1.0 + shift / away), middle[1] * (1.0 + shift / away)
    first, last = (atan2(y - center[1], x - center[0]) for x, y in (start, end))
    last += 2.0 * pi * round((first - last) / (2.0 * pi))
    return arc(center, radius, first, last)


class Outline(Asymmetric):
    """Aperture with an outline of arcs, fully open inside."""

    has_plain_rim = False

    @cached_property
    @abstractmethod
    def arcs(self) -> tuple[Arc, ...]:
        """Closed outlines, with the inside on the same side of each: holes have the opposite direction."""

    @cached_property
    def area(self) -> float:
        """Area of the outline before the squeeze; negative if the inside is on the right of the arcs' direction."""
        return float(sum((unit_nodes(NODES)[1] * x * dy).sum() for x, _, _, dy in self._walked()))

    @property
    def light(self) -> float:
        return abs(self.area) / (pi * self.squeeze)

    @property
    def second_moment(self) -> float:
        along_x = sum((unit_nodes(NODES)[1] * x**3 * dy).sum() for x, _, _, dy in self._walked()) / 3.0
        along_y = -sum((unit_nodes(NODES)[1] * y**3 * dx).sum() for _, y, dx, _ in self._walked()) / 3.0
        return float(0.5 * (along_x / self.squeeze**2 + along_y) / self.area)

    def _walked(self) -> Iterable[tuple[Array, Array, Array, Array]]:
        """Coordinates x, y of the quadrature nodes on each arc, and their derivatives along it."""
        for arc in self.arcs:
            x, y = arc.at(unit_nodes(NODES)[0])
            yield x, y, *arc.slope(x, y)

    def transmission(self, x: Array, y: Array) -> Array:
        """Transmission: 1 where an odd number of outlines lies to the left of a point, else 0."""
        x, y = np.asarray(x, np.float64) * self.squeeze, np.asarray(y, np.float64)
        inside = np.zeros(np.broadcast_shapes(x.shape, y.shape), bool)
        for arc in self.arcs:
            low, high = sorted((arc.start[1], arc.end[1]))
            if low == high:
                continue
            first, last = arc.until(1, y)
            at = last if arc.end[1] > arc.start[1] else first
            inside ^= (y > low) & (y <= high) & (arc.at(at)[0] < x)
        return inside.astype(np.float64)

    def rows(self, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
        if tent or radii.min() < FILLED:
            return super().rows(radii, dx, dy, tent)
        return np.stack([self._filled(float(radius), dx, dy) for radius in radii])

    def _filled(self, radius: float, dx: Array, dy: Array) -> Array:
        """Fractions of the light (dy, dx) in pixels: exact along the outline, constant inside."""
        beside = 0.25  # px beside a row through the middle, where arcs end
        weights = self.transmission(dx / radius, (dy[:, None] + beside) / radius) / (pi * self.light * radius * radius)
        row, column = np.nonzero(self._outlined(radius, dx, dy))
        share = np.zeros(row.shape)
        for right, down, sign in ((0.5, 0.5, 1.0), (-0.5, 0.5, -1.0), (0.5, -0.5, -1.0), (-0.5, -0.5, 1.0)):
            share += sign * self.running_integral(np.asarray(radius), dx[column] + right, dy[row] + down, tent=False)
        weights[row, column] = np.where(share < ROUNDING, 0.0, share)
        return np.asarray(weights)

    def _outlined(self, radius: float, dx: Array, dy: Array) -> NDArray[np.bool_]:
        """Mask (dy, dx) of pixels crossed by an outline, and their neighbors."""
        mask = np.zeros((len(dy) + 2, len(dx) + 2), bool)
        for arc in self.arcs:
            turned = arc.radius * abs(arc.angles[1] - arc.angles[0])
            length = radius * self.extent * (turned or hypot(*np.subtract(arc.end, arc.start)))
            x, y = arc.at(np.linspace(0.0, 1.0, 2 * ceil(length) + 2))
            column, row = np.rint(x / self.squeeze * radius - dx[0]), np.rint(y * radius - dy[0])
            inside = (column >= -1) & (column <= len(dx)) & (row >= -1) & (row <= len(dy))
            mask[row[inside].astype(np.int64) + 1, column[inside].astype(np.int64) + 1] = True
        mask = mask[:-2] | mask[1:-1] | mask[2:]
        return np.asarray(mask[:, :-2] | mask[:, 1:-1] | mask[:, 2:])

    def running_integral(self, radius: Array, x: Array, y: Array, tent: bool) -> Array:
        """Integral for `grid_share`, along arcs (u, v): of (x - u)^2 (y - v) / 2 dv if `tent`, else of (x - u) dv."""
        x, y = x * self.squeeze / radius, y / radius
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
        for arc in self.arcs:
            if arc.start[1] == arc.end[1]:
                continue
            (first_x, last_x), (first_y, last_y) = arc.until(0, x), arc.until(1, y)
            first = np.maximum(first_x, first_y)
            length = np.maximum(np.minimum(last_x, last_y) - first, 0.0)
            integral = np.zeros_like(total)
            for node, weight in zip(*unit_nodes(NODES), strict=True):
                t = first + node * length
                u, v = arc.at(t)
                _, change = arc.slope(u, v)
                left = x - u
                integral += (weight * change) * (0.5 * left * left * (y - v) if tent else left)
            total -= integral * length
        scale = radius * radius / self.squeeze if tent else 1.0
        return np.asarray(total / self.area * scale)


@dataclass(frozen=True)
class Ellipse(Outline):
    """Ellipse as high as the unit circle; squeeze: height over width; obstruction: size of a central obstruction of the
    same shape, relative to the opening, 0 for none.
    """

    squeeze: float
    obstruction: float = 0.0

    @property
    def label(self) -> str:
        return f"ring, {self.obstruction:g} covered" if self.obstruction else "circle"

    @cached_property
    def borders(self) -> Borders:
        holes = ((0.0, 0.0, self.obstruction),) if self.obstruction else ()
        return Borders((-1.0 / self.squeeze, 1.0 / self.squeeze), (), ((0.0, 0.0, 1.0),), holes, self.squeeze)

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        hole = arc((0.0, 0.0), self.obstruction, 2.0 * pi, 0.0) if self.obstruction else []
        return (*arc((0.0, 0.0), 1.0, 0.0, 2.0 * pi), *hole)


@dataclass(frozen=True)
class CurvedPolygon(Outline):
    """Aperture of curved blades, with corners on the unit circle; blades, rotation, squeeze: as for `Polygon`.

    curvature: height of an arc over its chord, relative to the height of the unit circle: 1 for the circle, negative
    for concave blades.
    """

    blades: int
    rotation: float
    curvature: float
    squeeze: float = 1.0

    @property
    def label(self) -> str:
        return f"{self.blades} blades, curved by {self.curvature:g}"

    @cached_property
    def _blades(self) -> list[list[Arc]]:
        corners = [(float(x), float(y)) for x, y in vertices(self.blades, self.rotation)]
        sagitta = self.curvature * (1.0 - cos(pi / self.blades))
        return [bulging(corners[k - 1], corners[k], sagitta) for k in range(self.blades)]

    @cached_property
    def borders(self) -> Borders:
        ends = sorted({x / self.squeeze for arc in self.arcs for x, _ in (arc.start, arc.end)})
        circles = tuple((*blade[0].center, blade[0].radius) for blade in self._blades if blade[0].radius)
        edges = () if circles and self.curvature > 0.0 else Polygon(self.blades, self.rotation, self.squeeze).edges
        convex, holes = ((), circles) if edges else (circles, ())
        return Borders(tuple(ends), edges, convex, holes, self.squeeze)

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        return tuple(arc for blade in self._blades for arc in blade)
