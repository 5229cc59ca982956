"""Thin lens: from inverse depth to the signed blur radius (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Camera

LARGEST_BLUR = 512.0  # px; a source beyond it spreads over a million pixels
SHARP = 0.5  # px, |R| up to which a point counts as in focus


def focus_power(camera: Camera) -> float:
    """Inverse depth in focus, K = 1/f - 1/s (2.24).

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    float
        1/mm.

    Notes
    -----
    The two terms nearly cancel for long lenses, hence float64 on the host.
    """
    return 1.0 / camera.focal_length - 1.0 / camera.sensor_distance


def lens_radius(camera: Camera) -> float:
    """Radius of the aperture, D / 2, in mm."""
    return 0.5 * camera.aperture_diameter


def blur_scale(camera: Camera) -> float:
    """Blur radius per unit of inverse depth, kappa = s0 D / (2 p), in px mm (2.33)."""
    return camera.normalization_distance * camera.aperture_diameter / (2.0 * camera.pixel_pitch)


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
    return np.asarray(blur_scale(camera) * (focus_power(camera) - np.asarray(inverse_depth, dtype=np.float64)))


def ray_step(camera: Camera) -> float:
    """Slope between the rays of neighboring pixels, p / s0 (3.1 with 2.4)."""
    return camera.pixel_pitch / camera.normalization_distance
