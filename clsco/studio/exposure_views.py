"""The exposure of a frame: its time samples, one of them alone, and how far objects move meanwhile."""

from __future__ import annotations

from typing import Any

import numpy as np

from clsco.frame.frame import Frame
from clsco.optics.exposure import frame_exposure, shutter_span
from clsco.optics.lens_path import reference_camera
from clsco.optics.motion import Eye, poses_at, rest_center
from clsco.reference.common.geometry import project
from clsco.scene.model import Scene

LEAST_SHARE = 1e-6  # of the interval, after the shutter opens
SHORTEST_PX = 0.5  # of an arrow
NEAREST = 1e-3  # mm; what is nearer to the lens, or behind it, has no place in the frame


def moment_of(scene: Scene, index: int, time: float) -> Scene:
    """The scene whose frame has one time sample.

    Parameters
    ----------
    scene : Scene
    index : int
        Number of the frame.
    time : float
        Seconds since the reference pose, taken to be within the interval of the frame, or while its shutter is open.

    Returns
    -------
    Scene
        Its frame of the same number is the sub-frame at this time, and all ground truth is that of this time; the
        flow leads over one interval.

    Notes
    -----
    A shutter of twice the time since the frame began, or since its shutter opened sooner, has its only sample then; it
    may exceed the interval, which files may not ask for. Validated by the sub-frames of `clsco.render`.
    """
    sequence, interval = scene.sequence, scene.sequence.interval
    start = min(sequence.shutter_start, 0.0)
    last = max(shutter_span(sequence, 0)[1], interval)
    since = min(max(time - index * interval, start + LEAST_SHARE * interval), last) - start
    changes = {"shutter": 2.0 * since, "shutter_start": start, "shutter_curve": "box", "samples": 1}
    changes |= {"sampling": "midpoint"}
    return scene.model_copy(update={"sequence": scene.sequence.model_copy(update=changes)})


def eye_of(frame: Frame) -> Eye:
    """Eye that a frame belongs to; one that is no half of a pair is the left eye's, where the camera is."""
    return "right" if frame.eye == "right" else "left"


def exposure_of(frame: Frame, scene: Scene, samples: int) -> dict[str, Any]:
    """Data of the time line for a frame.

    Parameters
    ----------
    frame : Frame
    scene : Scene
    samples : int
        Time samples of the frame, as its plan has them.

    Returns
    -------
    dict
        `times` of its samples and `shutter`, when it opens and closes, in s since the reference pose; `arrows`: column
        and row of the origin of each object that moves, at both of these.
    """
    if not scene.moves:
        return {"times": [], "shutter": None, "arrows": []}
    shutter = list(shutter_span(scene.sequence, frame.index))
    times = frame_exposure(scene, frame.index, samples).times
    return {"times": times.tolist(), "shutter": shutter, "arrows": _arrows(scene, shutter, frame)}


def _arrows(scene: Scene, shutter: list[float], frame: Frame) -> list[list[float]]:
    rows, columns = frame.color.shape[:2]
    camera = reference_camera(scene).model_copy(update={"resolution": (columns, rows)})
    eye, found = eye_of(frame), []
    for item, *poses in zip(scene.objects, *(poses_at(scene, time, eye) for time in shutter), strict=True):
        points = np.array([rest_center(item) + pose.shift for pose in poses])
        if item.is_background or (points[:, 2] < NEAREST).any():
            continue
        row, column = project(camera, points)
        arrow = [float(column[0]), float(row[0]), float(column[1]), float(row[1])]
        if np.hypot(arrow[2] - arrow[0], arrow[3] - arrow[1]) >= SHORTEST_PX:
            found.append(arrow)
    return found
