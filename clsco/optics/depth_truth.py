"""Normals and flow of depth maps, which are not ray-castable, from depth alone (float64, pure)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens import ray_step
from clsco.optics.motion import Eye, Pose, moved_points, rest_center
from clsco.optics.rays import image_slopes, ray_slopes
from clsco.scene.model import Camera, Object

# A depth at a point's position that is nearer by at most this factor belongs to the point's own surface.
SAME_SURFACE = 1.02
Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


def _points(camera: Camera, depth: NDArray[np.floating]) -> Array:
    """Surface points (rows, columns, 3) in mm of a depth map in mm; 0 where depth is infinite."""
    rays = np.stack([*ray_slopes(camera, *np.indices(depth.shape)), np.ones(depth.shape)], axis=-1)
    return np.asarray(rays * np.where(np.isfinite(depth), depth, 0.0).astype(np.float64)[..., None])


def _difference(point: Array, valid: Mask, axis: int) -> Array:
    """Step along an axis between a pixel's point and that of the neighbor whose depth differs less; 0 without one."""
    step = np.diff(point, axis=axis)
    both_valid = np.logical_and(*(np.delete(valid, end, axis=axis) for end in (0, -1)))
    step = np.where(both_valid[..., None], step, np.inf)
    ahead, behind = (
        np.pad(step, [side if k == axis else (0, 0) for k in range(3)], constant_values=np.inf)
        for side in ((0, 1), (1, 0))
    )
    shorter = np.where(np.abs(ahead[..., 2:]) <= np.abs(behind[..., 2:]), ahead, behind)
    return np.where(np.isfinite(shorter), shorter, 0.0)


def map_normal(camera: Camera, depth: NDArray[np.floating]) -> Floats:
    """Unit normals (rows, columns, 3) of a depth map in mm, towards the lens; 0 without a surface (depth +inf).

    Of two neighbors on an axis, the one whose depth differs less is used, so that differences do not cross depth
    discontinuities.
    """
    point, valid = _points(camera, depth), np.isfinite(depth)
    right, down = (_difference(point, valid, axis) for axis in (1, 0))
    normal = np.cross(right, down)
    normal *= np.where((normal * point).sum(axis=-1) > 0, -1.0, 1.0)[..., None]
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    towards = -point / np.maximum(np.linalg.norm(point, axis=-1, keepdims=True), 1e-300)
    covered = valid[..., None]
    return np.where(covered, np.where(size > 0, normal / np.maximum(size, 1e-300), towards), 0.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Surface points visible in the pixels of a depth map.

    depth: mm, +inf without a surface; object_id: -1 without one; poses: of all objects, relative to the map's camera.
    """

    items: Sequence[Object]
    depth: NDArray[np.floating]
    object_id: NDArray[np.int32]
    camera: Camera
    poses: Sequence[Pose]

    @cached_property
    def points(self) -> Array:
        """Points (rows, columns, 3), mm."""
        return _points(self.camera, self.depth)

    def moved(self, k: int, pose: Pose) -> Array:
        """Points (rows, columns, 3) moved with object k to another pose, mm."""
        return moved_points(self.points, rest_center(self.items[k]), self.poses[k], pose)


def map_flow(points: MapPoints, camera: Camera, then: Sequence[Pose]) -> Floats:
    """Optical flow (rows, columns, 2) in px, right and down, to the poses `then`, which are relative to `camera`.

    0 without a surface, and where the point moves behind the lens.
    """
    point, step, ratio = points.points, ray_step(camera), ray_step(points.camera) / ray_step(camera)
    flow = np.zeros((*points.depth.shape, 2))
    for k in range(len(points.items)):
        moved = points.moved(k, then[k])
        mask = (points.object_id == k) & np.isfinite(points.depth) & (moved[..., 2] > 0)
        target, origin = (
            image_slopes(by, *(at[..., axis] / np.where(mask, at[..., 2], 1.0) for axis in (0, 1)))
            for by, at in ((camera, moved), (points.camera, point))
        )
        for axis, sign in ((0, 1.0), (1, -1.0)):
            flow[..., axis] = np.where(mask, sign * (target[axis] - origin[axis] / ratio) / step, flow[..., axis])
    return flow.astype(np.float32)


def map_stereo(
    points: MapPoints, poses: Sequence[Pose], opposite: NDArray[np.floating], eye: Eye
) -> tuple[Floats, Mask]:
    """Disparity (x in the left view minus x in the right view, px) and occlusion (by `map_occluded`) of the view `eye`.

    poses: of all objects, relative to the other view; opposite: depth of the other view, mm.
    """
    flow = map_flow(points, points.camera, poses)
    occluded = map_occluded(points, points.camera, poses, opposite)
    return (flow[..., 0] * (1.0 if eye == "right" else -1.0)).astype(np.float32), occluded


def map_occluded(points: MapPoints, camera: Camera, poses: Sequence[Pose], opposite: NDArray[np.floating]) -> Mask:
    """Mask of points that are not visible in other poses, such as those of the next frame.

    True where a surface at the point's position is nearer by more than the factor SAME_SURFACE, or the position is
    outside the frame. camera, poses: as for `map_flow`; opposite: depth in these poses, mm.
    """
    flow = map_flow(points, camera, poses)
    rows, columns = points.depth.shape
    i, j = np.indices(points.depth.shape)
    row, column = (np.floor(at + flow[..., axis] + 0.5).astype(np.int64) for at, axis in ((i, 1), (j, 0)))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    nearest = opposite[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
    moved = np.full(points.depth.shape, np.inf)
    for k in range(len(points.items)):
        moved = np.where(points.object_id == k, points.moved(k, poses[k])[..., 2], moved)
    return np.asarray((points.object_id >= 0) & (~inside | (nearest * SAME_SURFACE < moved)))
