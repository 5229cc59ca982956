"""Rays cast at the surface: sources, sub-pixel sources at silhouettes, ground truth.

The padded grid has `guard` rows and columns on each side of the frame: surface outside the frame contributes to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.motion import Eye, Pose, middle_time, poses_at, rest_poses
from clsco.optics.psf import subpixel_offsets
from clsco.optics.quadrics import PlacedSurface, place
from clsco.optics.visibility import Layer
from clsco.plan.predict import displaced
from clsco.reference.common.geometry import (
    Array,
    blur_gradient,
    blur_radius,
    body_point,
    mirror_index,
    nearest_surface,
    pixel_ray,
    project,
    rest_pixel,
    rest_position,
    sample_texture,
    solve_quadric,
    surface_normal,
    surface_slope,
    turned,
)
from clsco.reference.common.visibility import HIDDEN, Points, Visibility, check_visibility
from clsco.scene.model import Camera, Scene

SILHOUETTE_RANGE = 2  # px, Chebyshev distance from a silhouette within which pixels get sub-pixel sources


@dataclass(frozen=True, eq=False)
class Sources:
    """Sources, one per pixel of the padded grid (H, W).

    radiance (H, W, C) linear; inverse_depth (H, W) 1/mm; label (H, W): 0 no source, else which root of
    which object, and where two surfaces meet; radius (H, W) signed blur radius in px; gradient (H, W, 2) of the
    radius, px per px, right and down; lit (H, W): some of its radiance reaches the lens; visibility:
    its occluders, None for none at all.
    """

    radiance: Array
    inverse_depth: Array
    label: NDArray[np.uint8]
    radius: Array
    gradient: Array
    lit: NDArray[np.bool_]
    visibility: Visibility | None = None


@dataclass(frozen=True, eq=False)
class SubpixelSources:
    """S x S sources in each of M pixels, which replace the pixel's own; each has the weight 1/S^2.

    row, column (M,): padded-grid pixel; hit (M, S, S): there is surface that is visible from the lens; visibility: the
    occluders of those, in their order, None for none at all; radius (M, S, S) px; gradient (M, S, S, 2) px per px;
    radiance (M, S, S, C). Source (i, j) is `psf_tables.subpixel_offsets(S)[i]` rows and [j]
    columns off the pixel's center.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    hit: NDArray[np.bool_]
    radius: Array
    gradient: Array
    radiance: Array
    visibility: Visibility | None = None


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth at the middle of the shutter: see `clsco.frame.frame.Frame`, whose names and units these are."""

    sharp: Array
    depth: Array
    blur_radius: Array
    mask: NDArray[np.bool_]
    object_id: NDArray[np.int32]
    normal: Array
    flow: Array
    hidden: NDArray[np.bool_]
    disparity: Array | None
    occluded: NDArray[np.bool_] | None


def padded_grid(camera: Camera, guard: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (H, 1) and columns (1, W) of the padded grid in frame pixels: -guard .. n-1+guard."""
    assert camera.resolution is not None
    columns, rows = camera.resolution
    return np.arange(-guard, rows + guard)[:, None], np.arange(-guard, columns + guard)[None, :]


@dataclass(frozen=True, eq=False)
class View:
    """All objects at one time, in the frame of the camera.

    surfaces: one per object; textures: (rows, columns, channels) of the frame's size, one per object; moved: an
    object or the camera is not exactly in its reference pose.
    """

    scene: Scene
    surfaces: tuple[PlacedSurface, ...]
    textures: tuple[Array, ...]
    moved: bool


def view_at(scene: Scene, textures: tuple[Array, ...], time: float, eye: Eye, moved: bool) -> View:
    """The objects after `time` seconds; other arguments as for `View`."""
    placed = zip(scene.objects, poses_at(scene, time, eye), strict=True)
    return View(scene, tuple(place(item, pose) for item, pose in placed), textures, moved)


def everything(scene: Scene) -> Layer:
    """All objects in one occlusion group without occluders: the pinhole image."""
    return Layer((1 << len(scene.objects)) - 1, 0)


@dataclass(frozen=True, eq=False)
class _Cast:
    """What rays (...) meet: inverse depth in 1/mm, label, object, blur radius in px, its gradient, radiance."""

    w: Array
    label: NDArray[np.uint8]
    number: NDArray[np.int32]
    radius: Array
    gradient: Array
    radiance: Array


def _cast(
    view: View, layer: Layer, row: NDArray[Any], column: NDArray[Any], texel: tuple[NDArray[Any], NDArray[Any]]
) -> _Cast:
    """The nearest of some objects along rays through (row, column) px, 0 where none is.

    texel: row and column of the pixel whose texel a ray shows in the reference pose.
    """
    scene, rays = view.scene, pixel_ray(view.scene.camera, row, column)
    w, label, number = nearest_surface(view.surfaces, [item.bounds for item in scene.objects], layer, rays)
    gradient, radiance = np.zeros((*w.shape, 2)), np.zeros((*w.shape, view.textures[0].shape[2]))
    for k, surface in enumerate(view.surfaces):
        if not layer.members >> k & 1:
            continue
        own = (number == k)[..., None]
        gradient = np.where(own, blur_gradient(scene.camera, surface_slope(surface, rays, w)), gradient)
        texels = (np.asarray(n, dtype=np.int64) for n in texel)
        if view.moved:
            shown = _moved_radiance(scene, surface, view.textures[k], rays, w)
        else:
            shown = np.broadcast_to(_texels(view.textures[k], *texels), radiance.shape)
        radiance = np.where(own, shown, radiance)
    radius = np.where(label > 0, blur_radius(scene.camera, w), 0.0)
    return _Cast(w, label, number, radius, gradient, radiance)


def _moved_radiance(scene: Scene, surface: PlacedSurface, texture: Array, rays: Array, w: Array) -> Array:
    """Texture at the projections of the surface points in the reference pose; 0 where they were behind the lens."""
    row, column, valid = rest_pixel(surface, scene.camera, rays, w)
    radiance = sample_texture(texture, row, column, scene.motion.texture_filter)
    return np.where(valid[..., None], radiance, 0.0)


def _texels(texture: Array, row: NDArray[np.int64], column: NDArray[np.int64]) -> Array:
    """The texture's own texels at frame pixels, mirrored outside of the frame."""
    return np.asarray(texture[mirror_index(row, texture.shape[0]), mirror_index(column, texture.shape[1])])


def trace(view: View, layer: Layer, guard: int) -> Sources:
    """Sources on the padded grid, from one ray through each pixel's center to the objects of an occlusion group.

    guard: px. In the reference pose the radiance is the texel itself, else the texture is sampled at the projection of
    the point in the reference pose. Validated against the thesis' depth formulas and the texture itself.
    """
    scene = view.scene
    row, column = padded_grid(scene.camera, guard)
    hit = _cast(view, layer, row, column, (row, column))
    label, lit, visibility = hit.label, hit.label > 0, None
    if layer.occluders:
        rays = pixel_ray(scene.camera, row, column)[lit]
        here = np.zeros(len(rays))
        bounds = [item.bounds for item in scene.objects]
        state, edge, seen = check_visibility(
            scene.camera,
            view.surfaces,
            bounds,
            layer,
            scene.psf,
            Points(rays, hit.w[lit], hit.radius[lit], here, here, 1.0),
        )
        label = label.copy()
        label[lit] |= edge.astype(np.uint8) << 7
        number = np.full(lit.size, -1)
        number[np.flatnonzero(lit)] = seen.row
        visibility = replace(seen, row=number)
        lit[lit] = state != HIDDEN
    return Sources(hit.radiance, hit.w, label, hit.radius, hit.gradient, lit, visibility)


def mark_silhouettes(label: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (H, W) with a different label anywhere within 2 px, rows and columns counted separately.

    label: (H, W) from `trace`. There the blur radius is steep or discontinuous.
    """
    padded = np.pad(label, SILHOUETTE_RANGE, mode="edge")
    size = 2 * SILHOUETTE_RANGE + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    return np.asarray((windows != label[..., None, None]).any(axis=(-1, -2)))


def trace_subpixels(view: View, layer: Layer, guard: int, marked: NDArray[np.bool_]) -> SubpixelSources:
    """Sub-pixel sources of the marked pixels (H, W) of the padded grid; other arguments as for `trace`.

    Their number per axis is psf.silhouette_samples. In the reference pose they share their pixel's own texel, else each
    samples the texture at its own position.
    """
    scene = view.scene
    samples = scene.psf.silhouette_samples
    row, column = np.nonzero(marked)
    offsets = subpixel_offsets(samples)
    at_row = (row - guard)[:, None, None] + offsets[:, None]
    at_column = (column - guard)[:, None, None] + offsets[None, :]
    texel = ((row - guard)[:, None, None], (column - guard)[:, None, None])
    hit = _cast(view, layer, at_row, at_column, texel)
    lit, visibility = hit.label > 0, None
    if layer.occluders:
        rays = pixel_ray(scene.camera, at_row, at_column)[lit]
        x, y = (np.broadcast_to(n, lit.shape)[lit] for n in (offsets[None, :], offsets[:, None]))
        bounds = [item.bounds for item in scene.objects]
        state, _, visibility = check_visibility(
            scene.camera, view.surfaces, bounds, layer, scene.psf,
            Points(rays, hit.w[lit], hit.radius[lit], x, y, 1.0 / samples),
        )  # fmt: skip
        seen = state != HIDDEN
        lit[lit] = seen
        visibility = visibility.of(seen)
    return SubpixelSources(row, column, lit, hit.radius, hit.gradient, hit.radiance, visibility)


def _outside(camera: Camera, row: Array, column: Array) -> NDArray[np.bool_]:
    assert camera.resolution is not None
    columns, rows = camera.resolution
    return np.asarray((row < -0.5) | (row >= rows - 0.5) | (column < -0.5) | (column >= columns - 0.5))


def _hidden(view: View, rest: PlacedSurface, number: int, rays: Array, w: Array) -> NDArray[np.bool_]:
    """Points of an object's surface that were not visible in its reference pose."""
    scene, surface = view.scene, view.surfaces[number]
    row, column, valid = rest_pixel(surface, scene.camera, rays, w)
    w_rest, _ = solve_quadric(rest, scene.objects[number].bounds, pixel_ray(scene.camera, row, column))
    depth_ratio = np.where(valid, rest_position(surface, rays, w)[..., 2], 1.0)
    covered = w_rest * depth_ratio > w * (1.0 + 1e-6)
    return np.asarray((w > 0.0) & (~valid | _outside(scene.camera, row, column) | covered))


def _moved_pixel(
    surface: PlacedSurface, other: Pose, camera: Camera, rays: Array, w: Array
) -> tuple[Array, Array, Array]:
    """Row and column in px of hits in the pose `other`, and their depth there over that here (1 behind the lens)."""
    body = turned(other.rotation, body_point(surface, rays, w))
    position = (surface.rest + other.shift) * w[..., None] + body
    before_lens = (w > 0.0) & (position[..., 2] > 0.0)
    row, column = project(camera, np.where(before_lens[..., None], position, 1.0))
    at_row, at_column = padded_grid(camera, 0)
    return (
        np.where(before_lens, row, at_row),
        np.where(before_lens, column, at_column),
        np.where(before_lens, position[..., 2], 1.0),
    )


def _stereo(
    scene: Scene, textures: tuple[Array, ...], view: View, eye: Eye, time: float, hit: _Cast, rays: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Disparity in px, and which points are not visible in the other view."""
    opposite: Eye = "left" if eye == "right" else "right"
    other, poses = view_at(scene, textures, time, opposite, True), poses_at(scene, time, opposite)
    disparity, occluded = np.zeros(hit.w.shape), np.zeros(hit.w.shape, dtype=bool)
    bounds = [item.bounds for item in scene.objects]
    _, at_column = padded_grid(scene.camera, 0)
    for k, surface in enumerate(view.surfaces):
        row, column, ratio = _moved_pixel(surface, poses[k], scene.camera, rays, hit.w)
        own = hit.number == k
        disparity = np.where(own, (1.0 if eye == "right" else -1.0) * (column - at_column), disparity)
        seen, _, _ = nearest_surface(other.surfaces, bounds, everything(scene), pixel_ray(scene.camera, row, column))
        covered = seen * ratio > hit.w * (1.0 + 1e-6)
        occluded = np.where(own, covered | _outside(scene.camera, row, column), occluded)
    return disparity, occluded


def ground_truth(scene: Scene, textures: tuple[Array, ...], frame: int, eye: Eye = "left") -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame at the middle of its shutter, at pixel centers.

    textures: as for `View`. `flow` goes from a pixel to where its surface point is at the middle of the next
    frame's shutter; 0 where that is behind the lens. `hidden`: in the reference pose the point is outside of the frame,
    or another point of its object hides it there (nearer by more than 1e-6 of its depth). Validated: flow against
    the thesis' 80 and 70 px, normals and radius against closed forms.
    """
    moves, camera = scene.moves, scene.camera
    now, then = (middle_time(scene.sequence, k) if moves else 0.0 for k in (frame, frame + 1))
    view = view_at(scene, textures, now, eye, moves or displaced(scene, eye))
    rest = [place(item, pose) for item, pose in zip(scene.objects, rest_poses(scene), strict=True)]
    later = poses_at(scene, then, eye)
    row, column = padded_grid(camera, 0)
    rays = pixel_ray(camera, row, column)
    hit = _cast(view, everything(scene), row, column, (row, column))
    mask, w = hit.label > 0, hit.w
    flow, normal = np.zeros((*w.shape, 2)), np.zeros((*w.shape, 3))
    hidden = np.zeros(w.shape, dtype=bool)
    for k, surface in enumerate(view.surfaces):
        own = hit.number == k
        next_row, next_column, _ = _moved_pixel(surface, later[k], camera, rays, w)
        flow = np.where(own[..., None], np.stack([next_column - column, next_row - row], axis=-1), flow)
        normal = np.where(own[..., None], surface_normal(surface, rays, w), normal)
        hidden = np.where(own, _hidden(view, rest[k], k, rays, w), hidden)
    disparity, occluded = None, None
    if scene.stereo is not None:
        disparity, occluded = _stereo(scene, textures, view, eye, now, hit, rays)
    return Truth(
        sharp=hit.radiance,
        depth=np.where(mask, 1.0 / np.where(mask, w, 1.0), np.inf),
        blur_radius=hit.radius,
        mask=mask,
        object_id=hit.number,
        normal=normal,
        flow=flow,
        hidden=hidden,
        disparity=disparity,
        occluded=occluded,
    )
