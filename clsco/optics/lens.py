"""Thin lens: from inverse depth to the signed blur radius (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Camera

LARGEST_BLUR = 512.0  # px; a source beyond it spreads over a million pixels
SHARP = 0.5  # px, |R| up to which a point counts as in focus


@dataclass(frozen=True)
class Lens:
    """A thin lens, as it blurs.

    Attributes
    ----------
    blur_scale : float
        Blur radius per unit of inverse depth, kappa = s0 D / (2 p), in px mm (2.33).
    focus_power : float
        Inverse depth in focus, K = 1/f - 1/s, in 1/mm (2.24). The two terms nearly cancel for long lenses, hence
        float64 on the host.
    radius : float
        Radius of the aperture, D / 2, in mm.
    detector_power : float
        Inverse distance of the detector, 1/s, in 1/mm.

    Examples
    --------
    >>> from clsco import Camera
    >>> from clsco.optics.lens import Lens
    >>> lens = Lens.of(Camera(f_number=2.0, focal_length=20.0, sensor_distance=20.0))
    >>> lens.radius, lens.focus_power
    (5.0, 0.0)
    """

    blur_scale: float
    focus_power: float
    radius: float
    detector_power: float

    @classmethod
    def of(cls, camera: Camera) -> Self:
        """The lens of a camera."""
        return cls(
            camera.normalization_distance * camera.aperture_diameter / (2.0 * camera.pixel_pitch),
            1.0 / camera.focal_length - 1.0 / camera.sensor_distance,
            0.5 * camera.aperture_diameter,
            1.0 / camera.sensor_distance,
        )


def blur_radius(camera: Camera, inverse_depth: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Signed blur radius R = kappa (K - w) of inverse depths w = 1/Z (2.33).

    Parameters
    ----------
    camera : Camera
    inverse_depth : array_like of float64, any shape
        1/mm.

    Returns
    -------
    ndarray of float64
        px, of the same shape; positive behind the focal surface, negative in front of it.

    Notes
    -----
    Validated against the thesis' camera: 0 at 250.017 mm.
    """
    lens = Lens.of(camera)
    return np.asarray(lens.blur_scale * (lens.focus_power - np.asarray(inverse_depth, dtype=np.float64)))


def ray_step(camera: Camera) -> float:
    """Slope between the rays of neighboring pixels, p / s0 (3.1 with 2.4)."""
    return camera.pixel_pitch / camera.normalization_distance
