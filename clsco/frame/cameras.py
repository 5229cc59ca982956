"""Cameras of a scene as files describe them: pinholes with poses (for a COLMAP model), and attributes of an EXR."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.cameras import Pinhole
from clsco.files.truth_codes import MM_PER_M
from clsco.frame.frame import Frame
from clsco.frame.provenance import views
from clsco.optics.exposure import middle_time
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, eye_pose, moved_points, poses_at, rest_center
from clsco.optics.rays import slopes_at
from clsco.scene.model import Scene

FLIP = np.diag([1.0, -1.0, 1.0])  # y points up in scenes, and down in files of cameras
EXR_AXES = np.diag([-1.0, -1.0, 1.0])  # OpenEXR's camera has x to the left, y up
FINEST = 1001 * 120  # largest denominator of a frame rate, as in 120000/1001
BT709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x and y of red, green, blue and white


def pinhole(scene: Scene, index: int, eye: Eye = "left") -> Pinhole:
    """The camera of a frame at the middle of its shutter, the time of its ground truth. scene: one with a resolution.

    The world is the camera's own frame in its reference pose, with y down: (x, -y, z) of the scene. The focal length in
    px is s0 / p, `normalization_distance` over `pixel_pitch`, because x = s0 X / Z; for a zoom, it is the focal length
    at the middle of the shutter. Validated by surface points that are projected to the next frame and to the other
    view, against flow and disparity.
    """
    columns, rows = scene.camera.frame_size
    time = middle_time(scene.sequence, index)
    pose, step = eye_pose(scene, eye, time), ray_step(camera_at(scene, time))
    rotation = FLIP @ pose.rotation.T @ FLIP
    middle = (0.5 * (columns - 1), 0.5 * (rows - 1))
    (k1, k2, k3), tangential = (scene.lens.radial, scene.lens.tangential) if scene.lens else ((0.0,) * 3, (0.0,) * 2)
    keys = (k1, k2, *tangential, k3)
    shift = -rotation @ (FLIP @ pose.shift)
    return Pinhole(columns, rows, 1.0 / step, middle, rotation, shift, keys if any(keys) else ())


def eye_of(frame: Frame) -> Eye:
    """View of a frame; the only view of a scene counts as left."""
    return "right" if frame.eye == "right" else "left"


def mark_behind_lens(scene: Scene, frame: Frame, step: int) -> NDArray[np.bool_]:
    """Mask of surface points that are behind the lens at the middle of the shutter `step` frames later.

    frame: one with `depth`, `object_id` and, for step 1, `flow` or, for step -1, `flow_backward`. Flow to a point
    behind the lens is 0, as no pixel shows the point. Validated by a camera that flies past a sphere.
    """
    flow = frame.flow if step == 1 else frame.flow_backward
    assert flow is not None
    assert frame.depth is not None
    assert frame.object_id is not None
    now, then = (poses_at(scene, middle_time(scene.sequence, frame.index + n), eye_of(frame)) for n in (0, step))
    behind = np.zeros(frame.depth.shape, dtype=bool)
    for k, item in enumerate(scene.objects):
        row, column = np.nonzero((frame.object_id == k) & ~flow.any(axis=-1))
        middle = 0.5 * (np.array(frame.depth.shape) - 1)
        camera = camera_at(scene, middle_time(scene.sequence, frame.index))
        across, up = slopes_at(camera, column - middle[1], middle[0] - row)
        point = np.stack([across, up, np.ones_like(across)], axis=-1) * frame.depth[row, column, None]
        behind[row, column] = moved_points(point.astype(np.float64), rest_center(item), now[k], then[k])[:, 2] <= 0
    return behind


def frame_rate(interval: float) -> Fraction:
    """Frames per second for an interval in s, such as 30000/1001 for the float 1001/30000; terms have up to 31 bits."""
    larger = max(interval, 1.0 / interval)
    fraction = Fraction(larger).limit_denominator(min(FINEST, int(2**31 / larger)))
    return fraction if interval < 1.0 else 1 / fraction


def exr_attributes(scene: Scene, index: int, eye: Eye = "left") -> dict[str, Any]:
    """Standard OpenEXR attributes for a frame of a scene with a resolution.

    `aperture` (f-number), `focus` (m), `chromaticities` (BT.709), `worldToCamera` (for row vectors, mm) and
    `screenWindowWidth`; for moving scenes `expTime` (s) and `framesPerSecond`. The camera looks along +z, x to the left
    and y up, its screen window is at z = 1, and the world is that of `pinhole`. Validated by projected points.
    """
    camera, lens = pinhole(scene, index, eye), camera_at(scene, middle_time(scene.sequence, index))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = (EXR_AXES @ camera.rotation).T, EXR_AXES @ camera.translation
    world_to_camera: NDArray[np.float32] = matrix.astype(np.float32)
    sequence, timed = scene.sequence, scene.moves or scene.sequence.frames > 1
    times = {"expTime": sequence.shutter, "framesPerSecond": frame_rate(sequence.interval)} if timed else {}
    return {
        "aperture": lens.focal_length / lens.aperture_diameter,
        "focus": lens.focused_distance / MM_PER_M,
        **times,
        "chromaticities": BT709,
        "worldToCamera": world_to_camera,
        "screenWindowWidth": camera.columns / camera.focal,
    }


def all_pinholes(scene: Scene) -> Iterator[tuple[int, Eye, Pinhole]]:
    """Number, view and camera of every frame of a scene; the views of a stereo pair follow each other, left first."""
    for index in range(scene.sequence.frames):
        for eye in views(scene):
            yield index, eye, pinhole(scene, index, eye)
