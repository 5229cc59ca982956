"""Ground truth of depth maps, at which no ray can be cast: normals and motion from depth alone (float64, pure)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens import ray_step
from clsco.optics.motion import Eye, Pose, rest_center
from clsco.scene.model import Camera, Object

SAME_SURFACE = 1.02  # how much nearer than a point what is seen in its place may be, and still be its own surface
Array = NDArray[np.float64]
Floats = NDArray[np.float32]


def _points(camera: Camera, depth: NDArray[np.floating]) -> Array:
    """Surface points (rows, columns, 3) in mm that pixels of a depth in mm see; 0 where depth is infinite."""
    rows, columns = depth.shape
    i, j = np.indices(depth.shape)
    step = ray_step(camera)
    rays = np.stack([(j - (columns - 1) / 2) * step, ((rows - 1) / 2 - i) * step, np.ones(depth.shape)], axis=-1)
    return np.asarray(rays * np.where(np.isfinite(depth), depth, 0.0).astype(np.float64)[..., None])


def _difference(point: Array, there: NDArray[np.bool_], axis: int) -> Array:
    """Way from a pixel's point to its neighbor's on the side where the depth changes less; 0 without a neighbor."""
    step = np.diff(point, axis=axis)
    known = np.logical_and(*(np.delete(there, end, axis=axis) for end in (0, -1)))
    step = np.where(known[..., None], step, np.inf)
    edge = np.full_like(np.take(step, [0], axis=axis), np.inf) if step.shape[axis] else np.full_like(point, np.inf)
    ahead = np.concatenate([step, edge], axis=axis) if step.shape[axis] else edge
    behind = np.concatenate([edge, step], axis=axis) if step.shape[axis] else edge
    shorter = np.where(np.abs(ahead[..., 2:]) <= np.abs(behind[..., 2:]), ahead, behind)
    return np.where(np.isfinite(shorter), shorter, 0.0)


def map_normal(camera: Camera, depth: NDArray[np.floating]) -> Floats:
    """Unit normals (rows, columns, 3) in the camera frame, towards the lens, from the differences of a depth map.

    depth: (rows, columns) in mm, +inf where nothing is; the normal is 0 there. Of the neighbors on both sides the one
    counts whose depth differs less, so that a normal does not reach across an edge.
    Validated on the depths of analytic surfaces.
    """
    point, there = _points(camera, depth), np.isfinite(depth)
    right, down = (_difference(point, there, axis) for axis in (1, 0))
    normal = np.cross(right, down)
    normal *= np.where((normal * point).sum(axis=-1) > 0, -1.0, 1.0)[..., None]
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    towards = -point / np.maximum(np.linalg.norm(point, axis=-1, keepdims=True), 1e-300)
    known = there[..., None]
    return np.where(known, np.where(size > 0, normal / np.maximum(size, 1e-300), towards), 0.0).astype(np.float32)


def map_flow(
    camera: Camera, items: Sequence[Object], depth: NDArray[np.floating], object_id: NDArray[np.int32],
    now: Sequence[Pose], then: Sequence[Pose],
) -> Floats:  # fmt: skip
    """Image motion (rows, columns, 2) in px, right and down, of the surface that pixels see, from one pose to another.

    depth: (rows, columns) in mm, +inf where nothing is; object_id: (rows, columns), -1 there; now, then: poses of all
    objects. 0 where nothing is, and where the point gets behind the lens. Validated against the flow of the surface
    that a depth map was made from.
    """
    point, step = _points(camera, depth), ray_step(camera)
    flow = np.zeros((*depth.shape, 2))
    for k, item in enumerate(items):
        center = rest_center(item)
        body = (point - center - now[k].shift) @ now[k].rotation  # turned back
        moved = center + then[k].shift + body @ then[k].rotation.T
        seen = (object_id == k) & np.isfinite(depth) & (moved[..., 2] > 0)
        ahead = np.where(seen, moved[..., 2], 1.0)
        here = np.where(seen, point[..., 2], 1.0)
        for axis, sign in ((0, 1.0), (1, -1.0)):
            shift = sign * (moved[..., axis] / ahead - point[..., axis] / here) / step
            flow[..., axis] = np.where(seen, shift, flow[..., axis])
    return flow.astype(np.float32)


def map_stereo(
    camera: Camera, items: Sequence[Object], depth: NDArray[np.floating], object_id: NDArray[np.int32],
    now: Sequence[Pose], there: Sequence[Pose], opposite: NDArray[np.floating], eye: Eye,
) -> tuple[Floats, NDArray[np.bool_]]:  # fmt: skip
    """Disparity (rows, columns) in px, and what the other view does not see (rows, columns), from depth.

    depth, object_id, now: of this view, `eye`, as for `map_flow`; there: poses that the other one sees; opposite: its
    depth (rows, columns) in mm. Occluded: where the point is in the other view, something is more than SAME_SURFACE
    times nearer, or the frame ends.
    """
    flow = map_flow(camera, items, depth, object_id, now, there)
    rows, columns = depth.shape
    i, j = np.indices(depth.shape)
    row, column = (np.floor(at + flow[..., axis] + 0.5).astype(np.int64) for at, axis in ((i, 1), (j, 0)))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    seen = opposite[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
    point, moved = _points(camera, depth), np.full(depth.shape, np.inf)
    for k, item in enumerate(items):
        center = rest_center(item)
        body = (point - center - now[k].shift) @ now[k].rotation
        z = (center + there[k].shift + body @ there[k].rotation.T)[..., 2]
        moved = np.where(object_id == k, z, moved)
    occluded = (object_id >= 0) & (~inside | (seen * SAME_SURFACE < moved))
    return (flow[..., 0] * (1.0 if eye == "right" else -1.0)).astype(np.float32), occluded
