"""Blurs of the PSFs that tests are written for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.pupils import load_point_spread
from clsco.optics.point_spread import PointSpread
from clsco.plan.methods import Blur, BlurSpec
from clsco.scene.model import Aperture, Psf


def spec_of(
    psf: Psf, largest: float = 0.0, method: Blur = "gather", aperture: Aperture | None = None, **others: Any
) -> BlurSpec:
    """Blur by the keys of [psf] and [aperture]; `largest`: |R| in px."""
    given = {"smallest": 0.0, "tilt": psf.tilt, "border": psf.border} | others
    return BlurSpec(load_point_spread(psf, aperture or Aperture()), method, largest=largest, **given)


def convolve(psf: PointSpread, radiance: NDArray[np.float64], radius: float, guard: int) -> NDArray[np.float64]:
    """Blurred image (m, n, C) of radiances (m + 2 guard, n + 2 guard, C) of one radius, px: weights, shifted."""
    far, (rows, columns, channels) = psf.reach(abs(radius)), radiance.shape
    offset = np.arange(-far, far + 1, dtype=np.float64)
    table = psf.weights(offset[None, :], offset[:, None], np.asarray(abs(radius)))
    padded = np.pad(radiance, ((far, far), (far, far), (0, 0)))
    color = np.zeros((rows - 2 * guard, columns - 2 * guard, channels))
    for (dy, dx), weight in np.ndenumerate(table):
        color += weight * padded[guard + dy :, guard + dx :][: len(color), : color.shape[1]]
    return color
