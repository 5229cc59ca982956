"""Ground truth under a rolling shutter, with each row or column at its own time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.optics.exposure import line_times
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, Pose, poses_at, rest_center, rest_poses
from clsco.optics.quadrics import cutting_bounds, place
from clsco.reference.common.geometry import Array, body_point, nearest_surface, pixel_ray, project, turned
from clsco.reference.trace.trace import everything, padded_grid, view_at
from clsco.reference.trace.truth import SurfaceTruth, Truth, outside_frame, surface_truth
from clsco.reference.trace.view import Texture
from clsco.scene.model import Camera, Scene

NEARER = 1.0 + 1e-5  # ratio of depths from which on the nearer one belongs to another point (clsco.optics.line_truth)


def line_truth(scene: Scene, textures: tuple[Texture, ...], frame: int, eye: Eye = "left") -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame, as `ground_truth`, with each line at the middle of its exposure.

    Flow ends on the line that shows the point in the other frame; inf if no single line does.
    """
    rest = [place(item, pose) for item, pose in zip(scene.objects, rest_poses(scene), strict=True)]
    times, axis = line_times(scene, frame), int(scene.sequence.by_columns)
    rows, columns = padded_grid(scene.camera, 0)
    truths, bodies = list[SurfaceTruth](), list[Array]()
    for line, time in enumerate(times.tolist()):
        view, line_index = view_at(scene, textures, time, eye, True), np.array([[line]])
        truth = surface_truth(view, rest, *((line_index, columns) if axis == 0 else (rows, line_index)))
        body = np.zeros(truth.rays.shape)
        for k, surface in enumerate(view.surfaces):
            on_object = (truth.hit.number == k)[..., None]
            body = np.where(on_object, body_point(surface, truth.rays, truth.hit.w), body)
        truths.append(truth)
        bodies.append(body)
    arrays = {name: np.concatenate([line.arrays[name] for line in truths], axis) for name in truths[0].arrays}
    w = np.concatenate([line.hit.w for line in truths], axis)
    points = _Points(scene, np.where(arrays["mask"], w, 0.0), arrays["object_id"], np.concatenate(bodies, axis))
    flow, flow_occluded = points.follow(frame + 1, eye)
    disparity, occluded = None, None
    if scene.stereo is not None:
        shift, occluded = points.follow(frame, "left" if eye == "right" else "right")
        disparity = (1.0 if eye == "right" else -1.0) * shift[..., 0]
    backward, _ = points.follow(frame - 1, eye)
    return Truth(
        **arrays, flow=flow, flow_backward=backward, flow_occluded=flow_occluded, disparity=disparity,
        occluded=occluded, row_time=times,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Points:
    """Surface points in pixels (m, n), each at the time of its line: inverse depth, object, and `body_point`."""

    scene: Scene
    w: Array
    number: NDArray[np.int32]
    body: Array

    def _places(self, camera: Camera, poses: tuple[Pose, ...]) -> Array:
        """Row, column and ratio of depths, new to present (3, m, n), of all points in other poses relative to a camera.

        All are 0 for points behind the lens.
        """
        places = np.zeros((3, *self.w.shape))
        for k, (item, pose) in enumerate(zip(self.scene.objects, poses, strict=True)):
            position = (rest_center(item) + pose.shift) * self.w[..., None] + turned(pose.rotation, self.body)
            before = (position[..., 2] > 0.0) & (self.number == k)
            row, column = project(camera, np.where(before[..., None], position, 1.0))
            places = np.where(before, np.stack([row, column, position[..., 2]]), places)
        return places

    def follow(self, frame: int, eye: Eye) -> tuple[Array, NDArray[np.bool_]]:
        """Flow to the lines of a frame, and a mask of points that are not visible there, by a search through all lines.

        A point lies between the first line that is at or beyond it when exposed, and the previous line.
        """
        scene, axis, surface = self.scene, int(self.scene.sequence.by_columns), self.number >= 0
        views = [(camera_at(scene, time), poses_at(scene, time, eye)) for time in line_times(scene, frame).tolist()]
        last = len(views) - 1
        start = end = self._places(*views[0])
        low, waiting = np.zeros(self.w.shape, np.intp), np.ones(self.w.shape, np.bool_)
        before = start
        for line in range(1, last + 1):
            now = self._places(*views[line])
            reached = waiting & ((now[axis] <= line) | (line == last))
            start, end = np.where(reached, before, start), np.where(reached, now, end)
            low, waiting, before = np.where(reached, line - 1, low), waiting & ~reached, now
        slope = end[axis] - start[axis]
        alone = np.abs(slope) < 1.0
        share = np.clip((start[axis] - low) / np.where(alone, 1.0 - slope, 1.0), 0.0, 1.0)
        row, column = start[:2] + share * (end[:2] - start[:2])
        valid = surface & alone & (start[2] > 0.0) & (end[2] > 0.0)
        at_row, at_column = padded_grid(scene.camera, 0)
        flow = np.where(valid[..., None], np.stack([column - at_column, row - at_row], axis=-1), np.inf)
        hidden = ~valid | outside_frame(scene.camera, row, column)
        place_at = np.where(np.rint(low + share) == low, start, end)
        nearest = np.rint(low + share).astype(np.intp)
        for line, (camera, poses) in enumerate(views):
            i, j = np.nonzero(valid & (nearest == line))
            surfaces = tuple(place(item, pose) for item, pose in zip(scene.objects, poses, strict=True))
            rays = pixel_ray(camera, *place_at[:2, i, j])
            nearest_w, _, _ = nearest_surface(surfaces, [*map(cutting_bounds, scene.objects)], everything(scene), rays)
            hidden[i, j] |= nearest_w * place_at[2, i, j] > self.w[i, j] * NEARER
        return np.where(surface[..., None], flow, 0.0), hidden & surface
