"""Lenses with aberrations in geometrical optics, without diffraction (float64, pure).

A ray through l, in lens radii, arrives R l + 2 grad W px from its source, with W the optical path in px
(`clsco.optics.pupils.wavefront`): the limit of infinitely short waves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, floor, log2
from typing import ClassVar

import numpy as np

from clsco.constants import POWERS
from clsco.optics.pupils.diffracted import panel_nodes
from clsco.optics.pupils.fourier import FourierDiffracted, spot_cache
from clsco.optics.pupils.pupil import Array, Pupil, pixel_integral
from clsco.optics.pupils.wavefront import Wavefront

MOST_PARTS, LEAST_PARTS = 16, 2  # limits of cells per px of a spot, which reaches at most SPOT cells if possible
SPOT = 256
# Sharpening of a response: undoes the variance that cells of light and means over them add, 1/6 of a squared cell.
SHARPER = 1.0 / 12.0
# Rays per radius of the lens: per cell and per px of the spot's radius, whichever is less; least and largest number.
RAYS_PER_CELL, RAYS_PER_PX, FEWEST_RAYS, MOST_RAYS = 1.25, 16.0, 96, 384
# Intervals of tables per px: FINE_STEPS if rays are bent by less than FINE_BELOW px; STEPS in a field.
FINE_STEPS, STEPS, FINE_BELOW = 8, 4, 8.0
SECONDS, PLACE = 3e-8, 0.07  # CPU time of a ray, and fraction of it for each position of a source in its pixel
TOGETHER = 2**14  # rays processed at once, whose arrays fit into a processor's cache


@dataclass(frozen=True)
class Traced(FourierDiffracted):
    """Aperture of any shape with a wavefront error, in geometrical optics; `bands` and `tail` are unused.

    Weights are sums over rays at the nodes of table intervals, and cubics in R between nodes.
    """

    NODES: ClassVar[int] = POWERS
    bends_rays = True

    bands: tuple[tuple[float, float], ...] = ((1.0, 1.0),)

    @property
    def name(self) -> str:
        return f"{self.opening.name}, aberrations by rays"

    @property
    def steps(self) -> int:
        return FINE_STEPS if self.margin < FINE_BELOW and not self.steepest else STEPS

    @property
    def panel(self) -> float:
        return 1.0 / self.steps

    @property
    def margin(self) -> float:
        """Distance in px beyond the geometric blur to which wavefront errors displace rays."""
        return 2.0 * self.slope

    def samples(self, radius: float) -> float:
        """Number of rays over the diameter for a blur radius in px."""
        return 2.0 * self._count(abs(radius))

    def left_out(self, _: float) -> float:
        return 0.0

    def seconds(self, radius: float, places: int) -> float:
        return SECONDS * 4.0 * self._count(radius) ** 2 * (1.0 + PLACE * places)

    def _clip(self, weights: Array) -> Array:
        """The weights unchanged: values at nodes are at least 0, and cubics between nodes are as in tables."""
        return weights

    def _count(self, radius: float) -> int:
        """Number of rays per radius of the lens."""
        count = min(RAYS_PER_CELL * self._parts(radius), RAYS_PER_PX) * (radius * self.extent + self.margin)
        return min(max(32 * ceil(count / 32.0), FEWEST_RAYS), MOST_RAYS)

    def _spots(self, number: int) -> Array:
        """Light (nodes, y, x) in the cells of spots, at the nodes of a panel."""
        nodes = panel_nodes(np.array([number]), self.panel, POWERS)[0]
        parts, reach, count = self._sizes(number)
        x, y, light = lens_points(self.opening, count)
        rays = x, y, light * self.wavefront.grown(x, y), *bends(self.opening, self.wavefront, count)
        middle, pitch = parts * reach, parts * self.extent / count
        spots, size = np.zeros((len(nodes), (2 * middle + 1) ** 2)), len(rays[0])
        cell, shares = np.empty(size, np.int64), np.empty((4, size))
        for cells, radius in zip(spots, nodes.tolist(), strict=True):
            for begin in range(0, size, TOGETHER):
                batch = slice(begin, begin + TOGETHER)
                x, y, light, bent_x, bent_y, xx, shear, yy = (values[batch] for values in rays)
                column, right = ends(parts * (radius * x + bent_x), pitch * np.sqrt((radius + xx) ** 2 + shear))
                row, down = ends(parts * (radius * y + bent_y), pitch * np.sqrt((radius + yy) ** 2 + shear))
                cell[batch] = (row + middle) * (2 * middle + 1) + (column + middle)
                right, down = light * right, light * down
                product = shares[3, batch] = down * right / light
                shares[0, batch], shares[1, batch], shares[2, batch] = (
                    light - right - down + product,
                    right - product,
                    down - product,
                )
            for step, share in zip((0, 1, 2 * middle + 1, 2 * middle + 2), shares, strict=True):
                cells[step:] += np.bincount(cell, share, len(cells))[: len(cells) - step]
        return spots.reshape(len(nodes), 2 * middle + 1, 2 * middle + 1)

    def _sizes(self, number: int) -> tuple[int, int, int]:
        """Cells per px, reach in px of a panel's spots, and rays per radius of the lens."""
        farthest = self.panel * max(abs(number), abs(number + 1))
        return self._parts(farthest), self._reach(farthest), self._count(farthest)

    def _reach(self, radius: float) -> int:
        return ceil(radius * self.extent + self.margin) + 4

    def _parts(self, radius: float) -> int:
        """Cells per px."""
        return min(max(2 ** floor(log2(SPOT / self._reach(radius))), LEAST_PARTS), MOST_PARTS)

    def _make_squares(self, number: int, place: tuple[float, float], tent: bool) -> Array:
        parts, *_ = self._sizes(number)

        def columns() -> Array:
            return pixels(self._cached_spots(number), response(parts, place[0], tent), parts).swapaxes(1, 2)

        # Sub-pixel sources in the same column of a pixel share these sums.
        lit = spot_cache.get((self, number, place[0], tent), columns, lambda cells: cells.nbytes)
        return np.maximum(pixels(lit, response(parts, place[1], tent), parts).swapaxes(1, 2), 0.0)


def ends(at: Array, width: Array) -> tuple[Array, Array]:
    """First of the two cells along an axis that a ray lights, and the fraction of its light in the second cell.

    at, width: position and width of the ray, in cells; a ray is as wide as the distance to its neighbors, up to a cell.
    """
    wide = np.clip(width, 1e-6, 1.0)
    after = at + 0.5 * wide
    first = np.floor(after + 0.5 - wide)
    after -= first + 0.5
    return first, np.maximum(after, 0.0) / wide


@lru_cache(maxsize=256)
def response(parts: int, place: float, tent: bool) -> Array:
    """Fraction of the light in cells that a pixel receives along an axis, from a source at `place` in its own pixel.

    parts: cells per px; tent: see `Pupil.share`.
    """
    beside = parts + parts // 2 + 2
    at = np.arange(-beside, beside + 1.0) / parts + place
    sums = [pixel_integral(at + shift / parts, tent) for shift in (-1.5, -0.5, 0.5, 1.5)]
    means = [parts * (high - low) for low, high in pairwise(sums)]
    return np.asarray((1.0 + 2.0 * SHARPER) * means[1] - SHARPER * (means[0] + means[2]))


def pixels(cells: Array, response: Array, parts: int) -> Array:
    """Light in pixels, along the last axis, from the light in cells; the middle cell holds the source."""
    half = cells.shape[-1] // (2 * parts) - 3
    first = cells.shape[-1] // 2 - half * parts - len(response) // 2
    windows = np.lib.stride_tricks.sliding_window_view(cells[..., first:], len(response), axis=-1)
    return np.asarray(windows[..., : 2 * half * parts : parts, :] @ response)


@lru_cache(maxsize=4)
def lens_points(opening: Pupil, count: int) -> tuple[Array, Array, Array]:
    """Lens points of rays, x right and y down, and their light, which sums to 1."""
    light = opening.cells(count)
    at = (np.arange(2.0 * count) + 0.5 - count) * (opening.extent / count)
    row, column = np.nonzero(light > 1e-12 * light.max())
    part = light[row, column]
    return at[column], at[row], part / part.sum()


@lru_cache(maxsize=4)
def bends(opening: Pupil, wavefront: Wavefront, count: int) -> tuple[Array, ...]:
    """Displacements of rays by the wavefront in px, X to the right and Y down, and their derivatives by the lens point
    (x, y): dX/dx, (dX/dy)^2 and dY/dy.
    """
    x, y, _ = lens_points(opening, count)
    (right, down), (xx, xy, yy) = wavefront.gradient(x, y), wavefront.curvature(x, y)
    return 2.0 * right, 2.0 * down, 2.0 * xx, 4.0 * xy * xy, 2.0 * yy
