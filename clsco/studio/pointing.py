"""Uses of the pointer in the picture of a tab: ask, measure, focus, and drag objects."""

from __future__ import annotations

import math
from typing import Any

from clsco.errors import SceneError
from clsco.optics.exposure import middle_time
from clsco.optics.lens_path import camera_at
from clsco.scene.model import Camera
from clsco.studio.moving import Grip, grip
from clsco.studio.preview import MEASURE, Preview
from clsco.studio.session import Document

MOST_PX = 1e6  # of a drag


class Pointer:
    """The pointer of a tab.

    Parameters
    ----------
    session : Document
    preview : Preview
        Knows the surface at a pixel.
    """

    def __init__(self, session: Document, preview: Preview) -> None:
        self._session, self._preview = session, preview
        self._held: tuple[int, Grip, Camera] | None = None  # by the drag of this number

    def ask(self, x: int, y: int) -> None:
        """Report the figures of a pixel."""

        async def report(found: dict[str, Any]) -> None:
            await self._preview.tell(inspected=found)

        self._preview.inspect(x, y, report)

    def measure(self, x: int, y: int) -> None:
        """Report the response of a pixel's source."""

        async def report(found: dict[str, Any]) -> None:
            await self._preview.tell(measured=found)

        self._preview.inspect(x, y, report, MEASURE)

    def focus(self, x: int, y: int, drag: int) -> None:
        """Focus on the surface at a pixel, as one step of undo."""

        async def focus(found: dict[str, Any]) -> None:
            depth = found["values"]["depth"]
            if depth is None:
                await self._preview.tell(error=["focus: there must be a surface; got none"])
            else:
                self._session.patch("camera.focus_distance", depth, drag)

        self._preview.inspect(x, y, focus, "focus")

    def grab(self, x: int, y: int, drag: int) -> None:
        """Take hold of the object at a pixel, and report its name."""

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
        """Move the object that a drag holds so many pixels from where it was; all of it is one step of undo."""
        if self._held is not None and self._held[0] == drag and max(abs(across), abs(down)) <= MOST_PX:
            _, held, camera = self._held
            value = held.value(camera, across, down, is_along)
            self._session.patch(held.path, value, drag)
