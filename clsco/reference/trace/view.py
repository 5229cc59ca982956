"""The surfaces that rays are cast at, and hits of rays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens import Lens
from clsco.optics.light import PlacedLight
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import PlacedSurface, cutting_bounds
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import Array, Bounds, nearest_surface
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
