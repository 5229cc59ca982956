"""The sphere scene in Mitsuba 3: a thin lens, a texture that emits, and as many rays per pixel as one asks for.

Mitsuba knows no blur radius and no normalization distance: its `thinlens` gets the aperture's radius, the distance in
focus, and the field of view of the frame at the distance s0. Its axis x runs to the left. The texture is the pinhole
image, sampled at the projection of the point that a ray meets; this takes half the time of a fine mesh with texture
coordinates. Needs the extra `bench`, and LLVM's shared library (Debian: libllvm19), which DRJIT_LIBLLVM_PATH names
where it is not found.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Camera, Scene, Sphere

Array = NDArray[Any]

VARIANT = "llvm_ad_rgb"  # one channel (llvm_ad_mono) takes as long; scalar variants many times that
SAMPLER = "multijitter"


def unusable() -> str | None:
    """Why Mitsuba, though it is installed, cannot be used; None where it can."""
    import mitsuba

    try:
        mitsuba.set_variant(VARIANT)
    except ImportError:  # the variant is not in this build, or there is no LLVM
        return f"{VARIANT} needs LLVM's shared library, such as Debian's libllvm19; DRJIT_LIBLLVM_PATH may name it"
    return None


def field_of_view(camera: Camera, columns: int) -> float:
    """Full angle in degrees that a frame of so many columns spans at the distance s0."""
    return 2 * math.degrees(math.atan(columns * camera.pixel_pitch / (2 * camera.normalization_distance)))


def in_focus(camera: Camera) -> float:
    """Distance in mm that is in focus: 1/u = 1/f - 1/s."""
    return 1 / (1 / camera.focal_length - 1 / camera.sensor_distance)


def set_up(scene: Scene, texture: Array) -> Callable[[int, int], Array]:
    """Prepare a scene of one static sphere; the result renders (rows, columns) by (rays per pixel, seed).

    scene: examples/sphere.toml, or with another lens, center or radius; texture: linear radiance (rows, columns) of
    the frame's size.
    Validated against `clsco.truth`: the difference falls with the root of the number of rays.
    """
    import mitsuba as mi

    mi.set_variant(VARIANT)
    rows, columns = texture.shape
    camera, ball = scene.camera, scene.objects[0]
    assert isinstance(ball, Sphere)
    width, height = (n * camera.pixel_pitch / camera.normalization_distance for n in (columns, rows))

    class Projected(mi.Texture):
        """A bitmap at the pinhole projection of the point that a ray meets."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            data = mi.TensorXf(texture[:, :, None].astype(np.float32))
            bitmap = {"type": "bitmap", "data": data, "raw": True, "filter_type": "nearest", "wrap_mode": "mirror"}
            self.bitmap = mi.load_dict(bitmap)

        def eval(self, interaction: Any, active: Any = True) -> Any:
            x, y, z = interaction.p.x, interaction.p.y, interaction.p.z
            interaction.uv = mi.Point2f(0.5 - x / (z * width), 0.5 - y / (z * height))
            return self.bitmap.eval(interaction, active)

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "Projected[]"

    mi.register_texture("projected", Projected)
    x, y, z = ball.center
    lens = {
        "type": "thinlens",
        "aperture_radius": camera.aperture_diameter / 2,
        "focus_distance": in_focus(camera),
        "fov": field_of_view(camera, columns),
        "fov_axis": "x",
        "near_clip": 1.0,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0]),
        "film": {
            "type": "hdrfilm", "width": columns, "height": rows, "pixel_format": "luminance",
            "component_format": "float32", "rfilter": {"type": "box"},
        },
        "sampler": {"type": SAMPLER},
    }  # fmt: skip
    glowing = {
        "type": "sphere", "center": [-x, y, z], "radius": ball.radius,
        "emitter": {"type": "area", "radiance": {"type": "projected"}},
    }  # fmt: skip
    integrator = {"type": "path", "max_depth": 1}  # radiance of the first hit, and no indirect illumination
    world = mi.load_dict({"type": "scene", "integrator": integrator, "sensor": lens, "ball": glowing})
    return lambda samples, seed: np.asarray(mi.render(world, spp=samples, seed=seed))[:, :, 0]
