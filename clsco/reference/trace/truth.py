"""Ground truth of a frame: surfaces at pixel centers, seen through a pinhole at the middle of the exposure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.exposure import middle_time
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, Pose, poses_at, rest_center, rest_poses
from clsco.optics.quadrics import PlacedSurface, cutting_bounds, place
from clsco.optics.resolved_view import shifts_view
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
from clsco.reference.trace.trace import everything, padded_grid, view_at
from clsco.reference.trace.view import Texture, View, cast
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


Follow = Callable[[int, Eye], tuple[Array, NDArray[np.bool_]]]
"""Function of a frame and an eye: returns the shift (m, n, 2) in px, right and down, of points to their positions in
that view, and a mask of points that are hidden in it."""


@dataclass(frozen=True, eq=False)
class Points:
    """Surface points in pixels (m, n): object number, -1 for none; inverse depth, 0 for none; and `body_point`."""

    scene: Scene
    number: NDArray[np.int32]
    w: Array
    body: Array

    def places(self, camera: Camera, poses: tuple[Pose, ...]) -> Array:
        """Row, column and ratio of the depths of all points in other poses, relative to a camera: (3, m, n).

        The ratio is the new depth divided by the present one. All three are 0 for points behind the lens.
        """
        places = np.zeros((3, *self.w.shape))
        for k, (item, pose) in enumerate(zip(self.scene.objects, poses, strict=True)):
            position = (rest_center(item) + pose.shift) * self.w[..., None] + turned(pose.rotation, self.body)
            before = (position[..., 2] > 0.0) & (self.number == k)
            row, column = project(camera, np.where(before[..., None], position, 1.0))
            places = np.where(before, np.stack([row, column, position[..., 2]]), places)
        return places

    def at_middle(self, frame: int, eye: Eye) -> tuple[Array, NDArray[np.bool_]]:
        """`Follow` to the middle of a frame's shutter; the shift of points behind the lens is 0."""
        scene, time = self.scene, middle_of(self.scene, frame)
        camera, poses = camera_at(scene, time), poses_at(scene, time, eye)
        row, column, ratio = self.places(camera, poses)
        hidden = (ratio <= 0.0) | outside_frame(scene.camera, row, column)
        hidden |= nearest_at(scene, camera, poses, row, column) * ratio > self.w * (1.0 + 1e-6)
        at_row, at_column = padded_grid(scene.camera, 0)
        shift = np.stack([column - at_column, row - at_row], axis=-1)
        return np.where((ratio > 0.0)[..., None], shift, 0.0), hidden & (self.number >= 0)


def middle_of(scene: Scene, frame: int) -> float:
    """Time of a frame's ground truth, s; 0 in a scene without motion."""
    return middle_time(scene.sequence, frame) if scene.moves else 0.0


def nearest_at(scene: Scene, camera: Camera, poses: tuple[Pose, ...], row: Array, column: Array) -> Array:
    """Inverse depth (...) in 1/mm of the nearest surface in pixels of a camera."""
    surfaces = [place(item, pose) for item, pose in zip(scene.objects, poses, strict=True)]
    bounds = [cutting_bounds(item) for item in scene.objects]
    return nearest_surface(surfaces, bounds, everything(scene), pixel_ray(camera, row, column))[0]


def outside_frame(camera: Camera, row: Array, column: Array) -> NDArray[np.bool_]:
    """True for positions outside of the frame."""
    columns, rows = camera.frame_size
    return np.asarray((row < -0.5) | (row >= rows - 0.5) | (column < -0.5) | (column >= columns - 0.5))


def _hidden(view: View, rest: PlacedSurface, number: int, rays: Array, w: Array) -> NDArray[np.bool_]:
    """Mask of points of an object's surface that were not visible in its reference pose."""
    scene, surface = view.scene, view.surfaces[number]
    row, column, valid = rest_pixel(surface, view.reference, rays, w)
    w_rest, _ = solve_quadric(rest, cutting_bounds(scene.objects[number]), pixel_ray(view.reference, row, column))
    depth_ratio = np.where(valid, rest_position(surface, rays, w)[..., 2], 1.0)
    covered = w_rest * depth_ratio > w * (1.0 + 1e-6)
    return np.asarray((w > 0.0) & (~valid | outside_frame(scene.camera, row, column) | covered))


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


def surface_truth(view: View, row: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[dict[str, Any], Points]:
    """Ground truth of a view by name, and its surface points, at pixels: rows (m, 1) and columns (1, n)."""
    scene, rays = view.scene, pixel_ray(view.camera, row, column)
    hit = cast(view, everything(scene), row, column, (row, column))
    w, shape = hit.w, (*hit.w.shape, 3)
    normal, body, uv, hidden = np.zeros(shape), np.zeros(shape), np.zeros((*w.shape, 2)), np.zeros(w.shape, dtype=bool)
    mask = hit.label > 0
    for k, (item, surface, rest) in enumerate(zip(scene.objects, view.surfaces, rest_poses(scene), strict=True)):
        on_object = hit.number == k
        normal = np.where(on_object[..., None], surface_normal(surface, rays, w), normal)
        body = np.where(on_object[..., None], body_point(surface, rays, w), body)
        if item.mapped is None:
            hidden = np.where(on_object, _hidden(view, place(item, rest), k, rays, w), hidden)
        uv = np.where(on_object[..., None], _texture_coordinates(view, k, rays, np.where(on_object, w, 0.0)), uv)
        if item.is_background:  # no surface, but radiance and blur
            mask = mask & ~on_object
    radii = [np.where(hit.label > 0, blur_radius(lens, rays, w), 0.0) for lens in view.lenses]
    number = np.where(mask, hit.number, -1).astype(hit.number.dtype)
    arrays = {
        "sharp": hit.radiance,
        "depth": np.where(mask, 1.0 / np.where(mask, w, 1.0), np.inf),
        "blur_radius": radii[0] if len(radii) == 1 else np.stack(radii, axis=-1),
        "mask": mask,
        "object_id": number,
        "normal": np.where(mask[..., None], normal, 0.0),
        "hidden": hidden & mask,
        "uv": np.where(mask[..., None], uv, 0.0),
    }
    return arrays, Points(scene, number, np.where(mask, w, 0.0), body)


def ground_truth(scene: Scene, textures: tuple[Texture, ...], frame: int, eye: Eye = "left") -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame at the middle of its shutter, at pixel centers.

    textures: as for `View`. `flow` goes from a pixel to the position of its surface point at the middle of the next
    frame's shutter; it is 0 if that position is behind the lens. `hidden` is True if, in the reference pose, the point
    is outside of the frame, or is hidden by another point of its object (nearer by more than 1e-6 of the point's
    depth). It is always False for a texture on a surface.
    """
    view = view_at(scene, textures, middle_of(scene, frame), eye, scene.is_displaced or shifts_view(scene, eye))
    arrays, points = surface_truth(view, *padded_grid(scene.camera, 0))
    return followed(arrays, replace(points, scene=scene).at_middle, scene, frame, eye)


def followed(
    arrays: dict[str, Any], follow: Follow, scene: Scene, frame: int, eye: Eye, row_time: Array | None = None
) -> Truth:
    """Ground truth to which flow and stereo are added by `follow`."""
    (flow, flow_occluded), (backward, _) = (follow(k, eye) for k in (frame + 1, frame - 1))
    disparity, occluded = None, None
    if scene.stereo is not None:
        shift, occluded = follow(frame, "left" if eye == "right" else "right")
        disparity = (1.0 if eye == "right" else -1.0) * shift[..., 0]
    return Truth(
        **arrays, flow=flow, flow_backward=backward, flow_occluded=flow_occluded, disparity=disparity,
        occluded=occluded, row_time=row_time,
    )  # fmt: skip
