"""Pixels around a source, and weights there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_tables import PsfTable, table_weights

Array = NDArray[np.float64]


def grid(half: int) -> tuple[Array, Array]:
    """Offsets dx (1, n) and dy (n, 1) of the pixels up to `half` px away."""
    span = np.arange(-half, half + 1.0)
    return span[None, :], span[:, None]


def square(psf: PointSpread, radius: float, half: int) -> Array:
    """Weights (rows, columns) up to `half` px away."""
    return psf.weights(*grid(half), np.asarray(radius))


def table_error(table: PsfTable, psf: PointSpread, radius: float) -> Array:
    """Distance of the weights of a table from exact ones."""
    weights = table_weights(table, psf, radius)
    return np.abs(weights - square(psf, radius, len(weights) // 2))
