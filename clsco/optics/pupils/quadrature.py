"""Gauss-Legendre nodes, and integrals of a pixel's response along an axis (float64, pure)."""

from __future__ import annotations

from functools import cache

import numpy as np

from clsco.optics.pupils.pupil import Array


@cache
def unit_nodes(count: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on [0, 1].

    Computed at the first use: importing numpy's polynomials takes as long as reading a small scene.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def pixel_integral(t: Array, tent: bool) -> Array:
    """Integral of a pixel's response up to t px from its middle, minus 1/2; tent: see `Pupil.share`."""
    if not tent:
        return np.clip(t, -0.5, 0.5)
    t = np.clip(t, -1.0, 1.0)
    return t - 0.5 * t * np.abs(t)
