"""A scene on the device: its textures, and its objects at the times of an exposure."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.inputs.textures import Texture
from clsco.opencl.buffers import upload
from clsco.opencl.session import Session
from clsco.optics.motion import Eye, Pose, poses_at, rest_center, rest_poses
from clsco.optics.quadrics import PlacedSurface, place
from clsco.passes.pack import pose_structs, surface_structs, texture_planes
from clsco.records import Real, structs
from clsco.scene.model import Scene

Surfaces = tuple[PlacedSurface | None, ...]  # of every object, None for a depth map


@dataclass(frozen=True)
class TimeSample:
    """The objects of a scene at one time.

    Attributes
    ----------
    time : float
        Seconds.
    weight : float
        In the exposure.
    poses : tuple of Pose
        Of every object before the camera, wherever that is itself.
    placed : tuple of PlacedSurface or None
        The objects in their poses.
    packed : ndarray
        surface_t of every object.
    surfaces : Buffer
        The same on the device.
    """

    time: float
    weight: float
    poses: tuple[Pose, ...]
    placed: Surfaces
    packed: NDArray[np.void]
    surfaces: cl.Buffer


class PlacedScene:
    """A scene with a resolution on a device.

    Parameters
    ----------
    session : Session
    scene : Scene
    textures : sequence of Texture
        Of every object (`clsco.inputs.textures.load_scene_textures`).
    real : {"double", "float"}
        Precision of the geometry.
    eye : {"left", "right"}
        Of a stereo pair.

    Notes
    -----
    What is uploaded stays until `release`, since the host runs ahead of the launches that read it.
    """

    def __init__(
        self, session: Session, scene: Scene, textures: Sequence[Texture], real: Real, eye: Eye = "left"
    ) -> None:
        self.session, self.scene, self.real, self.eye = session, scene, real, eye
        self.bits = max(texture.bits for texture in textures)
        self.brightest = max(texture.brightest for texture in textures)
        # Those that several objects have in common once, in one order for all scenes.
        self.stack = sorted(dict.fromkeys(textures), key=lambda texture: repr(texture.content))
        self.texture_of = [self.stack.index(texture) for texture in textures]
        self._texture: cl.Buffer | None = None
        self._held: list[cl.Buffer] = []

    @property
    def channels(self) -> int:
        """1, or 3 where any texture has color."""
        return max(texture.radiance.shape[2] if texture.radiance.ndim == 3 else 1 for texture in self.stack)

    @property
    def content(self) -> Hashable:
        """What identifies the textures: the same for the same ones; None where that is not known."""
        found = ("textures", self.channels, *(texture.content for texture in self.stack))
        return None if None in found else found

    @property
    def texture(self) -> cl.Buffer:
        """The textures: float (textures, channels, rows, columns)."""
        if self._texture is None:
            key, kept = self.content, self.session.kept
            self._texture = self._planes() if key is None else kept.get(key, self._planes, lambda planes: planes.size)
        return self._texture

    def _planes(self) -> cl.Buffer:
        return upload(self.session, texture_planes([texture.radiance for texture in self.stack], self.channels))

    def at(self, time: float, weight: float = 1.0, eye: Eye | None = None) -> TimeSample:
        """The objects at a time in s, as `eye` sees them."""
        return self.posed(poses_at(self.scene, time, eye or self.eye), time, weight)

    def in_reference_pose(self) -> TimeSample:
        """The objects as the textures show them."""
        return self.posed(rest_poses(self.scene))

    def posed(self, poses: Sequence[Pose], time: float = 0.0, weight: float = 1.0) -> TimeSample:
        """The objects in given poses."""
        pairs = zip(self.scene.objects, poses, strict=True)
        placed = tuple(place(item, pose) if item.is_analytic else None for item, pose in pairs)
        packed = self._surface_structs(placed)
        return TimeSample(time, weight, tuple(poses), placed, packed, self.hold(packed))

    def poses(self, sample: TimeSample) -> cl.Buffer:
        """pose_t of every object."""
        return self.hold(pose_structs(sample.poses, self.real))

    def hold(self, array: NDArray[Any]) -> cl.Buffer:
        """An array on the device until `release`."""
        self._held.append(upload(self.session, array))
        return self._held[-1]

    def release(self) -> None:
        """Let go of what is held; all launches that read it have ended."""
        self._held.clear()

    def _surface_structs(self, placed: Surfaces) -> NDArray[np.void]:
        """surface_t of every object; of depth maps only the center, about which they turn."""
        items, known = self.scene.objects, [k for k, surface in enumerate(placed) if surface is not None]
        array = np.zeros(len(items), structs(self.real)["surface_t"])
        given = [surface for surface in placed if surface is not None]
        array[known] = surface_structs([items[k] for k in known], given, self.real)
        for k in set(range(len(items))) - set(known):
            center, rest = rest_center(items[k]), array["rest"][k]
            rest[:3] = center
            rest[3:] = (center - rest[:3])[: rest.size - 3]  # the low parts of single precision
        array["texture"] = self.texture_of
        return array
