"""Thin lens: from inverse depth to the signed radius of the blur circle (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Camera

LARGEST_BLUR = 512.0  # px; beyond it one source lights a million pixels


def focus_power(camera: Camera) -> float:
    """K = 1/f - 1/s in 1/mm: the inverse depth that is in focus (2.24).

    Formed in float64 on the host, because the two terms nearly cancel for long lenses.
    """
    return 1.0 / camera.focal_length - 1.0 / camera.sensor_distance


def lens_radius(camera: Camera) -> float:
    """D / 2 in mm."""
    return 0.5 * camera.aperture_diameter


def blur_scale(camera: Camera) -> float:
    """kappa = s0 D / (2 p) in px mm: blur radius per unit of inverse depth (2.33)."""
    return camera.normalization_distance * camera.aperture_diameter / (2.0 * camera.pixel_pitch)


def blur_radius(camera: Camera, inverse_depth: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Signed radius of the blur circle in px (2.33), linear in inverse depth.

    inverse_depth: 1/mm, any shape. Returns the same shape; positive behind the focal surface, negative in
    front of it. Validated against the values of the thesis' camera: 0 at 250.017 mm.
    """
    return np.asarray(blur_scale(camera) * (focus_power(camera) - np.asarray(inverse_depth, dtype=np.float64)))


def focus_distance(camera: Camera) -> float:
    """Distance in mm of the plane that is in focus; infinity when the detector sits at the focal length."""
    power = focus_power(camera)
    return 1.0 / power if power > 0 else float("inf")


def ray_step(camera: Camera) -> float:
    """Slope between the rays of neighboring pixels: p / s0 (3.1 with 2.4)."""
    return camera.pixel_pitch / camera.normalization_distance
