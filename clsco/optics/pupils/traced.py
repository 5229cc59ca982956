"""Lenses with aberrations by rays, without diffraction (float64, pure).

A ray through l, in radii of the lens, arrives at R l + 2 grad W px from its source's place, W the optical path in px
(`clsco.optics.pupils.wavefront`): the limit of waves that are infinitely short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, floor, log2, sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clsco.constants import POWERS
from clsco.optics.pupils.diffracted import panel_nodes
from clsco.optics.pupils.fourier import FourierDiffracted
from clsco.optics.pupils.pupil import Array, Pupil
from clsco.optics.pupils.wavefront import Wavefront

MOST_PARTS, LEAST_PARTS = 16, 2  # cells of a spot per px, as many as make SPOT or fewer of its reach
SPOT = 256
# Part of a response: the variance that cells of light and means over them add, 1/6 of a cell squared.
SHARPER = 1.0 / 12.0
RAYS_PER_PX, FEWEST_RAYS, MOST_RAYS = 16, 96, 384  # per radius of the lens, by the size of its spot
STEPS_PER_PX = 8  # intervals of tables
SECONDS, PLACE = 3e-8, 0.07  # of a core: a ray, and the part of it for each place of a source in its pixel
NO_WAVES = ((1.0, 1.0),)


@dataclass(frozen=True)
class Traced(FourierDiffracted):
    """Opening of any shape and a wavefront, whose light goes by rays; `bands` and `tail` mean nothing.

    Weights are cubics in R over the intervals of tables, between sums over rays. Validated against the closed disc, and
    moments of coma, astigmatism and spherical aberration (tests/optics/pupils/test_traced.py).

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.pupils.circle import Circle
    >>> from clsco.optics.pupils.traced import Traced
    >>> from clsco.optics.pupils.wavefront import Wavefront
    >>> lens = Traced(Circle(), wavefront=Wavefront(coma=(0.5, 0.0)))
    >>> lens.share(np.array([-1.0, 0.0, 1.0]), np.zeros(3), np.array(0.0), tent=True).round(2)
    array([0.  , 0.25, 0.31])
    """

    NODES: ClassVar[int] = POWERS

    bands: tuple[tuple[float, float], ...] = NO_WAVES

    @property
    def name(self) -> str:
        return f"{self.opening.name}, aberrations by rays"

    @property
    def steps(self) -> int:
        return STEPS_PER_PX

    @property
    def panel(self) -> float:
        return 1.0 / STEPS_PER_PX

    @property
    def margin(self) -> float:
        """Distance from the rim of the blur that the wavefront bends rays to, px."""
        return 2.0 * self.slope

    def samples(self, radius: float) -> float:
        """Rays over the diameter for a blur radius in px."""
        return 2.0 * self._count(abs(radius))

    def left_out(self, _: float) -> float:
        return 0.0

    def seconds(self, radius: float, places: int) -> float:
        return SECONDS * 4.0 * self._count(radius) ** 2 * (1.0 + PLACE * places)

    def _clipped(self, found: Array) -> Array:
        """Cubics between nodes where no weight is negative, as tables have them: they may be, between these."""
        return found

    def _count(self, radius: float) -> int:
        """Rays per radius of the lens."""
        wanted = RAYS_PER_PX * (radius * self.extent + self.margin)
        return min(max(32 * ceil(wanted / 32.0), FEWEST_RAYS), MOST_RAYS)

    def _spots(self, number: int) -> Array:
        """Light at the nodes of a panel, in the cells (nodes, y, x) of spots."""
        nodes = panel_nodes(np.array([number]), self.panel, POWERS)[0]
        parts, reach, count = self._sizes(number)
        x, y, light, bent_x, bent_y = bent_rays(self.opening, self.wavefront, count)
        pitch, found = self.extent / (count * sqrt(self.second_moment)), []
        for radius in nodes.tolist():
            columns = ends(parts * (radius * x + bent_x), light, pitch, parts * reach)
            rows = ends(parts * (radius * y + bent_y), light, pitch, parts * reach)
            found.append(spot(columns, rows, light, 2 * parts * reach + 1))
        return np.stack(found)

    def _sizes(self, number: int) -> tuple[int, int, int]:
        """Cells per px and reach in px of the spots of a panel, and rays per radius of the lens."""
        farthest = self.panel * max(abs(number), abs(number + 1))
        reach = ceil(farthest * self.extent + self.margin) + 4
        parts = 2 ** floor(log2(SPOT / reach))
        return min(max(parts, LEAST_PARTS), MOST_PARTS), reach, self._count(farthest)

    def _made(self, number: int, place: tuple[float, float], tent: bool) -> Array:
        found: Array = self._kept_spots(number)
        parts, *_ = self._sizes(number)
        for at in place:
            found = pixels(found, response(parts, at, tent), parts).swapaxes(1, 2)
        return np.maximum(found, 0.0)


def ends(at: Array, light: Array, pitch: float, middle: int) -> tuple[NDArray[np.int64], Array]:
    """First of the two cells along an axis that rays light, and the part of the second: rays fill the gaps between
    them, as those of a disc with the same deviation do."""
    mean = float((at * light).sum())
    wide = min(max(pitch * sqrt(float(((at - mean) ** 2 * light).sum())), 1e-6), 1.0)
    first = np.floor(at + 0.5 - 0.5 * wide).astype(np.int64)
    return middle + first, np.maximum(at + (0.5 * wide - 0.5) - first, 0.0) / wide


def spot(
    columns: tuple[NDArray[np.int64], Array], rows: tuple[NDArray[np.int64], Array], light: Array, count: int
) -> Array:
    """Light (y, x) in `count` cells a side, of rays by their `ends`."""
    (column, right), (row, down) = columns, rows
    first, lower, found = row * count + column, light * down, np.zeros(count * count)
    for k, part in ((0, light - lower), (count, lower)):
        inner = part * right
        found += np.bincount(first + k, part - inner, len(found))
        found += np.bincount(first + k + 1, inner, len(found))
    return found.reshape(count, count)


@lru_cache(maxsize=256)
def response(parts: int, place: float, tent: bool) -> Array:
    """Part of the light in cells around a pixel that it gets along an axis, of a source at a place in its own.

    parts: cells per px; tent: of a square source instead of a point.
    """
    beside = parts + parts // 2 + 2
    at = np.arange(-beside, beside + 1.0) / parts + place
    sums = [_below(at + shift / parts, tent) for shift in (-1.5, -0.5, 0.5, 1.5)]
    means = [parts * (high - low) for low, high in pairwise(sums)]
    return np.asarray((1.0 + 2.0 * SHARPER) * means[1] - SHARPER * (means[0] + means[2]))


def _below(at: Array, tent: bool) -> Array:
    """Integral of the response of a pixel up to a place."""
    if not tent:
        return np.clip(at, -0.5, 0.5)
    at = np.clip(at, -1.0, 1.0)
    return at - 0.5 * at * np.abs(at)


def pixels(cells: Array, response: Array, parts: int) -> Array:
    """Light in pixels, along the last axis, from that in cells, of which the one in the middle is the source."""
    half = cells.shape[-1] // (2 * parts) - 3
    first = cells.shape[-1] // 2 - half * parts - len(response) // 2
    windows = np.lib.stride_tricks.sliding_window_view(cells[..., first:], len(response), axis=-1)
    return np.asarray(windows[..., : 2 * half * parts : parts, :] @ response)


@lru_cache(maxsize=4)
def bent_rays(opening: Pupil, wavefront: Wavefront, count: int) -> tuple[Array, Array, Array, Array, Array]:
    """Lens points of rays, x right and y down, their light, which adds up to 1, and what bends them, px."""
    light = opening.cells(count)
    at = (np.arange(2.0 * count) + 0.5 - count) * (opening.extent / count)
    row, column = np.nonzero(light > 1e-12 * light.max())
    x, y, part = at[column], at[row], light[row, column]
    right, down = wavefront.gradient(x, y)
    return x, y, part / part.sum(), 2.0 * right, 2.0 * down
