"""Coarser grids for sources of wide blur: radii, PSFs and sizes of each level (float64, pure)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from clsco.constants import EDGE_COLUMNS, EDGE_ROWS, TAP_LANES
from clsco.optics.psf import shape_of
from clsco.scene.model import Psf

Array = NDArray[np.float64]

MOST_LEVELS = 5
FADE = 1.25  # from the smallest radius that moves to the one from which sources move as a whole
STEEPEST = 1.0  # px to neighbors 2 px away: with more the radii of what shares a node would be too different
SHARING = 0.75  # px^2 per axis: what bilinear sharing among nodes adds to a PSF's second moment, and taking back again
# Of the coarse frame before it is enlarged: for discs as much as gives back what sharing adds, so that less of their
# edge is lost; a Gaussian has nothing to lose, and is nearest without.
SHARPENING = 3 / 16


def sharpening(psf: Psf) -> float:
    """Sharpening of the coarse frame before it is enlarged."""
    return 0.0 if shape_of(psf).soft else SHARPENING


def coarse_psf(psf: Psf) -> Psf:
    """The PSF on coarser grids: over a node's own area, which rounds off least; a cut Gaussian keeps its circle."""
    return psf if shape_of(psf).soft and shape_of(psf).sampled else psf.model_copy(update={"edge": "area"})


def loss(psf: Psf, finest: bool) -> float:
    """Change of R^2 in px^2 by the way to the next coarser grid and back; finest: from the frame's grid."""
    own = shape_of(psf if finest else coarse_psf(psf)).pixel_moment
    added = 2 * SHARING - 8 * sharpening(psf) + 4 * shape_of(coarse_psf(psf)).pixel_moment
    return (added - own) / shape_of(psf).second_moment


def coarse_radius(psf: Psf, radius: float, finest: bool) -> float:
    """Radius in px of the next grid of a source of `radius` px, so that second moments are the same; 0 for none."""
    return 0.5 * sqrt(max(radius * radius - loss(psf, finest), 0.0))


def coarse_radii(psf: Psf, largest: float, least: float) -> tuple[float, ...]:
    """Largest radius on each coarser grid that is used, px of that grid; least: the smallest one there."""
    found: list[float] = []
    while len(found) < MOST_LEVELS and (radius := coarse_radius(psf, largest, not found)) >= least:
        found.append(radius)
        largest = radius
    return tuple(found)


def coarse_frame(rows: int, columns: int, guard: int) -> tuple[int, int, int]:
    """Rows, columns and apron of the next coarser grid: the nodes that pixels of the frame need."""
    first = (guard + 1) // 2
    return (guard + rows) // 2 + 4 - first, (guard + columns) // 2 + 4 - first, first


def plane_shape(width: int, height: int) -> tuple[int, int]:
    """Rows and pitch of a plane of a grid, see kernels/blur/multigrid.cl."""
    return height + 2 * EDGE_ROWS, -(-(width + 4 * EDGE_COLUMNS) // TAP_LANES) * TAP_LANES
