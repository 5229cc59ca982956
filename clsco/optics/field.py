"""Wavefront errors that depend on the position in the frame: Seidel's terms (float64, pure).

PSF weights are tabulated at the nodes of a grid over the frame; a source blends those of the four nodes around it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsco.optics.pupils.wavefront import Wavefront

Array = NDArray[np.float64]
CELLS_PER_WAVE = 8.0  # cells from the middle of the frame to its corner, per wave
LEAST_CELLS, MOST_CELLS = 2, 16  # limits of the number of cells from the middle to the corner
BLENDED, BLENDED_RAYS = 6e-3, 1.4e-2  # L1 error of blended weights with CELLS_PER_WAVE: for waves, for rays


@dataclass(frozen=True)
class SeidelField:
    """Seidel's terms of the wavefront over the frame of a camera.

    h: position relative to the middle of the frame, 1 in the corner; rho: lens point, 1 at the edge of the aperture;
    phi: angle between the directions of both.

    coma: W131, coefficient of h rho^3 cos(phi) in px: the optical path (`clsco.optics.pupils.wavefront`) at the edge of
    the aperture for the corner of the frame. astigmatism: W222, coefficient of h^2 rho^2 cos^2(phi), px. curvature:
    W220, coefficient of h^2 rho^2, px. waves: size of the terms in waves of green light, or in px if `by_rays`; it
    determines the number of cells. frame: number of columns and rows. by_rays: True if light follows rays, whose spots
    have sharp edges.
    """

    coma: float
    astigmatism: float
    curvature: float
    waves: float
    frame: tuple[int, int]
    by_rays: bool = False

    @cached_property
    def corner(self) -> float:
        """Distance from the middle of the frame to its corner, px."""
        return 0.5 * hypot(self.frame[0] - 1, self.frame[1] - 1) or 1.0

    @cached_property
    def cells(self) -> tuple[int, int]:
        """Number of grid cells across and down the frame."""
        across, down = (max(2 * ceil(self._cells_to_corner * 0.5 * (size - 1) / self.corner), 2) for size in self.frame)
        return across, down

    @property
    def _cells_to_corner(self) -> float:
        """Number of grid cells from the middle to the corner."""
        return min(max(CELLS_PER_WAVE * self.waves, LEAST_CELLS), MOST_CELLS)

    @property
    def blending(self) -> float:
        """Estimate of the largest fraction of a source's light that blending puts in wrong pixels (L1 norm)."""
        size = CELLS_PER_WAVE * self.waves / self._cells_to_corner
        return BLENDED_RAYS * size if self.by_rays else BLENDED * size**2

    @property
    def nodes(self) -> list[tuple[float, float]]:
        """Grid positions (hx, hy), right and down from the middle of the frame, row by row."""
        x, y = (
            [(2 * k - count) / count * 0.5 * (size - 1) / self.corner for k in range(count + 1)]
            for count, size in zip(self.cells, self.frame, strict=True)
        )
        return [(column, row) for row in y for column in x]

    def at(self, column: ArrayLike, row: ArrayLike) -> tuple[Array, Array]:
        """Positions (hx, hy) of pixels of the frame; pixels beyond it are clamped to its border."""
        return tuple(
            (np.clip(place, 0.0, size - 1.0) - 0.5 * (size - 1)) / self.corner
            for place, size in zip((column, row), self.frame, strict=True)
        )  # type: ignore[return-value]

    def wavefront(self, axis: Wavefront, hx: float, hy: float) -> Wavefront:
        """The wavefront at a position (hx, hy); axis: the wavefront on the axis."""
        bend = (
            self.astigmatism * hx * hx + self.curvature * (hx * hx + hy * hy),
            self.astigmatism * hx * hy,
            self.astigmatism * hy * hy + self.curvature * (hx * hx + hy * hy),
        )
        coma, astigmatism, curvature = (term / self.corner for term in (self.coma, self.astigmatism, self.curvature))
        change = coma, astigmatism * hx, astigmatism * hy, curvature * hx, curvature * hy
        return replace(axis, coma=(self.coma * hx, self.coma * hy), bend=bend, change=change)

    def slope(self, axis: Wavefront) -> float:
        """Largest slope of the wavefront at any grid position, px per lens radius; axis: as for `wavefront`."""
        return max(self.wavefront(axis, *node).upright.slope for node in self.nodes)

    def blend(self, column: ArrayLike, row: ArrayLike) -> tuple[NDArray[np.int64], Array]:
        """Indices (4, ...) into `nodes` of the four nodes around each pixel, and their blending factors (4, ...)."""
        positions = []
        for place, count, size in zip((column, row), self.cells, self.frame, strict=True):
            at = np.clip(np.asarray(place, np.float64) * (count / max(size - 1, 1)), 0.0, count)
            cell = np.minimum(at.astype(np.int64), count - 1)
            positions.append((cell, at - cell))
        (x, right), (y, down) = positions
        first = y * (self.cells[0] + 1) + x
        numbers = np.stack([first, first + 1, first + self.cells[0] + 1, first + self.cells[0] + 2])
        left, up = 1.0 - right, 1.0 - down
        return numbers, np.stack([left * up, right * up, left * down, right * down])
