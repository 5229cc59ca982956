"""Ground truth of a frame: surfaces at pixel centers, seen through a pinhole at the middle of the exposure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.exposure import middle_time
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, Pose, poses_at, rest_poses
from clsco.optics.quadrics import PlacedSurface, cutting_bounds, place
from clsco.plan.predict import shifts_view
from clsco.reference.common.geometry import (
    Array,
    blur_radius,
    body_point,
    nearest_surface,
    pixel_ray,
    project,
    rest_pixel,
    rest_position,
    solve_quadric,
    surface_normal,
    turned,
)
from clsco.reference.trace.mapping import MappedTexture, texture_coordinates
from clsco.reference.trace.trace import cast, everything, padded_grid, view_at
from clsco.reference.trace.view import Cast, Texture, View
from clsco.scene.model import Camera, Scene


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth at the middle of the shutter, with the names and units of `clsco.frame.frame.Frame`."""

    sharp: Array
    depth: Array
    blur_radius: Array
    mask: NDArray[np.bool_]
    object_id: NDArray[np.int32]
    normal: Array
    flow: Array
    hidden: NDArray[np.bool_]
    flow_backward: Array
    flow_occluded: NDArray[np.bool_]
    uv: Array
    disparity: Array | None
    occluded: NDArray[np.bool_] | None
    row_time: Array | None = None


def outside_frame(camera: Camera, row: Array, column: Array) -> NDArray[np.bool_]:
    assert camera.resolution is not None
    columns, rows = camera.resolution
    return np.asarray((row < -0.5) | (row >= rows - 0.5) | (column < -0.5) | (column >= columns - 0.5))


def _hidden(view: View, rest: PlacedSurface, number: int, rays: Array, w: Array) -> NDArray[np.bool_]:
    """Mask of points of an object's surface that were not visible in its reference pose."""
    scene, surface = view.scene, view.surfaces[number]
    row, column, valid = rest_pixel(surface, view.reference, rays, w)
    w_rest, _ = solve_quadric(rest, cutting_bounds(scene.objects[number]), pixel_ray(view.reference, row, column))
    depth_ratio = np.where(valid, rest_position(surface, rays, w)[..., 2], 1.0)
    covered = w_rest * depth_ratio > w * (1.0 + 1e-6)
    return np.asarray((w > 0.0) & (~valid | outside_frame(scene.camera, row, column) | covered))


def moved_pixel(
    surface: PlacedSurface, camera: Camera, pose: Pose, rays: Array, w: Array
) -> tuple[Array, Array, Array]:
    """Row and column in px of hits moved to a pose relative to a camera, and the ratio of their depths there
    and here (0 behind the lens).
    """
    body = turned(pose.rotation, body_point(surface, rays, w))
    position = (surface.rest + pose.shift) * w[..., None] + body
    before_lens = (w > 0.0) & (position[..., 2] > 0.0)
    row, column = project(camera, np.where(before_lens[..., None], position, 1.0))
    at_row, at_column = padded_grid(camera, 0)
    return (
        np.where(before_lens, row, at_row),
        np.where(before_lens, column, at_column),
        np.where(before_lens, position[..., 2], 0.0),
    )


def occluded_among(
    scene: Scene, camera: Camera, surfaces: tuple[PlacedSurface, ...], pixel: tuple[Array, Array, Array], w: Array
) -> NDArray[np.bool_]:
    """Mask of points at inverse depth w that are hidden or out of view in the pixels given by `moved_pixel`."""
    row, column, ratio = pixel
    bounds = [cutting_bounds(item) for item in scene.objects]
    nearest, _, _ = nearest_surface(surfaces, bounds, everything(scene), pixel_ray(camera, row, column))
    covered = nearest * ratio > w * (1.0 + 1e-6)
    return np.asarray(covered | (ratio <= 0.0) | outside_frame(scene.camera, row, column))


def _texture_coordinates(view: View, number: int, rays: Array, w: Array) -> Array:
    """Texture coordinates (right, up) of hits (rows, columns) on an object, as from `texture_coordinates`."""
    surface, texture, camera = view.surfaces[number], view.textures[number], view.scene.camera
    coordinates, hit = np.zeros((*w.shape, 2)), w > 0.0
    if isinstance(texture, MappedTexture):
        coordinates[hit] = texture_coordinates(surface, texture, camera, rays[hit], w[hit])
        return coordinates
    row, column, valid = rest_pixel(surface, view.reference, rays, w)
    if not view.moved:
        row, column = (np.broadcast_to(n, w.shape).astype(np.float64) for n in padded_grid(camera, 0))
    rows, columns = texture.shape[:2]
    at = np.stack([(column + 0.5) / columns, 1.0 - (row + 0.5) / rows], axis=-1)
    return np.where((valid & hit)[..., None], at, 0.0)


def _stereo(
    scene: Scene, textures: tuple[Texture, ...], view: View, eye: Eye, time: float, hit: Cast, rays: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Disparity in px, and a mask of points that are not visible in the other view."""
    opposite: Eye = "left" if eye == "right" else "right"
    other_view, poses = view_at(scene, textures, time, opposite, True), poses_at(scene, time, opposite)
    disparity, occluded = np.zeros(hit.w.shape), np.zeros(hit.w.shape, dtype=bool)
    _, at_column = padded_grid(scene.camera, 0)
    for k, surface in enumerate(view.surfaces):
        pixel = moved_pixel(surface, other_view.scene.camera, poses[k], rays, hit.w)
        on_object = hit.number == k
        disparity = np.where(on_object, (1.0 if eye == "right" else -1.0) * (pixel[1] - at_column), disparity)
        hidden = occluded_among(scene, other_view.scene.camera, other_view.surfaces, pixel, hit.w)
        occluded = np.where(on_object, hidden, occluded)
    return disparity, occluded


@dataclass(frozen=True, eq=False)
class SurfaceTruth:
    """Surfaces at pixels (m, n): ray hits, and the ground truth of one time, by name."""

    hit: Cast
    rays: Array
    arrays: dict[str, Any]


def surface_truth(
    view: View, rest: list[PlacedSurface], row: NDArray[np.int64], column: NDArray[np.int64]
) -> SurfaceTruth:
    """Ground truth of a view at pixels: rows (m, 1) and columns (1, n)."""
    scene, camera = view.scene, view.scene.camera
    rays = pixel_ray(camera, row, column)
    hit = cast(view, everything(scene), row, column, (row, column))
    w = hit.w
    normal, uv, hidden = np.zeros((*w.shape, 3)), np.zeros((*w.shape, 2)), np.zeros(w.shape, dtype=bool)
    for k, surface in enumerate(view.surfaces):
        on_object = hit.number == k
        normal = np.where(on_object[..., None], surface_normal(surface, rays, w), normal)
        if scene.objects[k].mapped is None:
            hidden = np.where(on_object, _hidden(view, rest[k], k, rays, w), hidden)
        uv = np.where(on_object[..., None], _texture_coordinates(view, k, rays, np.where(on_object, w, 0.0)), uv)
    mask = hit.label > 0
    for k in (k for k, item in enumerate(scene.objects) if item.is_background):  # no surface, but radiance and blur
        mask = mask & (hit.number != k)
    radii = [np.where(hit.label > 0, blur_radius(lens, rays, w), 0.0) for lens in view.lenses]
    arrays = {
        "sharp": hit.radiance,
        "depth": np.where(mask, 1.0 / np.where(mask, w, 1.0), np.inf),
        "blur_radius": radii[0] if len(radii) == 1 else np.stack(radii, axis=-1),
        "mask": mask,
        "object_id": np.where(mask, hit.number, -1).astype(hit.number.dtype),
        "normal": np.where(mask[..., None], normal, 0.0),
        "hidden": hidden & mask,
        "uv": np.where(mask[..., None], uv, 0.0),
    }
    return SurfaceTruth(hit, rays, arrays)


def ground_truth(scene: Scene, textures: tuple[Texture, ...], frame: int, eye: Eye = "left") -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame at the middle of its shutter, at pixel centers.

    textures: as for `View`. `flow` goes from a pixel to the position of its surface point at the middle of the next
    frame's shutter; 0 if that is behind the lens. `hidden`: in the reference pose the point is outside of the frame, or
    another point of its object hides it there (nearer by more than 1e-6 of its depth); always False for a texture on a
    surface. Validated: flow against the thesis' 80 and 70 px, normals and radius against closed forms.
    """
    rest = [place(item, pose) for item, pose in zip(scene.objects, rest_poses(scene), strict=True)]
    moves, camera = scene.moves, scene.camera
    before, now, then = (middle_time(scene.sequence, k) if moves else 0.0 for k in (frame - 1, frame, frame + 1))
    view = view_at(scene, textures, now, eye, scene.is_displaced or shifts_view(scene, eye))
    earlier, later = ((camera_at(scene, time), poses_at(scene, time, eye)) for time in (before, then))
    following = tuple(place(item, pose) for item, pose in zip(scene.objects, later[1], strict=True))
    row, column = padded_grid(camera, 0)
    surfaces = surface_truth(view, rest, row, column)
    hit, rays, w, mask = surfaces.hit, surfaces.rays, surfaces.hit.w, surfaces.arrays["mask"]
    flow, backward, flow_occluded = np.zeros((*w.shape, 2)), np.zeros((*w.shape, 2)), np.zeros(w.shape, dtype=bool)
    for k, surface in enumerate(view.surfaces):
        on_object = hit.number == k
        pixel, last = (moved_pixel(surface, camera_, poses[k], rays, w) for camera_, poses in (later, earlier))
        flow = np.where(on_object[..., None], np.stack([pixel[1] - column, pixel[0] - row], axis=-1), flow)
        backward = np.where(on_object[..., None], np.stack([last[1] - column, last[0] - row], axis=-1), backward)
        flow_occluded = np.where(on_object, occluded_among(scene, later[0], following, pixel, w), flow_occluded)
    disparity, occluded = None, None
    if scene.stereo is not None:
        disparity, occluded = _stereo(scene, textures, view, eye, now, hit, rays)
    return Truth(
        **surfaces.arrays,
        flow=np.where(mask[..., None], flow, 0.0),
        flow_backward=np.where(mask[..., None], backward, 0.0),
        flow_occluded=flow_occluded & mask,
        disparity=None if disparity is None else np.where(mask, disparity, 0.0),
        occluded=None if occluded is None else occluded & mask,
    )
