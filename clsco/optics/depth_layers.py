"""Depth layers of layered occlusion: their bounds in signed blur radius, and the rows that a strip needs (pure)."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY_CLASSES, LAYER_BIN, LAYER_TILE, REACH_MARGIN
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_reach

MOST_LAYERS = 8


def bins_of(largest: float) -> tuple[float, int]:
    """Lower end in px of the first bin of signed radii, and number of bins, for radii within [-largest, largest] px."""
    half = ceil(largest / LAYER_BIN) + 1
    return -half * LAYER_BIN, 2 * half


def layer_bounds(latest: NDArray[np.int32]) -> list[int]:
    """First bins of the depth layers after the first, at most MOST_LAYERS - 1 of them, increasing.

    latest: (DISCONTINUITY_CLASSES, bins) from `find_discontinuities` of layered.cl: for each size class and each bin of
    the far side of a discontinuity, the first bin behind its near side; 0 without a discontinuity. From near to far, a
    discontinuity that no bound splits yet gets a bound in the middle of its bins. If there are too many bounds, those
    of the larger classes are taken, and evenly some of the class that is too many.
    """
    bounds, finer = list[int](), list[int]()
    for smallest in range(DISCONTINUITY_CLASSES + 1):
        bounds = _bounds(latest[smallest:].max(axis=0, initial=0))
        if len(bounds) < MOST_LAYERS:
            break
        finer = bounds
    others, room = [each for each in finer if each not in bounds], MOST_LAYERS - 1 - len(bounds)
    some = [others[(2 * k + 1) * len(others) // (2 * room)] for k in range(room if others else 0)]
    return sorted(bounds + some)


def _bounds(begins: NDArray[np.int32]) -> list[int]:
    """Bounds that split all discontinuities; begins: for each bin of a far side the first bin behind the near side."""
    bounds: list[int] = []
    for far_bin in np.flatnonzero(begins).tolist():
        begin = int(begins[far_bin])
        if not bounds or bounds[-1] < begin:
            bounds.append((begin + far_bin + 1) // 2)
    return bounds


def signs_of(low: float, bins: tuple[int, ...]) -> tuple[int, ...]:
    """Signs of the radii that the sheet of a depth layer may have, 1 also for 0. low: from `bins_of`; bins: the layer's
    first bin, and the next layer's. A radius that is another layer's may be a bin off.
    """
    least, most = (low + LAYER_BIN * (number + more) for number, more in zip(bins, (-1, 1), strict=True))
    return tuple(sign for sign, there in ((1, most >= 0.0), (-1, least < 0.0)) if there)


def reaches_of(psf: PointSpread, radii: NDArray[np.float64]) -> NDArray[np.int64]:
    """Upper bounds in px of what sources with these signed radii (px) reach."""
    return np.ceil(np.abs(radii) * psf.extent + psf.pupil.margin).astype(np.int64) + REACH_MARGIN


def level_count(deep: int) -> int:
    """Number of levels of a pyramid above the finest: what is known reaches all pixels within `deep` px of it."""
    return max((deep - 1).bit_length() + 1, 1)


def levels_of(rows: int, columns: int, deep: int, planes: int) -> list[tuple[int, int, int]]:
    """Rows, columns and start in floats of every level of a pyramid with `planes` planes, from the second level on. The
    finest level is not stored.
    """
    levels, start = [], 0
    for _ in range(level_count(deep)):
        rows, columns = -(-rows // 2), -(-columns // 2)
        levels.append((rows, columns, start))
        start += planes * rows * columns
    return levels


def most_deep(psf: PointSpread, largest: float) -> int:
    """Distance in px behind an edge within which a hidden surface may be visible, for |radii| up to `largest` px: the
    hidden surface reaches a pixel that is in reach of the edge.
    """
    return 2 * int(reaches_of(psf, np.array([largest]))[0])


def margin_of_layers(psf: PointSpread, largest: float) -> tuple[int, int]:
    """Number of rows beyond a strip that may affect it, and a number of which its grid's first row must be a multiple.

    largest: upper bound of |radius|, px. A hidden pixel that contributes to the strip is interpolated from pixels of
    the pyramid's last level up to two such pixels away. The pixels of this level and the tiles must begin at the same
    rows as in the whole frame.
    """
    step = max(1 << level_count(most_deep(psf, largest)), LAYER_TILE)
    return table_reach(psf, largest) + 2 + 3 * step, step
