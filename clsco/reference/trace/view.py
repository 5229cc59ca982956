"""The surfaces that rays are cast at, and hits of rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens import Lens
from clsco.optics.light import PlacedLight
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import PlacedSurface, cutting_bounds
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import (
    Array,
    Bounds,
    blur_gradient,
    blur_radius,
    mirror_index,
    nearest_surface,
    pixel_ray,
    rest_pixel,
    sample_texture,
    surface_slope,
)
from clsco.reference.trace.footprint import parts_of, sharpening, surface_texture
from clsco.reference.trace.light import shade
from clsco.reference.trace.mapping import MappedTexture
from clsco.scene.model import Camera, Scene

Texture = Array | MappedTexture
"""An array (rows, columns, channels) of the frame's size, or an image on a surface."""


@dataclass(frozen=True, eq=False)
class View:
    """All objects at one time, in the frame of the camera.

    surfaces: one per object; textures: one per object, all with the same number of channels; moved: True if an object
    or the camera is not exactly in its reference pose, or the lens zooms; light: the scene's light, if it has one; psf:
    PSF of the lens; reference: the camera in its reference pose; lens: the lens for the selected color; lenses: one, or
    one per color.
    """

    scene: Scene
    surfaces: tuple[PlacedSurface, ...]
    textures: tuple[Texture, ...]
    moved: bool
    light: PlacedLight | None
    psf: PointSpread
    reference: Camera
    lens: Lens
    lenses: tuple[Lens, ...]

    @property
    def camera(self) -> Camera:
        return self.scene.camera

    @cached_property
    def bounds(self) -> list[Bounds | None]:
        """Boxes that cut the objects, None for none."""
        return [cutting_bounds(item) for item in self.scene.objects]

    def nearest(self, group: OcclusionGroup, rays: Array) -> tuple[Array, NDArray[np.uint8], NDArray[np.int32]]:
        """`nearest_surface` of a group along rays (..., 3)."""
        return nearest_surface(self.surfaces, self.bounds, group, rays)

    @property
    def channels(self) -> int:
        first = self.textures[0]
        return int((first.levels[0] if isinstance(first, MappedTexture) else first).shape[-1])


@dataclass(frozen=True, eq=False)
class Cast:
    """Hits of rays (...).

    w: inverse depth, 1/mm; label: root and object, 0 for none; number: object number, -1 for none; radius: signed blur
    radius, px; gradient: gradient of the radius; radiance: radiance of the texture, shaded; parts: number per axis of
    the parts that the texture needs, 0 for none; share: sharpening coefficient of the texture.
    """

    w: Array
    label: NDArray[np.uint8]
    number: NDArray[np.int32]
    radius: Array
    gradient: Array
    radiance: Array
    parts: NDArray[np.intp]
    share: Array


def cast(
    view: View, group: OcclusionGroup, row: NDArray[Any], column: NDArray[Any],
    texel: tuple[NDArray[Any], NDArray[Any]], sources: int = 1,
) -> Cast:  # fmt: skip
    """The nearest surface of an occlusion group along rays through (row, column) px; all values are 0 without a hit.

    texel: row and column of the pixel whose texel a ray shows in the reference pose; sources: number of sources per
    axis of a pixel.
    """
    scene, rays = view.scene, pixel_ray(view.camera, row, column)
    w, label, number = view.nearest(group, rays)
    gradient, radiance = np.zeros((*w.shape, 2)), np.zeros((*w.shape, view.channels))
    parts, share = np.zeros(w.shape, np.intp), np.zeros(w.shape)
    for k, surface in enumerate(view.surfaces):
        if not group.members >> k & 1:
            continue
        on_object = (number == k)[..., None]
        slope, texture = surface_slope(surface, rays, w), view.textures[k]
        gradient = np.where(on_object, blur_gradient(view.camera, view.lens, slope, rays, w), gradient)
        if isinstance(texture, MappedTexture):
            light, hit = np.zeros(radiance.shape), on_object[..., 0] & (w > 0.0)
            light[hit], fineness = surface_texture(texture, surface, view.camera, rays[hit], w[hit], sources)
            size = blur_radius(view.lens, rays[hit], w[hit])
            parts[hit] = parts_of(texture, fineness, size, scene.psf.silhouette_samples)
            share[hit] = sharpening(texture, size)
        elif view.moved:
            # The texture at the points' projections in the reference pose; 0 where they were behind the lens.
            at_row, at_column, valid = rest_pixel(surface, view.reference, rays, w)
            light = sample_texture(texture, at_row, at_column, scene.motion.texture_filter) * valid[..., None]
        else:
            pixel = (mirror_index(np.asarray(n, np.int64), size) for n, size in zip(texel, texture.shape, strict=False))
            light = np.broadcast_to(texture[*pixel], radiance.shape)
        if view.light is not None:
            light = light * shade(view.light, surface, k, rays, w)[..., None]
        radiance = np.where(on_object, light, radiance)
    radius = np.where(label > 0, blur_radius(view.lens, rays, w), 0.0)
    return Cast(w, label, number, radius, gradient, radiance, parts, share)
