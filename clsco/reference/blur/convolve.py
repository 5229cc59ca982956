"""Blur with one radius for all sources. Twin of kernels/blur/convolve.cl."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.optics.point_spread import PointSpread

Array = NDArray[np.float64]


def convolve(psf: PointSpread, radiance: Array, radius: float, guard: int) -> Array:
    """Defocused image (m, n, C) of a surface of one blur radius: shifted sums with one table of weights.

    radiance: (m + 2 guard, n + 2 guard, C), 0 where no surface is; radius: px. border = "lose" and no tilt,
    which a constant radius does not have. The same as `clsco.reference.blur.blur.scatter`.
    """
    far = psf.reach(abs(radius))
    m, n = radiance.shape[0] - 2 * guard, radiance.shape[1] - 2 * guard
    offset = np.arange(-far, far + 1, dtype=np.float64)
    table = psf.weights(offset[None, :], offset[:, None], np.asarray(abs(radius)))
    padded = np.pad(radiance, ((far, far), (far, far), (0, 0)))
    color = np.zeros((m, n, radiance.shape[2]))
    for dy in range(2 * far + 1):
        for dx in range(2 * far + 1):
            color += table[dy, dx] * padded[guard + dy :, guard + dx :][:m, :n]
    return color
