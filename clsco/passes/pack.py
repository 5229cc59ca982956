"""Packs scenes into structs that kernels read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import MAP_PROJECTED
from clsco.frame.strips import Strip
from clsco.inputs.mipmaps import level_sizes
from clsco.optics.distortion import Distortion, distortion_of
from clsco.optics.lens import Lens, ray_step
from clsco.optics.light import PlacedLight
from clsco.optics.motion import Pose, rest_center
from clsco.optics.point_spread import MINIMUM_BLUR, PointSpread
from clsco.optics.psf_grid import octaves_from, sampled_steps, table_steps
from clsco.optics.psf_tables import PsfTable
from clsco.optics.quadrics import PlacedSurface, cutting_bounds
from clsco.optics.texture_mapping import TextureMap, detail_least, texture_spread
from clsco.optics.visibility import OcclusionGroup
from clsco.records import MOST_RIMS, Real, Struct, filled, structs
from clsco.scene.model import Camera, Object

EVERYWHERE = ((-np.inf, np.inf),) * 3  # bounds of an object without bounds, in a scene in which another has bounds


def grid_struct(
    rows: int, columns: int, guard: int, real: Real, strip: Strip | None = None, step: float = 0.0,
    rest_step: float | None = None,
) -> Struct:  # fmt: skip
    """grid_t of a frame of `rows` and `columns`, or of its strip, with a guard band of `guard` px.

    step: slope between the rays of neighboring pixels, if rays are cast; rest_step: that slope in the reference pose,
    by default `step`.
    """
    part = strip or Strip(0, rows, guard, guard)
    values = {"rows": part.rows, "columns": columns, "frame_rows": rows, "top": part.top, "guard": guard, "step": step}
    values |= {"above": part.above, "width": columns + 2 * guard, "height": part.height}
    values["rest_step"] = step if rest_step is None else rest_step
    return filled("grid_t", real, values)


def camera_grid(
    camera: Camera, guard: int, real: Real, strip: Strip | None = None, reference: Camera | None = None
) -> Struct:
    """grid_t of a camera with a resolution; reference: camera of the reference pose, by default `camera`."""
    columns, rows = camera.resolution or (0, 0)  # known once the textures are loaded
    grid = grid_struct(rows, columns, guard, real, strip, ray_step(camera), ray_step(reference or camera))
    if (distortion := distortion_of(camera)) is not None:
        grid["radial"], grid["tangential"], grid["reach"] = distortion.radial, distortion.tangential, distortion.reach
        _set_start(grid, distortion)
    return grid


def towards(grid: Struct, camera: Camera) -> Struct:
    """A copy of a grid_t with the rays of another camera, which has another focal length or magnification."""
    grid = grid.copy()
    grid["step"] = ray_step(camera)
    if (distortion := distortion_of(camera)) is not None:
        _set_start(grid, distortion)
    return grid


def _set_start(grid: Struct, distortion: Distortion) -> None:
    """Set the first guess and the number of steps of Newton's method, which undistorts rays. They suffice for all rays
    of frame and guard band, also for those of the reference pose.
    """
    corner = float(np.hypot(0.5 * grid["columns"], 0.5 * grid["frame_rows"]) + np.sqrt(2.0) * grid["guard"])
    grid["start"], grid["newton"] = _start_of(distortion, corner * float(max(grid["step"], grid["rest_step"])))


@lru_cache(maxsize=64)
def _start_of(distortion: Distortion, radius: float) -> tuple[NDArray[np.float64], int]:
    return distortion.start(radius), distortion.steps_to(radius)


def lens_struct(lens: Lens, real: Real) -> Struct:
    """lens_t of a lens."""
    names = structs(real)["lens_t"].names or ()
    return filled("lens_t", real, {name: getattr(lens, name) for name in names})


def surface_structs(
    items: Sequence[Object], surfaces: Sequence[PlacedSurface | None], real: Real, textures: Sequence[int] | None = None
) -> NDArray[np.void]:
    """surface_t of each object, (objects,), as placed in front of the camera; a depth map has no surface.

    Its surface_t holds only the center of rotation and the texture. textures: number of each object's texture, by
    default 0.
    """
    numbers, array = textures or [0] * len(items), np.zeros(len(items), structs(real)["surface_t"])
    for k, fields in enumerate(zip(items, surfaces, numbers, strict=True)):
        array[k] = _surface_struct(*fields, real)
    return array


def _surface_struct(item: Object, surface: PlacedSurface | None, texture: int, real: Real) -> Struct:
    if surface is None:
        return filled("surface_t", real, {"rest": rest_center(item), "texture": texture})
    shape, extent = surface.canonical, surface.extent
    low, high = np.array(cutting_bounds(item) or EVERYWHERE, dtype=np.float64).T
    names = ("turn", "body_turn", "own_turn", "offset", "body_offset", "own_offset", "rest")
    values: dict[str, Any] = {name: getattr(surface, name).ravel() for name in names}
    values |= {name: getattr(shape, name) for name in ("q", "l", "k", "radius", "nappe")}
    values |= {"bounds_low": low, "bounds_high": high, "at_lens": surface.constant, "texture": texture}
    values |= {"near_x": extent.x, "near_y": extent.y, "near_w": extent.w[1], "width": surface.width}
    return filled("surface_t", real, values)


def texture_map_structs(
    maps: Sequence[TextureMap | None], bases: Sequence[int], psf: PointSpread, covered: float, real: Real
) -> NDArray[np.void]:
    """texture_map_t of each object, (objects,).

    maps: mapping of each texture, None for a projected texture; bases: index of the first float of each mipmap;
    covered: value of the last channel outside of a texture's image, 1 if that channel is coverage, else 0.
    """
    packed = []
    for texture, base in zip(maps, bases, strict=True):
        values: dict[str, Any] = {"kind": MAP_PROJECTED}
        if texture is not None:
            values = vars(texture) | {"frame": texture.frame.ravel(), "scale": texture.scale.ravel()}
            levels = len(level_sizes(texture.columns, texture.rows))
            values |= {"base": base, "levels": levels, "spread": texture_spread(psf), "outside": covered}
            values["least"] = detail_least(psf)
        packed.append(filled("texture_map_t", real, values))
    return np.array(packed, structs(real)["texture_map_t"])


def pose_structs(poses: Sequence[Pose], real: Real, step: float = 0.0) -> NDArray[np.void]:
    """pose_t of each pose, (poses,); step: slope between neighboring rays at that time, if kernels project points."""
    placed = [filled("pose_t", real, {"rotation": p.rotation.ravel(), "shift": p.shift, "step": step}) for p in poses]
    return np.array(placed, structs(real)["pose_t"])


def light_struct(light: PlacedLight, real: Real) -> Struct:
    """light_t of a light."""
    place = dict(zip("xyz", light.place, strict=True))
    return filled("light_t", real, {name: value for name, value in vars(light).items() if name != "place"} | place)


def group_struct(group: OcclusionGroup, objects: int) -> Struct:
    """group_t of an occlusion group in a scene with `objects` objects."""
    return filled("group_t", "double", vars(group) | {"count": objects})


def psf_struct(psf: PointSpread, table: PsfTable, subpixel: PsfTable | None, real: Real) -> Struct:
    """psf_t of a PSF. table: its table for pixels; subpixel: its table for sub-pixel sources, None without these."""
    names = ("first", "count", "low", "end", "stride")
    values: dict[str, Any] = {name: getattr(table, name) for name in names}
    values |= {"reach": max(table.reach, subpixel.reach if subpixel else 0), "key": psf.key, "lens_extent": psf.extent}
    values |= {"minimum_blur": MINIMUM_BLUR, "octaves_from": octaves_from(psf)}
    values |= {"steps": table_steps(psf, False), "sub_steps": table_steps(psf, True)}
    values["fine_steps"], values["fine_until"] = sampled_steps(psf)
    none = [0.0] * (MOST_RIMS - len(psf.rims))
    values |= {"rim_distance": [*(rim.distance for rim in psf.rims), *none]}
    values |= {"rim_radius": [*(rim.radius for rim in psf.rims), *none]}
    if psf.varying is not None:
        (across, down), (columns, rows) = psf.varying.cells, psf.varying.frame
        values |= {"across": across, "down": down}
        values |= {"per_column": across / max(columns - 1, 1), "per_row": down / max(rows - 1, 1)}
    if subpixel:
        values |= {f"sub_{name}": getattr(subpixel, name) for name in names}
    return filled("psf_t", real, values)


def texture_planes(radiances: Sequence[NDArray[np.float32]], channels: int) -> NDArray[np.float32]:
    """Channel planes (textures, channels, rows, columns). Gray textures are repeated in all channels. A single gray
    texture for one channel is not copied.
    """
    planes = [radiance[None] if radiance.ndim == 2 else np.moveaxis(radiance, -1, 0) for radiance in radiances]
    if len(planes) == channels == 1:
        return planes[0][None]
    stack = np.empty((len(planes), channels, *planes[0].shape[1:]), np.float32)
    for texture, plane in zip(stack, planes, strict=True):
        texture[...] = plane
    return stack
