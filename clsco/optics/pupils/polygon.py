"""Polygonal pupil of an iris with straight blades: areas by Green's theorem along its edges (float64, pure).

Axes of an image: x to the right, y down. A negative blur radius mirrors the polygon in its center.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from math import cos, pi, sin

import numpy as np

from clsco.optics.pupils.differences import Asymmetric, share_at
from clsco.optics.pupils.pupil import Array, Borders, Edges

GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))  # nodes on [0, 1], exact for cubics


@dataclass(frozen=True)
class Polygon(Asymmetric):
    """Regular polygon inscribed in the unit circle.

    blades: number of edges; rotation: deg, counter-clockwise in the image; at 0 an edge faces to the right; squeeze:
    height over width of the blur: x of the corners is divided by it.
    """

    blades: int = 6
    rotation: float = 0.0
    squeeze: float = 1.0

    uniform = True

    @property
    def label(self) -> str:
        return f"{self.blades} blades"

    @property
    def light(self) -> float:
        return self.blades * sin(2.0 * pi / self.blades) / (2.0 * pi * self.squeeze)

    @property
    def second_moment(self) -> float:
        """Mean of l_x^2 and l_y^2 in closed form; both are equal before the squeeze."""
        return (2.0 + cos(2.0 * pi / self.blades)) / 12.0 * 0.5 * (1.0 + self.squeeze**-2)

    @cached_property
    def edges(self) -> Edges:
        angle = np.deg2rad(self.rotation) + 2.0 * np.pi * np.arange(self.blades) / self.blades
        apothem = np.full(self.blades, np.cos(np.pi / self.blades))
        mask = np.stack([self.squeeze * np.cos(angle), -np.sin(angle), apothem], axis=-1)
        mask /= np.hypot(mask[:, 0], mask[:, 1])[:, None] if self.squeeze != 1.0 else 1.0
        return tuple((float(x), float(y), float(distance)) for x, y, distance in mask)

    @cached_property
    def borders(self) -> Borders:
        return Borders(tuple(np.sort(self.corners[:, 0]).tolist()), self.edges)

    @cached_property
    def corners(self) -> Array:
        """Corners (blades, 2) in aperture radii; edge k ends at corner k."""
        return vertices(self.blades, self.rotation) / (self.squeeze, 1.0)

    def transmission(self, x: Array, y: Array) -> Array:
        inside = [nx * x + ny * y <= distance for nx, ny, distance in self.edges]
        return np.all(inside, axis=0).astype(np.float64)

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        return share_at(partial(self._share, tent=tent), dx, dy, radius, tent)

    def running_integral(self, radius: Array, x: Array, y: Array, tent: bool) -> Array:
        """Integral over the part of the polygon left of x and above y, divided by the polygon's area.

        H(x, y; R) = (1 / A) times the integral of (x - u)_+^k (y - v)_+^k du dv over the polygon of area A, k = 0, or 1
        for the tent. By Green's theorem, it is a sum over edges, split where an edge passes x and y, of integrals of
        polynomials of degree 3 or less: two Gauss nodes are exact. radius: signed, px, not 0; x, y: px from the center.
        """
        total, area = np.zeros(np.broadcast_shapes(np.shape(radius), np.shape(x), np.shape(y))), 0.0
        for (u0, v0), (u1, v1) in zip(np.roll(self.corners, 1, axis=0), self.corners, strict=True):
            area += 0.5 * float(u0 * v1 - u1 * v0)
            if v0 == v1:
                continue
            low_x, high_x = _before(radius * u0, radius * (u1 - u0), x)
            low_y, high_y = _before(radius * v0, radius * (v1 - v0), y)
            low = np.clip(np.maximum(low_x, low_y), 0.0, 1.0)
            length = np.maximum(np.clip(np.minimum(high_x, high_y), 0.0, 1.0) - low, 0.0)
            part = np.zeros_like(total)
            for node in GAUSS:
                t = low + node * length
                left = x - radius * (u0 + t * (u1 - u0))
                part += left * left * (y - radius * (v0 + t * (v1 - v0))) if tent else 2.0 * left
            total -= part * length * (0.25 * radius * (v1 - v0))
        return np.asarray(total / (area * radius * radius))

    def _share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        """Integral of the pixel's response over the polygon, divided by its area: by Green's theorem, a sum over edges
        of integrals of S(x) T(y) dy, split where x or y is at a knot of T. T: response along an axis, a piecewise
        polynomial; S: integral of T.
        """
        knots = (-1.0, 0.0, 1.0) if tent else (-0.5, 0.5)
        total, area = np.zeros(np.broadcast_shapes(dx.shape, dy.shape, radius.shape)), 0.0
        for (u0, v0), (u1, v1) in zip(np.roll(self.corners, 1, axis=0), self.corners, strict=True):
            area += 0.5 * float(u0 * v1 - u1 * v0)
            start_x, start_y = radius * u0 - dx, radius * v0 - dy
            step_x, step_y = radius * (u1 - u0), radius * (v1 - v0)
            ends = [np.zeros_like(total), np.ones_like(total)]
            for start, step in ((start_x, step_x), (start_y, step_y)):
                flat = np.abs(step) < 1e-300
                crossings = [np.where(flat, 0.0, (knot - start) / np.where(flat, 1.0, step)) for knot in knots]
                ends += [np.clip(crossing, 0, 1) for crossing in crossings]
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


def vertices(blades: int, rotation: float) -> Array:
    """Corners (blades, 2) of a regular polygon on the unit circle, between the edges of `Polygon.edges`."""
    angle = np.deg2rad(rotation) + 2.0 * np.pi * (np.arange(blades) + 0.5) / blades
    return np.stack([np.cos(angle), -np.sin(angle)], axis=-1)


def _before(start: Array, step: Array, limit: Array) -> tuple[Array, Array]:
    """Range of t with start + t step < limit, with one end infinite; the three broadcast."""
    flat = step == 0.0
    crossing = (limit - start) / np.where(flat, 1.0, step)
    crossing = np.where(flat, np.where(start < limit, np.inf, -np.inf), crossing)
    rising = flat | (step > 0.0)
    return np.where(rising, -np.inf, crossing), np.where(rising, crossing, np.inf)
