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
from clsco.reference.trace.truth import Shown, Truth, outside_frame, surface_truth
from clsco.reference.trace.view import Texture
from clsco.scene.model import Camera, Scene

NEARER = 1.0 + 1e-5  # as in clsco.optics.line_truth: a depth that is nearer by this factor is that of another point


def line_truth(scene: Scene, textures: tuple[Texture, ...], frame: int, eye: Eye = "left") -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame, as `ground_truth`, with each line at the middle of its exposure.

    Flow ends on the line that shows the point in the other frame; inf if no single line does.
    """
    rest = [place(item, pose) for item, pose in zip(scene.objects, rest_poses(scene), strict=True)]
    times, axis, (rows, columns) = (
        line_times(scene, frame),
        int(scene.sequence.by_columns),
        padded_grid(scene.camera, 0),
    )
    shown, bodies = list[Shown](), list[Array]()
    for line, time in enumerate(times.tolist()):
        view, own = view_at(scene, textures, time, eye, True), np.array([[line]])
        found = surface_truth(view, rest, *((own, columns) if axis == 0 else (rows, own)))
        body = np.zeros(found.rays.shape)
        for k, surface in enumerate(view.surfaces):
            seen = (found.hit.number == k)[..., None]
            body = np.where(seen, body_point(surface, found.rays, found.hit.w), body)
        shown.append(found)
        bodies.append(body)
    arrays = {name: np.concatenate([each.arrays[name] for each in shown], axis) for name in shown[0].arrays}
    w = np.concatenate([each.hit.w for each in shown], axis)
    points = _Points(scene, np.where(arrays["mask"], w, 0.0), arrays["object_id"], np.concatenate(bodies, axis))
    flow, flow_occluded = points.seen(frame + 1, eye)
    disparity, occluded = None, None
    if scene.stereo is not None:
        apart, occluded = points.seen(frame, "left" if eye == "right" else "right")
        disparity = (1.0 if eye == "right" else -1.0) * apart[..., 0]
    backward, _ = points.seen(frame - 1, eye)
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
        """Row, column and depth relative to the present depth (3, m, n), 0 behind the lens, of all points in other
        poses relative to a camera.
        """
        found = np.zeros((3, *self.w.shape))
        for k, (item, pose) in enumerate(zip(self.scene.objects, poses, strict=True)):
            position = (rest_center(item) + pose.shift) * self.w[..., None] + turned(pose.rotation, self.body)
            before = (position[..., 2] > 0.0) & (self.number == k)
            row, column = project(camera, np.where(before[..., None], position, 1.0))
            found = np.where(before, np.stack([row, column, position[..., 2]]), found)
        return found

    def seen(self, frame: int, eye: Eye) -> tuple[Array, NDArray[np.bool_]]:
        """Flow to the lines of a frame, and a mask of points that are not visible there, by a search through all lines.

        A point lies between the first line that it is not beyond at that line's exposure, and the line before.
        """
        scene, axis, surface = self.scene, int(self.scene.sequence.by_columns), self.number >= 0
        views = [(camera_at(scene, time), poses_at(scene, time, eye)) for time in line_times(scene, frame).tolist()]
        last = len(views) - 1
        one = two = self._places(*views[0])
        low, waiting = np.zeros(self.w.shape, np.intp), np.ones(self.w.shape, np.bool_)
        before = one
        for line in range(1, last + 1):
            now = self._places(*views[line])
            reached = waiting & ((now[axis] <= line) | (line == last))
            one, two = np.where(reached, before, one), np.where(reached, now, two)
            low, waiting, before = np.where(reached, line - 1, low), waiting & ~reached, now
        slope = two[axis] - one[axis]
        alone = np.abs(slope) < 1.0
        share = np.clip((one[axis] - low) / np.where(alone, 1.0 - slope, 1.0), 0.0, 1.0)
        row, column = one[:2] + share * (two[:2] - one[:2])
        valid = surface & alone & (one[2] > 0.0) & (two[2] > 0.0)
        at_row, at_column = padded_grid(scene.camera, 0)
        flow = np.where(valid[..., None], np.stack([column - at_column, row - at_row], axis=-1), np.inf)
        hidden = ~valid | outside_frame(scene.camera, row, column)
        place_at = np.where(np.rint(low + share) == low, one, two)
        nearest = np.rint(low + share).astype(np.intp)
        for line, (camera, each) in enumerate(views):
            i, j = np.nonzero(valid & (nearest == line))
            surfaces = tuple(place(item, pose) for item, pose in zip(scene.objects, each, strict=True))
            rays = pixel_ray(camera, *place_at[:2, i, j])
            found, _, _ = nearest_surface(surfaces, [*map(cutting_bounds, scene.objects)], everything(scene), rays)
            hidden[i, j] |= found * place_at[2, i, j] > self.w[i, j] * NEARER
        return np.where(surface[..., None], flow, 0.0), hidden & surface
