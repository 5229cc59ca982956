"""The passes of a plan in NumPy float64: what `clsco.engine` runs on a device, by the same names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LENS_CELLS
from clsco.inputs.textures import radiance_span
from clsco.optics.lens_path import camera_at, colored, lens_at
from clsco.optics.motion import Eye, Pose, poses_at, rest_poses
from clsco.optics.quadrics import PlacedSurface, place
from clsco.optics.visibility import NO_GROUP
from clsco.plan.passes import Kind, Pass, run_passes
from clsco.plan.plan import Plan
from clsco.plan.predict import Maps
from clsco.reference.blur.accumulate import accumulate
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.blur.vignetting import vignette
from clsco.reference.common.geometry import Array, along_rays, blur_radius, pixel_ray
from clsco.reference.common.visibility import HIDDEN, PARTLY, Points, check_visibility
from clsco.reference.common.visibility_test import rim_share
from clsco.reference.inpainting.fill import FILLED, UNFILLED, FillReport, fill_objects
from clsco.reference.layered.layered import Labels, cluster, spread_depth_layers
from clsco.reference.trace.mapping import MappedTexture
from clsco.reference.trace.trace import (
    Sources,
    SubpixelSources,
    Texture,
    View,
    everything,
    mark_silhouettes,
    padded_grid,
    sharpen,
    spread_sources,
    trace,
    trace_subpixels,
    view_at,
)
from clsco.reference.warp.warp import Reprojected, extend_border, fill_entered, reproject
from clsco.scene.model import Scene


@dataclass(frozen=True, eq=False)
class Moment:
    """A pass of a frame at a time sample, s: its weights (rows,) or (1, columns), and the weighted sum (m, n, C) of
    those before."""

    plan: Plan
    textures: tuple[Texture, ...]
    maps: Maps
    time: float
    weights: Array
    frame: Array
    view: Callable[[], View]
    step: Pass


@dataclass(frozen=True, eq=False)
class Light:
    """An image with its radii, or sources; finer: at sub-pixels; cast: as rays gave them, before any was spread."""

    sources: Sources
    finer: SubpixelSources | None = None
    cast: Sources | None = None


def run(
    plan: Plan, textures: tuple[Texture, ...], maps: Maps, time: float, weights: Array, frame: Array
) -> Mapping[str, Any]:
    """Run the passes of a plan at a time sample; what they hand on, by the names of `clsco.plan.passes.Pass`."""
    moved = plan.scene.is_displaced or plan.eye_moved
    lights = {one.only: (one, tuple(_of_color(texture, one.only) for texture in textures)) for one in plan.apart}
    lights[None] = plan, textures

    @cache
    def view(color: int | None) -> View:
        one, shown = lights[color]
        aimed = color is not None and plan.scene.shifts_colors
        return view_at(plan.scene, shown, time, plan.eye, moved or aimed, one.psf, color)

    def run_pass(step: Pass, *given: Any) -> tuple[Any, ...]:
        one, shown = lights[step.color]
        at = Moment(one, shown, maps, time, weights, frame, partial(view, step.color), step)
        return RUN[step.kind](at, *given)

    return run_passes((step for step in plan.passes if step.kind not in ("sensor", "ground truth")), run_pass)


def _lit(at: Moment, light: Light) -> Light | Array:
    """Turn the light that a pass makes into what it hands on: in focus it is the plane already."""
    return _spread(at, light) if "plane" in at.step.gives else light


def _spread(at: Moment, light: Light) -> Array:
    plan = at.plan
    return scatter(plan.spec, light.sources, light.finer, (plan.rows, plan.columns), plan.guard_px)


def _trace(at: Moment) -> tuple[Light | Array]:
    """Sources of one occlusion group from rays cast at its objects: the inverse warp, and every static scene."""
    cast = trace(at.view(), at.step.group, at.plan.guard_px)
    spread = spread_sources(cast) if at.plan.scene.psf.tilt and not at.plan.psf.diffracted else cast
    return (_lit(at, Light(spread, None, cast)),)


def _silhouettes(at: Moment, light: Light) -> tuple[Light]:
    cast = light.sources if light.cast is None else light.cast
    marked = mark_silhouettes(cast.label)
    several = marked if cast.parts is None else marked | (cast.parts > 0)
    finer = trace_subpixels(at.view(), at.step.group, at.plan.guard_px, marked, cast) if several.any() else None
    return (Light(sharpen(light.sources, several), finer),)


def _pinhole(at: Moment) -> tuple[Light | Array]:
    return (_lit(at, Light(trace(at.view(), everything(at.plan.scene), at.plan.guard_px))),)


def _static_image(at: Moment) -> tuple[Light | Array, dict[str, int]]:
    """Every pixel of a depth map at its own place."""
    plan = at.plan
    warped = warped_image(plan.scene, at.textures, at.maps, plan.guard_px, at.time, plan.eye, plan.only)
    return _lit(at, Light(warped.sources)), asdict(warped.report)


def _reproject(at: Moment) -> tuple[Reprojected]:
    plan = at.plan
    return (reprojected(plan.scene, at.textures, at.maps, plan.guard_px, at.time, plan.eye, plan.only),)


def _fill(at: Moment, moved: Reprojected) -> tuple[Any, ...]:
    plan = at.plan
    warped = filled(plan.scene, at.textures, moved, plan.guard_px, at.time, plan.eye, plan.only)
    missing = (crop(warped.status, plan.guard_px) > 0,) if "missing" in at.step.gives else ()
    return _lit(at, Light(warped.sources)), asdict(warped.report), *missing


def _sources(at: Moment, image: Light) -> tuple[Light]:
    """The gradient of the radius from its differences."""
    known = image.sources
    known = replace(known, gradient=prepare_sources(known.radius, known.lit))
    return (Light(_behind_rims(at, known) if at.plan.psf.rims else known),)


def _behind_rims(at: Moment, known: Sources) -> Sources:
    """Sources of an image whose light rims cut."""
    plan, lit = at.plan, known.lit.copy()
    scene = plan.scene
    camera = colored(camera_at(scene, at.time), scene.lens, plan.only)
    rays = pixel_ray(camera, *padded_grid(scene.camera, plan.guard_px))[lit]
    here = np.zeros(len(rays))
    lens, radius = lens_at(scene, at.time, plan.only), known.radius[lit]
    own = along_rays(lens, rays)
    w = (blur_radius(lens, rays, here) - radius) / own.blur_scale  # of what depth layers hide as well
    points = Points(rays, w, radius, here, here, 1.0, np.zeros((len(rays), 2)))
    state, _, seen = check_visibility(lens, (), (), NO_GROUP, plan.psf, points)
    number = np.full(lit.size, -1)
    number[np.flatnonzero(lit)] = seen.row
    lit[lit] = state != HIDDEN
    return replace(known, lit=lit, visibility=replace(seen, row=number))


def _open_share(at: Moment) -> Array:
    """Share (m, n) of the light of the lens that rims let through to each pixel: that of its own point in focus."""
    plan = at.plan
    scene = plan.scene
    camera, lens = colored(camera_at(scene, at.time), scene.lens, plan.only), lens_at(scene, at.time, plan.only)
    rays = pixel_ray(camera, *padded_grid(scene.camera, 0)).reshape(-1, 3)
    none = np.zeros(len(rays))
    w = blur_radius(lens, rays, none) / along_rays(lens, rays).blur_scale
    points = Points(rays, w, none, none, none, 1.0, np.zeros((len(rays), 2)))
    state, _, seen = check_visibility(lens, (), (), NO_GROUP, plan.psf, points)
    at_cells = np.arange(2 * LENS_CELLS) + 0.5 - LENS_CELLS
    found, cells = np.where(state == HIDDEN, 0.0, 1.0), plan.psf.lens_cells()
    partly = state == PARTLY
    found[partly] = (
        sum(
            cells[i, j] * rim_share(seen, none[partly] + x, none[partly] + y)
            for i, y in enumerate(at_cells)
            for j, x in enumerate(at_cells)
        )
        / cells.sum()
    )
    return found.reshape(plan.rows, plan.columns)


def _cluster(at: Moment, image: Light) -> tuple[tuple[Sources, Labels, int]]:
    sources = image.sources
    return ((sources, *cluster(at.plan.spec, sources.radius, sources.lit)),)


def _depth_layers(at: Moment, layers: tuple[Sources, Labels, int]) -> tuple[Array, int]:
    plan, (image, labels, deep) = at.plan, layers
    shape = plan.rows, plan.columns
    given = plan.spec, image.radiance, image.radius, labels, shape, plan.guard_px, deep
    if not plan.psf.rims:
        return spread_depth_layers(*given)
    return spread_depth_layers(*given, (partial(_behind_rims, at), _open_share(at)))


def _blur(at: Moment, light: Light, plane: Array | float = 0.0) -> tuple[Array]:
    return (plane + _spread(at, light),)


def _of_color(texture: Texture, color: int | None) -> Texture:
    """A texture of one channel."""
    if color is None:
        return texture
    if isinstance(texture, MappedTexture):
        return replace(texture, levels=tuple(level[..., color : color + 1] for level in texture.levels))
    return texture[..., color : color + 1]


def _join_colors(_: Moment, plane: Array, colors: Array | None = None) -> tuple[Array]:
    return (plane if colors is None else np.concatenate([colors, plane], axis=-1),)


def _vignetting(at: Moment, plane: Array) -> tuple[Array]:
    scene, colors = at.plan.scene, at.plan.colors
    kind = "none" if scene.lens is None else scene.lens.vignetting
    lit = vignette(plane[..., :colors], camera_at(scene, at.time), kind)
    return (np.concatenate([lit, plane[..., colors:]], axis=-1),)


def _accumulate(at: Moment, plane: Array) -> tuple[Array]:
    return (accumulate(at.frame, plane, at.weights),)


RUN: dict[Kind, Callable[..., tuple[Any, ...]]] = {
    "static image": _static_image,
    "trace": _trace,
    "silhouettes": _silhouettes,
    "pinhole": _pinhole,
    "reproject": _reproject,
    "fill": _fill,
    "count missing": _fill,
    "sources": _sources,
    "cluster": _cluster,
    "depth layers": _depth_layers,
    "blur": _blur,
    "join colors": _join_colors,
    "vignetting": _vignetting,
    "accumulate": _accumulate,
}


@dataclass(frozen=True, eq=False)
class Warped:
    """Result of a forward warp: sources, the object of each (H, W), status of the filling (H, W), its report."""

    sources: Sources
    objects: NDArray[np.uint8]
    status: NDArray[np.uint8]
    report: FillReport


def warped_image(
    scene: Scene, textures: tuple[Texture, ...], maps: Maps, guard: int, time: float, eye: Eye,
    color: int | None = None,
) -> Warped:  # fmt: skip
    """The pixels of the reference pose at a time: the forward warp, with its holes filled, and radii for light of a
    color."""
    moved = reprojected(scene, textures, maps, guard, time, eye, color)
    return filled(scene, textures, moved, guard, time, eye, color)


def _images(textures: tuple[Texture, ...]) -> tuple[Array, ...]:
    return tuple(texture for texture in textures if not isinstance(texture, MappedTexture))  # all of them


def reprojected(
    scene: Scene, textures: tuple[Texture, ...], maps: Maps, guard: int, time: float, eye: Eye,
    color: int | None = None,
) -> Reprojected:  # fmt: skip
    """The pixels of the reference pose at their places at a time, in light of a color."""
    reference_pose = _placed(scene, rest_poses(scene))
    poses, camera = poses_at(scene, time, eye), colored(camera_at(scene, time), scene.lens, color)
    return reproject(scene, _images(textures), reference_pose, maps, poses, guard, camera)


def filled(
    scene: Scene, textures: tuple[Texture, ...], new: Reprojected, guard: int, time: float, eye: Eye,
    color: int | None = None,
) -> Warped:  # fmt: skip
    """The image of moved pixels, with what is missing filled."""
    mapped, allowed = not scene.is_analytic, None
    if scene.fill.domain == "surface" and not mapped:
        view = view_at(scene, textures, time, eye, True, None, color)
        allowed = (trace(view, everything(scene), guard).label & 127) > 0
    values = np.concatenate([new.radiance, new.inverse_depth[..., None]], axis=-1)
    far = mapped or len(scene.objects) > 1
    brightest = max(map(radiance_span, _images(textures)))
    values, objects, status, report = fill_objects(
        values, new.object, new.known, allowed, scene.fill.method, guard, far, brightest
    )
    valid = new.known | (status == 1)
    if new.entered.any() and scene.fill.method != "none":
        values, objects, valid = fill_entered(values, objects, valid, new.entered, guard)
    status = np.where(new.entered & ~new.known, np.where(valid, FILLED, UNFILLED), status)
    if mapped:
        values, valid = extend_border(values, valid, guard)
    rays = pixel_ray(colored(camera_at(scene, time), scene.lens, color), *padded_grid(scene.camera, guard))
    radius = np.where(valid, blur_radius(lens_at(scene, time, color), rays, values[..., -1]), 0.0)
    flat = np.zeros((*radius.shape, 2))  # until its differences are taken
    sources = Sources(values[..., :-1], values[..., -1], valid.astype(np.uint8), radius, flat, valid)
    return Warped(sources, objects, status, report)


def _placed(scene: Scene, poses: Sequence[Pose]) -> tuple[PlacedSurface | None, ...]:
    """The objects in their poses, None for depth maps."""
    pairs = zip(scene.objects, poses, strict=True)
    return tuple(place(item, pose) if item.is_analytic else None for item, pose in pairs)


def crop(array: NDArray[Any], guard: int) -> NDArray[Any]:
    """The frame's part of the padded grid."""
    return array[guard : array.shape[0] - guard, guard : array.shape[1] - guard]
