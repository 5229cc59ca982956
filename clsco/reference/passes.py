"""Blurred image of a view at one time, and the forward warp, in NumPy float64."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LEAST_OPENING
from clsco.inputs.textures import radiance_span
from clsco.optics.chords import chord_weights
from clsco.optics.lens_path import camera_at, colored, lens_at
from clsco.optics.motion import Eye, poses_at, rest_poses
from clsco.optics.quadrics import place
from clsco.optics.vignetting import throughput
from clsco.optics.visibility import NO_GROUP
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.common.equation import Points
from clsco.reference.common.geometry import Array, along_rays, blur_radius, pixel_ray
from clsco.reference.common.visibility import HIDDEN, PARTLY, Visibility, check_visibility
from clsco.reference.common.visibility_test import CELL_MIDDLES, cut_weights, rim_share
from clsco.reference.inpainting.fill import FILLED, UNFILLED, FillReport, fill_objects
from clsco.reference.layered.layered import cluster, spread_depth_layers
from clsco.reference.plan import Maps, ReferencePlan, band_of, silhouettes_of
from clsco.reference.trace.mapping import MappedTexture
from clsco.reference.trace.small import hidden_by_small, small_members
from clsco.reference.trace.trace import (
    Sources,
    everything,
    padded_grid,
    sharpen,
    spread_sources,
    trace,
    trace_subpixels,
    view_at,
)
from clsco.reference.trace.view import Texture, View
from clsco.reference.warp.warp import extend_border, fill_entered, reproject
from clsco.scene.model import Scene


def run(plan: ReferencePlan, textures: tuple[Texture, ...], time: float) -> Mapping[str, Any]:
    """The blurred "plane" (m, n, C) of a view at a time in s, and further outputs by name.

    Some of these exist only for warped images or depth layers: "counts" of the filling, a mask of "missing" pixels
    after a forward warp, and the number of "depth_layers".
    """
    outputs: dict[str, Any] = {}
    planes: list[Array] = []
    for color_plan in plan.color_plans:
        color_textures = tuple(_of_color(texture, color_plan.only) for texture in textures)
        args = color_plan, color_textures, time
        outputs |= {"plane": _plane_of_rays(*args)} if color_plan.by_rays else _plane_of_image(*args)
        planes.append(outputs["plane"])
    lens, lit = plan.scene.lens, np.concatenate(planes, axis=-1)
    darkened = throughput(camera_at(plan.scene, time), lens.vignetting if lens else "none")
    return outputs | {"plane": lit * darkened[..., None]}


def _view(plan: ReferencePlan, textures: tuple[Texture, ...], time: float) -> View:
    aimed = plan.only is not None and plan.scene.shifts_colors
    moved = plan.scene.is_displaced or plan.is_displaced_view or aimed
    return view_at(plan.scene, textures, time, plan.eye, moved, plan.psf, plan.only)


def _plane_of_rays(plan: ReferencePlan, textures: tuple[Texture, ...], time: float) -> Array:
    """Blurred image of traced sources; occlusion groups are blurred one after another and added."""
    view, psf = _view(plan, textures, time), plan.scene.psf
    guard, total = band_of(plan, view), np.zeros((*plan.shape, plan.channels))
    for group in plan.groups:
        cast = trace(view, group, guard)
        sources, finer = spread_sources(cast) if psf.tilt and not plan.psf.diffracted else cast, None
        if psf.silhouette_samples > 1:
            args, w = (view, group, *padded_grid(view.camera, guard)), np.where(cast.label > 0, cast.inverse_depth, 0.0)
            small = small_members(*args).any(axis=0) | hidden_by_small(*args, w)
            marked = silhouettes_of(view, group, guard, cast.label) | small
            several = marked if cast.parts is None else marked | (cast.parts > 0)
            finer = trace_subpixels(view, group, guard, marked, cast) if several.any() else None
            sources = sharpen(sources, several)
        total += scatter(plan.spec, sources, finer, plan.shape, guard)
    return total


def _plane_of_image(plan: ReferencePlan, textures: tuple[Texture, ...], time: float) -> dict[str, Any]:
    """Outputs as from `run`, where the sources are the pixels of an image: a warped one, that of a static depth map, or
    a pinhole image, which is blurred in depth layers.
    """
    guard, needed = 0, plan.claimed[1]
    outputs: dict[str, Any] = {}
    while guard < needed or not outputs:
        guard = needed
        if plan.static_map or plan.forward:
            warped = warped_image(plan.scene, textures, plan.maps, guard, time, plan.eye, plan.only)
            image, missing = warped.sources, crop(warped.status, guard) > 0
            outputs = {"counts": asdict(warped.report)} | ({} if plan.static_map else {"missing": missing})
        else:
            image, outputs = trace(_view(plan, textures, time), everything(plan.scene), guard), {"counts": {}}
        largest = float(np.abs(crop(image.radius, guard)).max())
        needed = plan.psf.reach(largest) if plan.scene.psf.border == "lose" else 0
    if plan.occlusion != "layered":
        image = replace(image, gradient=prepare_sources(image.radius, image.lit))
        image = _cut_by_rims(plan, time, guard, image) if plan.psf.rims else image
        return outputs | {"plane": scatter(plan.spec, image, None, plan.shape, guard)}
    spec = replace(plan.spec, largest=max(plan.spec.largest, float(np.abs(image.radius).max())))
    labels = cluster(spec, image.radius, image.lit)
    rims = (partial(_cut_by_rims, plan, time, guard), _open_share(plan, time)) if plan.psf.rims else None
    pixels = image.radiance, image.radius, labels, plan.shape, guard
    plane, count = spread_depth_layers(spec, *pixels, rims)
    return outputs | {"plane": plane, "depth_layers": count}


def _cut_by_rims(plan: ReferencePlan, time: float, guard: int, sources: Sources) -> Sources:
    """Copy of an image's sources in which rims cut the light of each source."""
    lit = sources.lit.copy()
    state, visibility = _check_rims(plan, time, guard, lit, sources.radius[lit], 1.0)
    number = np.full(lit.size, -1)
    number[np.flatnonzero(lit)] = visibility.row
    lit[lit] = state != HIDDEN
    return replace(sources, lit=lit, visibility=replace(visibility, row=number))


def _check_rims(
    plan: ReferencePlan, time: float, guard: int, mask: NDArray[np.bool_], radius: Array, width: float
) -> tuple[NDArray[np.uint8], Visibility]:
    """State of the lens (N,) behind the rims, and the `Visibility` for tests per tap.

    The N sources are at the pixels in `mask` (H, W), are `width` px wide, and have the signed radii `radius` (N,).
    """
    scene, lens = plan.scene, lens_at(plan.scene, time, plan.only)
    camera, zeros = colored(camera_at(scene, time), scene.lens, plan.only), np.zeros(len(radius))
    rays = pixel_ray(camera, *padded_grid(scene.camera, guard))[mask]
    w = (blur_radius(lens, rays, zeros) - radius) / along_rays(lens, rays).blur_scale  # some pixels have no depth
    points = Points(rays, w, radius, zeros, zeros, width, np.zeros((len(rays), 2)))
    state, _, visibility = check_visibility(lens, (), (), NO_GROUP, plan.psf, points)
    return state, visibility


def _open_share(plan: ReferencePlan, time: float) -> Array:
    """Fraction (m, n) of the lens's light that passes the rims to each pixel, for a point in focus at that pixel."""
    mask, zeros = np.ones(plan.shape, dtype=bool), np.zeros(np.prod(plan.shape))
    state, visibility = _check_rims(plan, time, 0, mask, zeros, 0.0)  # points, so that lens cells are used
    share, partly, cells = np.where(state == HIDDEN, 0.0, 1.0), state == PARTLY, plan.psf.lens_cells()
    if plan.psf.cut_by_chords:
        zero, ones = np.zeros(1), np.ones(1)
        size, pupil = LEAST_OPENING * ones, plan.psf.pupil
        full = chord_weights(zero, zero, size, rims=((zero, zero, ones),), borders=pupil.borders) / pupil.light
        share[partly] = cut_weights(visibility, zeros[partly] + 1.0, 0.0, 0.0, False) / full
    else:
        places, here = CELL_MIDDLES[np.indices(cells.shape)].reshape(2, -1).T, zeros[partly]
        shares = [rim_share(visibility, here + x, here + y) for y, x in places]
        share[partly] = cells.ravel() @ np.reshape(shares, (len(places), -1)) / cells.sum()
    return share.reshape(plan.shape)


def _of_color(texture: Texture, color: int | None) -> Texture:
    """A texture reduced to one channel, if a color is given."""
    chosen = slice(None) if color is None else slice(color, color + 1)
    if isinstance(texture, MappedTexture):
        return replace(texture, levels=tuple(level[..., chosen] for level in texture.levels))
    return texture[..., chosen]


@dataclass(frozen=True, eq=False)
class Warped:
    """Result of a forward warp: sources; each pixel's object (H, W); status of the filling (H, W); and its report."""

    sources: Sources
    objects: NDArray[np.uint8]
    status: NDArray[np.uint8]
    report: FillReport


def warped_image(
    scene: Scene, textures: tuple[Texture, ...], maps: Maps, guard: int, time: float, eye: Eye,
    color: int | None = None,
) -> Warped:  # fmt: skip
    """The pixels of the reference pose moved to a time, with holes filled; color: as for `view_at`."""
    images = tuple(texture for texture in textures if not isinstance(texture, MappedTexture))  # none is mapped
    pairs = zip(scene.objects, rest_poses(scene), strict=True)
    reference_pose = tuple(place(item, pose) if item.is_analytic else None for item, pose in pairs)
    poses, camera = poses_at(scene, time, eye), colored(camera_at(scene, time), scene.lens, color)
    new = reproject(scene, images, reference_pose, maps, poses, guard, camera)
    mapped, allowed = not scene.is_analytic, None
    if scene.fill.domain == "surface" and not mapped:
        view = view_at(scene, textures, time, eye, True, None, color)
        allowed = (trace(view, everything(scene), guard).label & 127) > 0
    values = np.concatenate([new.radiance, new.inverse_depth[..., None]], axis=-1)
    far = mapped or len(scene.objects) > 1
    brightest = max(map(radiance_span, images))
    values, objects, status, report = fill_objects(
        values, new.object, new.known, allowed, scene.fill.method, guard, far, brightest
    )
    valid = new.known | (status == 1)
    if new.entered.any() and scene.fill.method != "none":
        values, objects, valid = fill_entered(values, objects, valid, new.entered, guard)
    status = np.where(new.entered & ~new.known, np.where(valid, FILLED, UNFILLED), status)
    if mapped:
        values, valid = extend_border(values, valid, guard)
    rays = pixel_ray(camera, *padded_grid(scene.camera, guard))
    radius = np.where(valid, blur_radius(lens_at(scene, time, color), rays, values[..., -1]), 0.0)
    flat = np.zeros((*radius.shape, 2))  # replaced by `prepare_sources`
    sources = Sources(values[..., :-1], values[..., -1], valid.astype(np.uint8), radius, flat, valid)
    return Warped(sources, objects, status, report)


def crop(array: NDArray[Any], guard: int) -> NDArray[Any]:
    """The part of an array on the padded grid that lies in the frame."""
    return array[guard : array.shape[0] - guard, guard : array.shape[1] - guard]
