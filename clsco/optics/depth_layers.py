"""Depth layers of layered occlusion: their bounds in signed blur radius, and the rows that a strip needs (pure)."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY_CLASSES, LAYER_BIN
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_reach

MOST_LAYERS = 8


@dataclass(frozen=True)
class LayerBounds:
    """Depth layers of one time sample, from near to far.

    bounds: number of the first bin (`bins_of`) of each layer except the nearest. deep: distance in px, see
    `depth_of_hidden`.
    """

    bounds: tuple[int, ...]
    deep: int


def bins_of(largest: float) -> tuple[float, int]:
    """Lower end in px of the first bin of signed radii, and number of bins, for radii within [-largest, largest] px."""
    half = ceil(largest / LAYER_BIN) + 1
    return -half * LAYER_BIN, 2 * half


def layer_bounds(latest: NDArray[np.int32]) -> list[int]:
    """First bins of the depth layers after the first, at most MOST_LAYERS - 1 of them, increasing.

    latest: (DISCONTINUITY_CLASSES, bins) from `find_discontinuities` of layered.cl: for each size class and each bin of
    the far side of a discontinuity, the first bin behind its near side; 0 without a discontinuity. From near to far, a
    discontinuity that no bound splits yet gets a bound in the middle of its bins. If there are too many bounds, the
    class of the smallest discontinuities is left out.
    """
    for smallest in range(DISCONTINUITY_CLASSES):
        bounds: list[int] = []
        begins = latest[smallest:].max(axis=0)
        for far_bin in np.flatnonzero(begins).tolist():
            begin = int(begins[far_bin])  # the first bin behind the near side
            if not bounds or bounds[-1] < begin:
                bounds.append((begin + far_bin + 1) // 2)
        if len(bounds) < MOST_LAYERS:
            return bounds
    return bounds[: MOST_LAYERS - 1]


def depth_of_hidden(psf: PointSpread, largest_sum: int) -> int:
    """Distance in px behind an edge within which the hidden surface may be visible: the reach of both sides' blurs.

    largest_sum: sum of the |radii| on both sides of a discontinuity, px.
    """
    return ceil(largest_sum * psf.extent + 2.0 * psf.pupil.margin) + 2


def level_count(deep: int) -> int:
    """Number of levels of a pyramid above the finest; pixels of the last depend on all pixels within deep + 1 px."""
    return (deep + 1).bit_length()


def levels_of(rows: int, columns: int, deep: int, planes: int) -> list[tuple[int, int, int]]:
    """Rows, columns and start in floats of every level of a pyramid with `planes` planes, from the finest level on."""
    levels = [(rows, columns, 0)]
    for _ in range(level_count(deep)):
        start = levels[-1][2] + planes * rows * columns
        rows, columns = -(-rows // 2), -(-columns // 2)
        levels.append((rows, columns, start))
    return levels


def most_deep(psf: PointSpread, largest: float) -> int:
    """Upper bound of `depth_of_hidden` for |radii| up to `largest` px."""
    return depth_of_hidden(psf, ceil(2.0 * largest))


def margin_of_layers(psf: PointSpread, largest: float) -> tuple[int, int]:
    """Number of rows beyond a strip that may affect it, and a number of which its grid's first row must be a multiple.

    largest: upper bound of |radius|, px. A hidden pixel that contributes to the strip is interpolated from pixels of
    the pyramid's last level that are up to three such pixels away, and each of these depends on one more. The pixels of
    this level must begin at the same rows as in the whole frame.
    """
    step = 1 << level_count(most_deep(psf, largest))
    return table_reach(psf, largest) + 2 + 4 * step, step
