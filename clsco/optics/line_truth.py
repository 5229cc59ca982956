"""Flow and visibility under a rolling shutter, whose lines (rows or columns) have different times (float64, pure).

A surface point p(t), visible in a pixel at its line's time, appears in another frame or view on the line u that is
exposed as the point crosses it: line(p(t_u)) = u. Newton's method finds u; if the point moves by more than STEEP
between two lines, a search through all lines does. p is interpolated linearly between the times of neighboring lines,
and lines beyond the frame count as its first or last line. Where the image moves by a line or more from the time of one
line to that of the next, there is no flow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.distortion import Array, distortion_of
from clsco.optics.exposure import line_times
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, Pose, poses_at, rest_center
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.rays import image_slopes
from clsco.scene.model import Camera, Object, Scene

Pixels = NDArray[np.intp]
Mask = NDArray[np.bool_]
STEPS, CLOSE = 24, 1e-9  # largest number of Newton's steps, and change in lines at which they end
STEEP = 0.5  # lines: a point that moves by more between two lines' times may be on several lines
SAMPLED = 64  # number of points of an object, and of lines, that are tested for STEEP
NEARER = 1.0 + 1e-5  # a depth that is nearer by this factor belongs to another point


@dataclass(frozen=True, eq=False)
class Lines:
    """Times (lines,) in s of the rows or columns of a frame; for each time, the camera and the poses of all objects."""

    by_columns: bool
    times: Array
    cameras: tuple[Camera, ...]
    poses: tuple[tuple[Pose, ...], ...]

    @cached_property
    def steps(self) -> Array:
        """Slopes (lines,) between the rays of neighboring pixels on the axis."""
        return np.array([ray_step(camera) for camera in self.cameras])

    def slopes(self, line: Pixels, right: Array, up: Array) -> tuple[Array, Array]:
        """Slopes of rays through image points at their lines' times; right, up: px from the middle of the image."""
        x, y, distortion = right * self.steps[line], up * self.steps[line], distortion_of(self.cameras[0])
        return (x, y) if distortion is None else distortion.undistorted(x, y)

    def object_poses(self, number: int) -> tuple[Array, Array]:
        """Rotations (lines, 3, 3) and shifts (lines, 3) in mm of an object at each line's time."""
        poses = [line_poses[number] for line_poses in self.poses]
        return np.stack([pose.rotation for pose in poses]), np.stack([pose.shift for pose in poses])


def lines_of(scene: Scene, frame: int, eye: Eye) -> Lines:
    """Lines of a frame in a view, for a scene with a resolution."""
    times = line_times(scene, frame)
    cameras = tuple(camera_at(scene, time) for time in times.tolist())
    poses = tuple(poses_at(scene, time, eye) for time in times.tolist())
    return Lines(scene.sequence.by_columns, times, cameras, poses)


def _first_crossing(at: Callable[[int], tuple[Array, Mask]], last: int, axis: int) -> tuple[Array, Mask]:
    """Positions and mask, as from `LinePoints._positions`, of points that several lines may show; the first of these
    counts.

    at: function that takes the number of a line and returns the positions (points, 2) of the points at its time, and a
    mask of the points in front of the lens. last: number of the last line. axis: index of the coordinate that counts
    lines: 0 for columns, 1 for rows.
    """
    before, visible_before = at(0)
    start, end, visible = before, before, visible_before
    low, waiting = np.zeros(len(start)), np.ones(len(start), np.bool_)
    for line in range(1, last + 1):
        now, visible_now = at(line)
        crossing = waiting & ((now[:, axis] <= line) | (line == last))
        start, end = np.where(crossing[:, None], before, start), np.where(crossing[:, None], now, end)
        visible, low = np.where(crossing, visible_before & visible_now, visible), np.where(crossing, line - 1.0, low)
        waiting, before, visible_before = waiting & ~crossing, now, visible_now
    slope = (end - start)[:, axis]
    alone = np.abs(slope) < 1.0
    share = np.clip((start[:, axis] - low) / np.where(alone, 1.0 - slope, 1.0), 0.0, 1.0)
    return start + share[:, None] * (end - start), visible & alone


class LinePoints:
    """Surface points visible in the pixels of a frame, each at its line's time.

    depth: mm, +inf without a surface; object_id: -1 without one; now: lines of the frame.
    """

    def __init__(
        self, items: Sequence[Object], depth: NDArray[np.floating], object_id: NDArray[np.int32], now: Lines
    ) -> None:
        self.items, self.shape = items, depth.shape
        self.number = np.where(np.isfinite(depth), object_id, -1)
        self.bodies = np.zeros((*depth.shape, 3))  # mm from the objects' centers, in the axes of the reference pose
        rows, columns = depth.shape
        for k, item in enumerate(items):
            row, column = np.nonzero(self.number == k)
            rotations, shifts = now.object_poses(k)
            line = column if now.by_columns else row
            across, up = now.slopes(line, column - 0.5 * (columns - 1), 0.5 * (rows - 1) - row)
            point = np.stack([across, up, np.ones(row.shape)], axis=-1) * depth[row, column, None].astype(np.float64)
            self.bodies[row, column] = np.einsum(
                "nij,ni->nj", rotations[line], point - rest_center(item) - shifts[line]
            )

    def flow(self, then: Lines) -> Array:
        """Flow (rows, columns, 2) in px, right and down, to the lines of another frame or view that show the points.

        0 without a surface, inf if no single line shows the point: where the image moves by a line or more between two
        lines' times, and where the point moves behind the lens.
        """
        flow = np.zeros((*self.shape, 2))
        for k in range(len(self.items)):
            row, column = np.nonzero(self.number == k)
            positions, valid = self._positions(k, (row, column), then)
            flow[row, column] = np.where(valid[:, None], positions - np.stack([column, row], axis=-1), np.inf)
        return flow

    def _positions(self, k: int, pixels: tuple[Pixels, Pixels], then: Lines) -> tuple[Array, Mask]:
        """Positions (points, 2), column and row, at which the lines `then` show points of object k, and a mask of the
        points that they show; pixels: rows and columns of the points.
        """
        axis, last, (rotations, shifts) = int(not then.by_columns), len(then.times) - 1, then.object_poses(k)
        body, center = self.bodies[pixels], rest_center(self.items[k])

        def at(line: Pixels | int, of: Any = ...) -> tuple[Array, Mask]:
            moved = np.einsum("...ij,...j->...i", rotations[line], body[of])
            return self._project(center + shifts[line] + moved, then, line)

        def fast(line: int, of: Any = ...) -> Mask:
            return np.asarray(np.abs((at(line + 1, of)[0] - at(line, of)[0])[:, axis]) > STEEP)

        u, steep = pixels[int(then.by_columns)].astype(np.float64), np.zeros(len(body), np.bool_)
        sampled, steps = slice(None, None, max(len(body) // SAMPLED, 1)), range(0, last, max(last // SAMPLED, 1))
        if any(fast(line, sampled).any() for line in range(last)):
            steep = np.any([fast(line) for line in steps], axis=0)
        for _ in range(STEPS):
            low = np.clip(u.astype(np.intp), 0, max(last - 1, 0))
            (start, start_visible), (end, end_visible) = at(low), at(np.minimum(low + 1, last))
            positions = start + (u - low)[:, None] * (end - start)
            slope = (end - start)[:, axis]
            better = np.clip(u + (positions[:, axis] - u) / np.where(slope < 1.0, 1.0 - slope, 1.0), 0.0, last)
            change, u = np.abs(better - u).max(initial=0.0, where=~steep), better
            if change <= CLOSE:
                break
        valid = start_visible & end_visible & (np.abs(slope) < 1.0)
        if steep.any():
            positions[steep], valid[steep] = _first_crossing(lambda line: at(line, steep), last, axis)
        return positions, valid

    def _project(self, point: Array, then: Lines, line: Pixels | int) -> tuple[Array, Mask]:
        """Positions (points, 2) in px, column and row, of points (points, 3) in mm, and a mask of points in front of
        the lens; line: one line for all points, or a line for each.
        """
        before, (rows, columns) = point[:, 2] > 0.0, self.shape
        ahead = np.where(before, point[:, 2], 1.0)
        slopes = image_slopes(then.cameras[0], point[:, 0] / ahead, point[:, 1] / ahead)
        right, up = (slope / then.steps[line] for slope in slopes)
        return np.stack([0.5 * (columns - 1) + right, 0.5 * (rows - 1) - up], axis=-1), before

    def occluded(self, then: Lines, flow: Array) -> Mask:
        """Mask of points that are not visible at the end of their flow to the lines `then`: True if there is no flow,
        if it leads out of the frame, or if another point is nearer there.
        """
        rows, columns = self.shape
        row, column = np.nonzero(self.number >= 0)
        target = np.stack([column, row], axis=-1) + flow[row, column]
        outside = ~((target >= -0.5) & (target < np.array([columns, rows]) - 0.5)).all(axis=-1)
        hidden = np.zeros(self.shape, np.bool_)
        hidden[row[outside], column[outside]] = True
        row, column, target = row[~outside], column[~outside], target[~outside]
        line = np.rint(target[:, int(not then.by_columns)]).astype(np.intp)
        order = np.argsort(line, kind="stable")
        ends = np.searchsorted(line[order], np.arange(len(then.times) + 1))
        for number, poses in enumerate(then.poses):
            indices = order[ends[number] : ends[number + 1]]
            if indices.size:
                pixels = row[indices], column[indices]
                hidden[pixels] = self._covered(pixels, poses)
        return hidden

    def _covered(self, pixels: tuple[Pixels, Pixels], poses: tuple[Pose, ...]) -> Mask:
        """Mask (points,) of the points of these pixels that a nearer surface hides, with all objects in `poses`."""
        point, number, nearest = self.bodies[pixels], self.number[pixels], np.zeros(len(pixels[0]))
        for k, (item, pose) in enumerate(zip(self.items, poses, strict=True)):
            mask = number == k
            point[mask] = rest_center(item) + pose.shift + point[mask] @ pose.rotation.T
        before = point[:, 2] > 0.0
        x, y = (point[:, axis] / np.where(before, point[:, 2], 1.0) for axis in (0, 1))
        for item, pose in zip(self.items, poses, strict=True):
            nearest = np.maximum(nearest, predict_inverse_depth(item, place(item, pose), x, y))
        return np.asarray(~before | (nearest * point[:, 2] > NEARER))
