"""Scenes for the forward warp, and what it makes of them on the device and in the reference."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.textures import Texture
from clsco.opencl.buffers import download
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.motion import Pose, pose_at
from clsco.optics.quadrics import PlacedSurface, place
from clsco.passes.pack import camera_grid, lens_struct
from clsco.passes.placed import PlacedScene
from clsco.passes.warp import ForwardWarp
from clsco.plan.plan import Plan
from clsco.records import Real
from clsco.reference.warp.warp import Reprojected, reproject
from clsco.scene.model import (
    Cone,
    Cylinder,
    DepthMap,
    Ellipsoid,
    Fill,
    Motion,
    Object,
    ObjectMotion,
    Plane,
    Quadric,
    Sphere,
)
from tests.kernels.launches import whole
from tests.scenes import plan_scene, scene_of

Array = NDArray[Any]
MOTION = ObjectMotion(velocity=(0.9, -0.4, -7.0), angular_velocity=(20.0, 35.0, -50.0))
SLOW = ObjectMotion(velocity=(0.11, 0.07, 3.0), angular_velocity=(3.0, -2.0, 5.0))
BOX = ((-2.0, 2.5), (-1.5, 2.0), (-4.0, 4.0))
# All features of the ray-surface solution; sizes odd, even, degenerate, and longer than a segment.
SINGLE: list[tuple[Object, tuple[int, int]]] = [
    (Plane(motion=MOTION), (1, 1)),
    (Plane(slope_x=0.5, slope_y=-0.3, motion=SLOW), (1, 70)),
    (Plane(slope_x=0.5, motion=MOTION), (2, 9)),
    (Plane(bounds=BOX, motion=SLOW), (40, 61)),
    (Sphere(center=(0.2, -0.3, 280.0), radius=4.0, motion=MOTION), (64, 64)),
    (Cylinder(center=(0.0, 0.1, 270.0), radius=2.0, axis=(1.0, 0.2, 0.3), motion=MOTION), (33, 130)),
    (Cone(apex=(0.0, 0.0, 240.0), half_angle=20.0, motion=SLOW), (50, 31)),
    (Ellipsoid(center=(0.5, 0.0, 260.0), semi_axes=(3.0, 2.0, 5.0), motion=MOTION), (47, 20)),
    (Quadric(center=(0.0, 0.0, 260.0), coefficients=(1, 2, 0, 0.3, 0, 0, 0, 0, -20, 0), motion=SLOW), (29, 64)),
]
# Several objects: overlapping, one inside another, equally near ones, a depth map among analytic surfaces and alone.
NEAR, INSIDE = Sphere(center=(0.4, 0.2, 200.0), radius=1.5, motion=SLOW), Sphere(center=(0.5, 0.2, 200.0), radius=0.7)
FAR = Plane(distance=380.0, slope_x=0.2, motion=ObjectMotion(velocity=(-3.0, 1.0, 5.0)))
MAP = DepthMap(depth="card.npy", center=(0.1, 0.0, 260.0), motion=MOTION)
WARPS: dict[str, tuple[tuple[Object, ...], tuple[int, int]]] = {
    **{f"{item.shape} {rows} x {columns}": ((item,), (rows, columns)) for item, (rows, columns) in SINGLE},
    "two balls": (
        (Sphere(center=(-0.8, 0.2, 230.0), radius=1.2, motion=MOTION), Sphere(center=(1.0, 0.0, 250.0), radius=2.0)),
        (45, 70),
    ),
    "near and far": ((NEAR, FAR), (40, 131)),
    "one in another": ((FAR, INSIDE, NEAR), (50, 50)),
    "equally near": ((Plane(name="a", motion=SLOW), Plane(name="b", motion=MOTION)), (30, 40)),
    "map alone": ((MAP,), (40, 70)),
    "map and ball": ((NEAR, MAP), (40, 70)),
    "map before map": ((FAR, MAP, DepthMap(depth="other.npy", center=(0.0, 0.0, 260.0), motion=SLOW), NEAR), (33, 65)),
}


def gray(texture: Array) -> NDArray[np.float32]:
    """A texture (rows, columns, channels) as `Texture` has it."""
    image = texture.astype(np.float32)
    return np.ascontiguousarray(image[..., 0] if image.shape[2] == 1 else image)


@dataclass(frozen=True)
class Case:
    """A scene with its textures (objects, rows, columns, channels) and its structs on the device."""

    plan: Plan
    textures: Array
    guard: int
    time: float = 1.0
    real: Real = "double"

    @property
    def items(self) -> tuple[Object, ...]:
        return self.plan.scene.objects

    @property
    def poses(self) -> list[Pose]:
        return [pose_at(item.motion, self.time, "euler") for item in self.items]

    @property
    def rest(self) -> list[PlacedSurface | None]:
        return self.placed([pose_at(item.motion, 0.0, "euler") for item in self.items])

    @property
    def maps(self) -> list[Array | None]:
        """Cards before nothing, a little uneven, each covering less on its left."""
        rng = np.random.default_rng(43)
        w = rng.uniform(1 / 262.0, 1 / 258.0, (len(self.items), self.plan.rows, self.plan.columns))
        w[:, :4] = w[:, :, -9:] = 0.0
        covered = np.arange(self.plan.columns) >= 20 * np.arange(len(self.items))[:, None]
        return [w[k] * covered[k] if item.shape == "depth_map" else None for k, item in enumerate(self.items)]

    @property
    def shape(self) -> tuple[int, int]:
        return self.plan.rows + 2 * self.guard, self.plan.columns + 2 * self.guard

    @property
    def grid(self) -> Any:
        return camera_grid(self.plan.scene.camera, self.guard, self.real)

    @property
    def lens(self) -> Any:
        return lens_struct(Lens.of(self.plan.scene.camera), self.real)

    def placed(self, poses: list[Pose]) -> list[PlacedSurface | None]:
        pairs = zip(self.items, poses, strict=True)
        return [None if item.shape == "depth_map" else place(item, pose) for item, pose in pairs]

    def twin(self) -> Reprojected:
        """Known pixels according to the reference."""
        textures = list(self.textures.astype(np.float64))
        return reproject(self.plan.scene, textures, self.rest, self.maps, self.poses, self.guard)

    def forward(self, session: Session, owned: bool | None = None) -> ForwardWarp:
        textures = [Texture(gray(texture), 8, f"{number}") for number, texture in enumerate(self.textures)]
        return ForwardWarp(
            self.plan, PlacedScene(session, self.plan.scene, self.plan.psf, textures, self.real), self.maps, owned
        )  # fmt: skip

    def warp(self, session: Session, owned: bool | None = None) -> dict[str, Array]:
        """Valid, value, w, coc and object from the device, nothing filled."""
        forward = self.forward(session, owned)
        done = forward.warp(forward.scene.posed(self.poses), [])
        channels = self.plan.channels
        seen = {} if done.object is None else {"object": download(session, done.object, self.shape, np.uint8)}
        return seen | {
            "valid": download(session, done.valid, self.shape, np.bool_),
            "value": np.moveaxis(download(session, done.value, (channels, *self.shape), np.float32), 0, -1),
            "w": whole(session, done.w, self.shape, self.real),
            "coc": whole(session, done.coc, self.shape, self.real),
        }


def make_case(
    items: tuple[Object, ...], shape: tuple[int, int], guard: int = 3, channels: int = 1, **fill: Any
) -> Case:
    """A scene of objects in a frame of `shape`, rows by columns; fill: keys of [fill]."""
    filled = Fill(**{"method": "none", "domain": "span"} | fill)
    scene = scene_of(*items, size=shape[::-1], motion=Motion(warp="forward"), fill=filled)
    textures = np.random.default_rng(41).random((len(items), *shape, channels)).astype(np.float32)
    # One band for every guard that a test asks for, whatever the blur of the scene needs.
    plan = plan_scene(scene.model_copy(update={"objects": (FAR,)}), channels)
    return Case(replace(plan, scene=scene, guard_px=guard), textures, guard)
