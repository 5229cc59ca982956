"""Vignetting: irradiance of each pixel relative to the middle of the frame (float64, pure)."""

from __future__ import annotations

import numpy as np

from clsco.optics.distortion import Array, distortion_of
from clsco.optics.lens import ray_step
from clsco.optics.rays import slopes_at
from clsco.scene.lens import Vignetting
from clsco.scene.model import Camera


def throughput(camera: Camera, vignetting: Vignetting) -> Array:
    """Irradiance (rows, columns) of pixels relative to the middle of the frame, for a value of lens.vignetting.

    "natural": cos^4 of the angle between ray and axis, (1 + t^2)^-2 for a ray of slope t. Coefficients a1, a2, a3: 1 +
    a1 r^2 + a2 r^4 + a3 r^6, with r the distance from the middle of the frame, relative to that of its corner. For a
    thin lens, cos^4 is exact only for a small aperture: in the corner of the thesis' frame, the mean over an aperture
    of f/2 is 0.6 % higher.
    """
    columns, rows = camera.frame_size
    x, y = np.arange(columns) - 0.5 * (columns - 1), 0.5 * (rows - 1) - np.arange(rows)
    squared = x * x + (y * y)[:, None]
    if vignetting == "none":
        return np.ones((rows, columns))
    if vignetting == "natural":
        inverse = 1.0 + ray_step(camera) ** 2 * squared
        if distortion_of(camera) is not None:
            across, up = slopes_at(camera, x, y[:, None])
            inverse = 1.0 + across * across + up * up
        return np.asarray(1.0 / (inverse * inverse))
    a1, a2, a3 = vignetting
    share = squared / (0.25 * (columns * columns + rows * rows))
    return np.asarray(1.0 + share * (a1 + share * (a2 + share * a3)))
