"""Dragging of objects in the picture: converts pixels to the key of an object's position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.optics.exposure import middle_time
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import Eye, eye_pose, static_rotation
from clsco.scene.model import Camera, Plane
from clsco.studio.preview import MEASURE, OVERVIEW, Preview
from clsco.studio.session import Document

# By shape, the key of an object's position, "" for none; all other shapes have the key `center`.
PLACES = {"cone": "apex", "plane": "distance", "depth_map": "", "background": ""}
STEEPEST = 1e-3  # least z of a plane's normal; a steeper plane can be moved only along z
ALONG = 500.0  # px of a move along z that changes the depth by a factor of e
_DIGITS = 4  # decimal places of mm: less than a thousandth of a pixel


@dataclass(frozen=True)
class Grip:
    """An object held by the pointer."""

    path: str  # path of the key of its position, such as "object.0.center"
    start: tuple[float, ...]  # value of the key before the drag, mm; one number for a plane
    normal: NDArray[np.float64]  # normal of a plane, with z = 1; (0, 0, 1) for other shapes
    depth: float  # depth of the point that is held, mm
    axes: NDArray[np.float64]  # rotation from the camera, at the middle of the exposure, to the scene

    def value(self, camera: Camera, across: float, down: float, is_along: bool) -> float | list[float]:
        """Value of the key in mm after a drag by `across` px to the right and `down` px downwards in the frame.

        The object moves at constant depth, and the held point stays under the pointer: x = s0 X / Z (thesis, 2.4). If
        `is_along` is True, the object moves along z; a drag by ALONG px upwards multiplies the depth by e.
        """
        if is_along:
            by = np.array([0.0, 0.0, self.depth * math.expm1(-down / ALONG)])
        else:
            by = np.array([across, -down, 0.0]) * (self.depth * ray_step(camera))
        by = self.axes @ by
        if len(self.start) == 1:  # where the plane, moved as a whole, meets the axis
            return round(self.start[0] + float(self.normal @ by), _DIGITS)
        return [round(old + float(new), _DIGITS) for old, new in zip(self.start, by, strict=True)]


def grip(session: Document, index: int, object_id: int, depth: float, eye: Eye = "left") -> Grip:
    """Begin to drag an object; object_id: its number in frames; depth: depth of the point that is held, mm.

    Raises SceneError if there is no such object, or its shape has no position.
    """
    entries = session.object_entries
    if not 0 <= object_id < len(entries):
        raise SceneError("move: there must be an object; got none")
    scene, number = session.scene, entries[object_id]
    surface, shape = scene.objects[object_id], session.table["object"][number]["shape"]
    if not (key := PLACES.get(shape, "center")):
        raise SceneError(f"move: must be an object with a place of its own; got a {shape.replace('_', ' ')}")
    path = f"object.{number}.{key}"
    known = session.known(path)
    start = known if isinstance(known, list) else [known]
    normal, axes = np.array([0.0, 0.0, 1.0]), np.eye(3)
    if isinstance(surface, Plane):
        tilted = static_rotation(surface) @ np.array([-surface.slope_x, -surface.slope_y, 1.0])
        normal = tilted / tilted[2] if abs(tilted[2]) > STEEPEST else normal
    if scene.moves or scene.stereo is not None:
        axes = eye_pose(scene, eye, middle_time(scene.sequence, index)).rotation
    return Grip(path, tuple(map(float, start)), normal, depth, axes)


MOST_PX = 1e6  # largest length of a drag


class Pointer:
    """The pointer of a tab, which asks the preview for the surface at a pixel."""

    def __init__(self, session: Document, preview: Preview) -> None:
        self._session, self._preview = session, preview
        self._held: tuple[int, Grip, Camera] | None = None  # drag, object, and camera at its start

    def ask(self, x: int, y: int, purpose: str = "") -> None:
        """Send the figures of a pixel (-1: the point in focus), the response of its source, or an overview."""
        name = {MEASURE: "measured", OVERVIEW: "overview"}.get(purpose, "inspected")

        async def report(found: dict[str, Any]) -> None:
            await self._preview.tell(**{name: found})
            if purpose == OVERVIEW:
                self._session.note_ends(found["ends"])

        self._preview.inspect(x, y, report, purpose)

    def focus(self, x: int, y: int, drag: int) -> None:
        """Focus on the surface at a pixel; calls with the same `drag` are one undo step."""

        async def focus(found: dict[str, Any]) -> None:
            depth = found["values"]["depth"]
            if depth is None:
                await self._preview.tell(error=["focus: there must be a surface; got none"])
            else:
                self._session.patch("camera.focus_distance", depth, drag)

        self._preview.inspect(x, y, focus, "focus")

    def grab(self, x: int, y: int, drag: int) -> None:
        """Begin to drag the object at a pixel, and send its name."""

        async def take(found: dict[str, Any]) -> None:
            values = found["values"]
            try:
                scene, depth = self._session.scene, math.inf if values["depth"] is None else values["depth"]
                held = grip(self._session, found["index"], values["object_id"], depth, found["eye"])
                self._held = drag, held, camera_at(scene, middle_time(scene.sequence, found["index"]))
            except SceneError as error:
                self._held = None
                await self._preview.tell(error=error.messages, grabbed={"drag": drag, "name": None})
            else:
                await self._preview.tell(grabbed={"drag": drag, "name": values["object"]})

        self._preview.inspect(x, y, take, "grab")

    def pull(self, across: float, down: float, is_along: bool, drag: int) -> None:
        """Move the dragged object as by `Grip.value`. A whole drag is one undo step; other drags are ignored."""
        if self._held is not None and self._held[0] == drag and max(abs(across), abs(down)) <= MOST_PX:
            _, held, camera = self._held
            self._session.patch(held.path, held.value(camera, across, down, is_along), drag)
