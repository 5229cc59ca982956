"""Pictures that are sent to the browser: encoded views of frames, each with a header."""

from __future__ import annotations

import base64
import io
import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.files.png import png_parts
from clsco.files.transfer import encode
from clsco.frame.frame import GREEN, Frame
from clsco.optics.exposure import frame_exposure, shutter_span
from clsco.optics.lens_path import reference_camera
from clsco.optics.motion import Eye, poses_at, rest_center
from clsco.reference.common.geometry import project
from clsco.scene.model import Scene

VIEWS = {  # attribute of `Frame` for each view by name, in the order of the tabs
    "color": "color", "sharp": "sharp", "depth": "depth", "blur radius": "blur_radius", "flow": "flow",
    "normal": "normal", "id": "object_id", "mask": "mask", "missing": "missing", "raw": "raw", "noise": "noise_sigma",
}  # fmt: skip

SENSOR_VIEWS = ("raw", "noise")  # views of scenes with a sensor
UNBLURRED = ("depth", "normal", "id")  # views that do not show blur, which takes most of the time
DRAGGING, LOSSY, EXACT, PINNED, STACKED, OUTLINED = range(6)  # rungs, see ViewPicture
MESSAGE, JPEG, PNG, FLOAT32 = range(4)
HEADER = struct.Struct("<IBBHHBHHBI")
FIELDS = ("revision", "rung", "view", "width", "height", "encoding", "columns", "rows", "flags", "number")
"""Names of the numbers in a picture's header; width, height: size of the picture; columns, rows: size of the frame."""

NO_NUMBER = 2**32 - 1
IMAGES = ("color", "sharp")  # views; all others are floats
SMALL = 160  # px, largest width and height of a small picture
QUALITY = {DRAGGING: 80, LOSSY: 95}


@dataclass(frozen=True)
class ViewPicture:
    """Picture of a frame in the form sent to the page."""

    # kind of picture. DRAGGING: preview during a drag; LOSSY, EXACT: exact frame, as JPEG or lossless; PINNED: exact
    # frame of another scene, to compare; STACKED: frame of a focal stack; OUTLINED: numbers of objects, for outlines
    rung: int
    view: str  # one of VIEWS
    # columns and rows: of the picture (size), of the frame (full)
    size: tuple[int, int]
    full: tuple[int, int]
    encoding: int  # JPEG or PNG, or FLOAT32: little endian, channels last
    payload: bytes
    seconds: float  # time that rendering took
    about: dict[str, Any] | None = None  # further figures of an exact frame, of JSON types
    is_still: bool = False  # True for a preview without motion
    eye: str = ""  # "left" or "right" of a stereo pair, else ""
    small: bytes = b""  # small JPEG of an exact color image, for lists of scenes

    def packed(self, revision: int, number: int) -> bytes:
        """The bytes for the browser; number: number of the frame, or position in a focal stack, or NO_NUMBER."""
        view = list(VIEWS).index(self.view)
        sizes = (*self.size, self.encoding, *self.full)
        flags = self.is_still | (self.eye == "right") << 1
        return HEADER.pack(revision, self.rung, view, *sizes, flags, number) + self.payload


def packed_message(revision: int, content: dict[str, Any]) -> bytes:
    """A message: a header like that of a picture, and `content` as JSON."""
    return HEADER.pack(revision, 0, 0, 0, 0, MESSAGE, 0, 0, 0, NO_NUMBER) + json.dumps(content).encode()


def truth_of(view: str) -> tuple[str, ...]:
    """Outputs that a view needs in addition to color."""
    if view == "blur radius":
        return VIEWS[view], "mask"
    return () if view == "color" else (VIEWS[view],)


def picture_of(frame: Frame, scene: Scene, view: str, rung: int, full: tuple[int, int], seconds: float) -> ViewPicture:
    """Encode a view of a frame; full: columns and rows of the exact frame; seconds: time that rendering took.

    Images are encoded as JPEG, or, from the rung EXACT on, as the PNG that `clsco render` writes. Other views become
    32-bit floats. The blur radius (of green, if there are several) is NaN without a surface, so that such pixels do not
    look in focus. Raises SceneError if the view needs a sensor, and the scene has none.
    """
    data = _data_of(frame, view)
    if data is None:
        raise SceneError(f"view: {view} belongs to scenes with a sensor, which has a panel; got none")
    if view in IMAGES:
        is_exact = rung >= EXACT
        bits = min(frame.metadata["bits"], 16) if is_exact else 8
        codes = encode(data, bits, scene.image.transfer)
        encoding, payload = (PNG, b"".join(png_parts(codes))) if is_exact else (JPEG, _jpeg(codes, QUALITY[rung]))
    else:
        encoding, payload = FLOAT32, np.ascontiguousarray(data, "<f4").tobytes()
    rows, columns = data.shape[:2]
    is_kept = view == "color" and rung == EXACT
    small = _jpeg(encode(_shrunk(data), 8, scene.image.transfer), QUALITY[DRAGGING]) if is_kept else b""
    return ViewPicture(rung, view, (columns, rows), full, encoding, payload, seconds, eye=frame.eye, small=small)


def _data_of(frame: Frame, view: str) -> NDArray[Any] | None:
    data: NDArray[Any] | None = getattr(frame, VIEWS[view])
    if view == "blur radius" and data is not None:
        data = data[..., GREEN] if data.ndim == 3 else data
        return np.where(frame.mask, data, np.nan) if frame.mask is not None else data
    return data


def small_views(frame: Frame, scene: Scene) -> dict[str, list[Any]]:
    """Small pictures of a frame with all ground truth, by view: columns, rows, base64 of a JPEG or 32-bit floats."""
    found: dict[str, list[Any]] = {}
    for view in VIEWS:
        if (data := _data_of(frame, view)) is not None:
            small = _shrunk(data)
            floats = np.ascontiguousarray(small, "<f4").tobytes
            content = _jpeg(encode(small, 8, scene.image.transfer), QUALITY[DRAGGING]) if view in IMAGES else floats()
            found[view] = [small.shape[1], small.shape[0], base64.b64encode(content).decode()]
    return found


def small_png(radiance: NDArray[Any]) -> bytes:
    """An 8-bit PNG with at most SMALL pixels on a side."""
    codes = encode(_shrunk(radiance), 8, "srgb").astype(np.uint8)
    return b"".join(png_parts(codes))


def _shrunk(data: NDArray[Any]) -> NDArray[Any]:
    step = max(1, -(-max(data.shape[:2]) // SMALL))
    return np.ascontiguousarray(data[::step, ::step])


def _jpeg(codes: NDArray[Any], quality: int) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=quality, subsampling=0 if quality > 90 else 2)
    return file.getvalue()


LEAST_SHARE = 1e-6  # earliest time after the shutter opens, as a fraction of the interval
SHORTEST_PX = 0.5  # least length of an arrow
LEAST_APPROACH = 2e-3  # least change of the depth, as a fraction of it, that marks an arrow
NEAREST = 1e-3  # mm; nearer points, and points behind the lens, are not in the frame


def moment_of(scene: Scene, index: int, time: float) -> Scene:
    """The scene with a single time sample in frame `index`, at which the ground truth is computed; time: s from t = 0.

    The time is clamped to the frame's interval and exposure together. The flow is the motion over one interval.

    The shutter opens at the start of the frame or at its own start, whichever is earlier. It is open for twice the time
    from there to the sample, which is therefore in the middle; this may exceed the interval, unlike in files.
    """
    sequence, interval = scene.sequence, scene.sequence.interval
    start = min(sequence.shutter_start, 0.0)
    last = max(shutter_span(sequence, 0)[1], interval)
    since = min(max(time - index * interval, start + LEAST_SHARE * interval), last) - start
    changes = {"shutter": 2.0 * since, "shutter_start": start, "shutter_curve": "box", "samples": 1}
    changes |= {"sampling": "midpoint"}
    return scene.model_copy(update={"sequence": scene.sequence.model_copy(update=changes)})


def eye_of(frame: Frame) -> Eye:
    """View of a frame; for a frame that is not of a stereo pair, the left view, which is the camera's."""
    return "right" if frame.eye == "right" else "left"


def exposure_of(frame: Frame, scene: Scene, samples: int) -> dict[str, Any]:
    """Data of the time line for a frame; samples: number of its time samples.

    Returns `times` of the samples, and `shutter`, its opening and closing time, s; and `arrows`: for each object that
    moves, column and row of its origin at opening and at closing, px, and by how much it has come nearer, mm.
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
        before, after = points[:, 2]
        nearer = float(before - after) if abs(before - after) >= LEAST_APPROACH * before else 0.0
        if nearer or np.hypot(arrow[2] - arrow[0], arrow[3] - arrow[1]) >= SHORTEST_PX:
            found.append([*arrow, nearer])
    return found
