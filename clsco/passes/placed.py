"""A scene on the device: its textures, and its objects at the times of an exposure."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.inputs.mipmaps import mipmap_floats
from clsco.inputs.textures import Texture, empty_image
from clsco.opencl.buffers import upload
from clsco.opencl.session import Session
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at, reference_camera
from clsco.optics.light import place_light
from clsco.optics.motion import Eye, Pose, poses_at, rest_poses
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import place
from clsco.optics.texture_mapping import texture_map
from clsco.passes.job import TimeSample
from clsco.passes.pack import light_struct, pose_structs, surface_structs, texture_map_structs, texture_planes
from clsco.records import Real
from clsco.scene.model import Camera, Scene

# Largest ratio of the radiance of a source to that of the brightest texel: 1 + 4 c, with c < 0.0901
# (kernels/trace/footprint.clh).
MOST_DETAIL = 1.37


class PlacedScene:
    """A scene with a resolution on a device; keeps uploaded arrays until `release`, as launches may read them later.

    textures: textures of all objects (`clsco.inputs.textures.load_scene_textures`); real: precision of the geometry;
    eye: view of a stereo pair, "left" for the only view of a scene; covered: True if the last channel is coverage.
    """

    def __init__(
        self, session: Session, scene: Scene, psf: PointSpread, textures: Sequence[Texture], real: Real,
        eye: Eye = "left", covered: bool = False,
    ) -> None:  # fmt: skip
        self.session, self.scene, self.psf, self.real, self.eye = session, scene, psf, real, eye
        self.textures, self.covered = tuple(textures), covered
        self.bits = max(texture.bits for texture in textures)
        gains = [1.0 if item.mapped is None else MOST_DETAIL for item in scene.objects]
        self.brightest = max(gain * texture.brightest for gain, texture in zip(gains, textures, strict=True))
        pairs = list(zip(textures, scene.objects, strict=True))
        projected = [texture for texture, item in pairs if item.mapped is None]
        # A texture that several objects share is here once. The order does not depend on the order of the objects.
        self.stack = sorted(dict.fromkeys(projected), key=lambda texture: repr(texture.content))
        self.texture_of = [self.stack.index(texture) if item.mapped is None else 0 for texture, item in pairs]
        self.mapped = list(dict.fromkeys(texture for texture, item in pairs if item.mapped is not None))
        self._held: list[cl.Buffer] = []
        self._samples: dict[tuple[float, Eye], TimeSample] = {}

    @cached_property
    def channels(self) -> int:
        """Number of channels: 3 if any texture has color, else 1."""
        images = (image for texture in (*self.stack, *self.mapped) for image in texture.images)
        return max(image.shape[2] if image.ndim == 3 else 1 for image in images)

    @property
    def content(self) -> Hashable:
        """Cache key of the textures, equal for equal textures; None if the content of any texture has no key."""
        key = ("textures", self.channels, *(texture.content for texture in self.stack))
        key += ("mapped", *(texture.content for texture in self.mapped)) if self.mapped else ()
        return None if None in key else key

    @cached_property
    def texture(self) -> cl.Buffer:
        """Projected textures, float (textures, channels, rows, columns), then mipmaps of the other textures."""
        key, cache = self.content, self.session.cache
        return self._planes() if key is None else cache.get(key, self._planes, lambda planes: planes.size)

    def _planes(self) -> cl.Buffer:
        radiances, channels = [texture.radiance for texture in self.stack], self.channels
        if not self.mapped:
            return upload(self.session, texture_planes(radiances, channels))
        starts = self._mipmap_starts
        planes = empty_image((starts[-1],))
        if radiances:
            planes[: starts[0]] = texture_planes(radiances, channels).ravel()
        for texture, (start, end) in zip(self.mapped, pairwise(starts), strict=True):
            texture.mipmap(planes[start:end], channels)
        return upload(self.session, planes)

    @property
    def _mipmap_starts(self) -> list[int]:
        """Index in `texture` of the first float of each mipmap, followed by the number of all floats."""
        base = sum(self.channels * texture.radiance.shape[0] * texture.radiance.shape[1] for texture in self.stack)
        sizes = [(*reversed(texture.radiance.shape[:2]), len(texture.images)) for texture in self.mapped]
        floats = [mipmap_floats(columns, rows, self.channels, images) for columns, rows, images in sizes]
        return [*accumulate(floats, initial=base)]

    @cached_property
    def texture_maps(self) -> cl.Buffer | None:
        """A buffer with texture_map_t of each object; None if no texture is on a surface."""
        return upload(self.session, self.packed_maps) if self.mapped else None

    @cached_property
    def packed_maps(self) -> NDArray[np.void]:
        """texture_map_t of each object, on the host."""
        bases = dict(zip(self.mapped, self._mipmap_starts, strict=False))
        maps = [
            None if item.mapped is None else texture_map(item, *reversed(texture.radiance.shape[:2]))
            for item, texture in zip(self.scene.objects, self.textures, strict=True)
        ]
        first = [bases.get(texture, 0) for texture in self.textures]
        return texture_map_structs(maps, first, self.psf, float(self.covered), self.real)

    def at(self, time: float, eye: Eye | None = None) -> TimeSample:
        """The objects at a time in s, as seen in the view `eye`, by default the scene's; cached until `release`."""
        key = time, eye or self.eye
        if key not in self._samples:
            sample = self.posed(poses_at(self.scene, *key), time, camera_at(self.scene, time))
            light = place_light(self.scene, *key)
            self._samples[key] = sample if light is None else replace(sample, light=(light_struct(light, self.real),))
        return self._samples[key]

    def in_reference_pose(self) -> TimeSample:
        """The objects in the reference pose, in which projected textures show them."""
        return self.posed(rest_poses(self.scene))

    def posed(self, poses: Sequence[Pose], time: float = 0.0, camera: Camera | None = None) -> TimeSample:
        """The objects in these poses relative to `camera`, by default the camera of the reference pose."""
        pairs = zip(self.scene.objects, poses, strict=True)
        placed = tuple(place(item, pose) if item.is_analytic else None for item, pose in pairs)
        packed = surface_structs(self.scene.objects, placed, self.real, self.texture_of)
        return TimeSample(time, camera or reference_camera(self.scene), tuple(poses), placed, packed, self.hold(packed))

    def poses(self, sample: TimeSample) -> cl.Buffer:
        """pose_t of each object at a time sample, on the device; kept until `release`."""
        return self.hold(pose_structs(sample.poses, self.real, ray_step(sample.camera)))

    def hold(self, array: NDArray[Any]) -> cl.Buffer:
        """Upload an array to a buffer that is kept until `release`."""
        self._held.append(upload(self.session, array))
        return self._held[-1]

    def release(self) -> None:
        """Release the uploaded arrays; call this after all launches that read them have ended."""
        self._held.clear()
        self._samples.clear()
