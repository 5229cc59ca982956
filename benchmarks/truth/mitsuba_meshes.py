"""Meshes in Mitsuba 3: what glows by its image, through a thin lens, as `benchmarks.truth.mitsuba` sets it up.

Nothing moves there. Axis x runs to the left.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.truth.meshes import Mesh
from benchmarks.truth.mitsuba import SAMPLER, field_of_view, in_focus

Array = NDArray[Any]
MIRRORED = np.array([-1.0, 1.0, 1.0])


def render(camera: Any, meshes: Sequence[Mesh], samples: int, seed: int, variant: str) -> tuple[Array, float]:
    """A picture (rows, columns, 3) of linear radiance by so many rays per pixel, best a square number, and its
    processor time in s; the first call of a process compiles."""
    import mitsuba as mi

    mi.set_variant(variant)
    columns, rows = camera.resolution
    lens = {
        "type": "thinlens", "aperture_radius": camera.aperture_diameter / 2, "focus_distance": in_focus(camera),
        "fov": field_of_view(camera, columns), "fov_axis": "x", "near_clip": 1.0, "far_clip": 1e9,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0]),
        "film": {
            "type": "hdrfilm", "width": columns, "height": rows, "pixel_format": "rgb",
            "component_format": "float32", "rfilter": {"type": "box"},
        },
        "sampler": {"type": SAMPLER},
    }  # fmt: skip
    content = {"type": "scene", "integrator": {"type": "path", "max_depth": 1}, "sensor": lens}
    content |= {f"mesh{number}": _mesh(mi, mesh) for number, mesh in enumerate(meshes)}
    world = mi.load_dict(content)
    began = time.process_time()
    picture = np.asarray(mi.render(world, spp=samples, seed=seed), np.float64)
    return picture, time.process_time() - began


def _mesh(mi: Any, mesh: Mesh) -> Any:
    wrap, texels = mesh.wrap, "nearest" if mesh.nearest else "bilinear"
    bitmap = {
        "type": "bitmap", "data": mi.TensorXf(mesh.image), "raw": True, "filter_type": texels, "wrap_mode": wrap,
    }  # fmt: skip
    properties = mi.Properties()
    properties["emitter"] = mi.load_dict({"type": "area", "radiance": bitmap})
    points = (mesh.vertices @ mesh.poses[0, :3, :3].T + mesh.poses[0, :3, 3]) * MIRRORED
    made = mi.Mesh("mesh", len(points), len(mesh.faces), has_vertex_texcoords=True, props=properties)
    values = mi.traverse(made)
    values["vertex_positions"] = points.ravel().astype(np.float32)
    values["vertex_texcoords"] = (
        np.stack([mesh.places[:, 0], 1.0 - mesh.places[:, 1]], axis=1).ravel().astype(np.float32)
    )
    values["faces"] = mesh.faces.ravel().astype(np.uint32)
    values.update()
    return made
