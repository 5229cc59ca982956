"""Ground truth under a rolling shutter, with each row or column at its own time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.optics.exposure import line_times
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, poses_at
from clsco.reference.common.geometry import Array
from clsco.reference.trace.trace import padded_grid, view_at
from clsco.reference.trace.truth import Points, Truth, followed, nearest_at, outside_frame, surface_truth
from clsco.reference.trace.view import Texture
from clsco.scene.model import Scene

NEARER = 1.0 + 1e-5  # ratio of depths above which the nearer depth is that of another point (clsco.optics.line_truth)


def line_truth(scene: Scene, textures: tuple[Texture, ...], frame: int, eye: Eye = "left") -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame, as `ground_truth`, but each line is at the middle of its
    exposure.

    Flow ends on the line of the other frame that shows the point; it is inf if no single line shows the point.
    """
    times, axis = line_times(scene, frame), int(scene.sequence.by_columns)
    grid, truths = list(padded_grid(scene.camera, 0)), []
    for line, time in enumerate(times.tolist()):
        grid[axis] = np.array([[line]])
        truths.append(surface_truth(view_at(scene, textures, time, eye, True), *grid))
    arrays = {name: np.concatenate([line[name] for line, _ in truths], axis) for name in truths[0][0]}
    planes = (np.concatenate([getattr(points, name) for _, points in truths], axis) for name in ("number", "w", "body"))
    return followed(arrays, LinePoints(scene, *planes).follow, scene, frame, eye, times)


class LinePoints(Points):
    """Surface points in pixels (m, n), each at the time of its line."""

    def follow(self, frame: int, eye: Eye) -> tuple[Array, NDArray[np.bool_]]:
        """`Follow` to the lines of a frame, by a search through all lines; inf if no single line shows a point.

        A point lies between the first line that, when exposed, is at or beyond the point, and the previous line.
        """
        scene, axis, surface = self.scene, int(self.scene.sequence.by_columns), self.number >= 0
        views = [(camera_at(scene, time), poses_at(scene, time, eye)) for time in line_times(scene, frame).tolist()]
        last = len(views) - 1
        start = end = self.places(*views[0])
        low, waiting = np.zeros(self.w.shape, np.intp), np.ones(self.w.shape, np.bool_)
        before = start
        for line in range(1, last + 1):
            now = self.places(*views[line])
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
            nearest_w = nearest_at(scene, camera, poses, *place_at[:2, i, j])
            hidden[i, j] |= nearest_w * place_at[2, i, j] > self.w[i, j] * NEARER
        return np.where(surface[..., None], flow, 0.0), hidden & surface
