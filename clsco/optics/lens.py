"""Lens model: signed blur radius from inverse depth (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self, cast

import numpy as np

from clsco.optics.distortion import Array, Distortion, distortion_of
from clsco.scene.lens import Lens as Aberrations
from clsco.scene.model import Camera

LARGEST_BLUR = 512.0  # px; a source beyond it spreads over a million pixels
SHARP = 0.5  # px, |R| up to which a point counts as in focus


@dataclass(frozen=True)
class Lens:
    """A lens for one color, or for all colors if they are blurred equally.

    blur_scale: blur radius per unit of inverse depth, kappa = s0 D / (2 p), px mm (2.33). focus_power: inverse depth in
    focus on the axis, K = 1/f - 1/s, 1/mm (2.24); the two terms nearly cancel for long lenses, hence float64 on the
    host. radius: aperture radius D / 2, mm. detector_power: inverse distance 1/s of the detector, 1/mm. sag: field
    curvature, -c s0^2 / (2 s) for a curvature c: the image of a plane lies sag t^2 s in front of the detector on rays
    of slope t. sphere: inverse radius in 1/mm of the sphere around the lens that is in focus for light of the camera's
    focal length; 0 if a plane is in focus. distortion: that of the image and of its blur, or None.
    """

    blur_scale: float
    focus_power: float
    radius: float
    detector_power: float
    sag: float = 0.0
    sphere: float = 0.0
    distortion: Distortion | None = None

    @classmethod
    def of(cls, camera: Camera, real: Aberrations | None = None, color: int | None = None) -> Self:
        """The lens of a camera; real: its differences from a thin lens; color: 0, 1, 2 for red, green, blue light, None
        for light for which the focal length is the camera's.
        """
        f, s, scale = camera.focal_length, camera.sensor_distance, camera.normalization_distance
        longer = 0.0 if real is None or color is None else real.axial[color]
        curvature = 0.0 if real is None else real.field_curvature
        return cls(
            scale * camera.aperture_diameter / (2.0 * camera.pixel_pitch),
            1.0 / f - 1.0 / s - longer / (f * (f + longer)),
            0.5 * camera.aperture_diameter,
            1.0 / s,
            -0.5 * curvature * scale * scale / s,
            0.0 if real is None or real.focus_surface == "plane" else 1.0 / f - 1.0 / s,
            distortion_of(camera),
        )

    @property
    def is_curved(self) -> bool:
        """True if the surface in focus is not a plane."""
        return self.sag != 0.0 or self.sphere != 0.0

    def focus_rise(self, squared_slope: Array) -> Array:
        """Derivative (dK/dt) / t of the inverse depth K in focus on rays of slope t, 1/mm; squared_slope: t^2."""
        bend = 1.0 + self.sag * squared_slope
        by_field = 2.0 * self.detector_power * self.sag / (bend * bend)
        return np.asarray(by_field + self.sphere / np.sqrt(1.0 + squared_slope))

    def along(self, x: Array | float, y: Array | float) -> Self:
        """The lens for rays of slopes x and y; with distortion, `blur_scale` is an array with the local scale."""
        if self.distortion is None:
            return self
        return replace(self, blur_scale=cast(float, self.blur_scale * self.distortion.stretch(x, y)))

    def image_radius(self, inverse_depth: Array | float, x: Array | float, y: Array | float) -> Array:
        """Signed blur radius in px for inverse depths in 1/mm on rays of slopes x and y, which broadcast; with
        distortion, the radius of the disc with the area of the blur.
        """
        squared = np.asarray(x) ** 2 + np.asarray(y) ** 2 if self.is_curved else 0.0
        return self.along(x, y).blur_radius(inverse_depth, squared)

    def blur_radius(self, inverse_depth: Array | float, squared_slope: Array | float = 0.0) -> Array:
        """Signed blur radius R = kappa (K - w) in px of inverse depths w = 1/Z in 1/mm (2.33): positive behind the
        surface that is in focus, negative in front of it.

        squared_slope: t^2 = x^2 + y^2 of the ray (x, y, 1), used if the surface in focus is curved. With field
        curvature the image of a plane is in front of the detector by d = -c s0^2 t^2 / 2, so that K(t) = 1/f - 1/(s +
        d) = K + d / (s (s + d)). If a sphere is in focus, the depth in focus along a ray is its radius times cos(theta)
        = 1 / sqrt(1 + t^2), so that K / cos(theta) replaces K. Both are added to K - w as differences, which preserves
        digits where R is almost 0.
        """
        w = np.asarray(inverse_depth, dtype=np.float64)
        power = self.focus_power - w
        if self.is_curved:
            squared = np.asarray(squared_slope, dtype=np.float64)
            bend = self.sag * squared
            power = power + self.detector_power * bend / (1.0 + bend)
            power = power + self.sphere * (squared / (1.0 + np.sqrt(1.0 + squared)))
        return np.asarray(self.blur_scale * power)


def blur_radius(camera: Camera, inverse_depth: Array | float) -> Array:
    """Signed blur radius in px of inverse depths in 1/mm for a thin lens, see `Lens.blur_radius`."""
    return Lens.of(camera).blur_radius(inverse_depth)


def ray_step(camera: Camera) -> float:
    """Slope between the rays of neighboring pixels, p / s0 (3.1 with 2.4)."""
    return camera.pixel_pitch / camera.normalization_distance
