"""Joins separately blurred colors into one plane."""

from __future__ import annotations

import pyopencl as cl

from clsco.frame.frame import GREEN
from clsco.opencl.buffers import empty
from clsco.opencl.program import Events
from clsco.opencl.session import Session
from clsco.passes.blur import Plane

FLOAT = 4  # size in bytes


class JoinedColors:
    """A plane with all color channels, and a last channel of coverage if `channels` exceeds `colors`."""

    def __init__(self, session: Session, channels: int, colors: int) -> None:
        self.session, self.channels, self.colors = session, channels, colors
        self.buffer = empty(session, FLOAT)

    def put(self, plane: Plane, color: int, events: Events) -> Plane:
        """Copy the plane of one color to its channel; returns the joined plane so far. Coverage is that of green."""
        rows, columns = plane.rows, plane.columns
        size = FLOAT * self.channels * rows * columns
        if self.buffer.size < size:
            self.buffer = empty(self.session, size)
        self._copy(plane, 0, color, events)
        if self.channels > self.colors and color == GREEN:
            self._copy(plane, 1, self.colors, events)
        return Plane(self.buffer, (self.channels, rows, columns), rows, columns)

    def _copy(self, plane: Plane, channel: int, to: int, events: Events) -> None:
        _, height, pitch = plane.shape
        event = cl.enqueue_copy(
            self.session.queue, self.buffer, plane.buffer,
            src_origin=(FLOAT * plane.left, channel * height + plane.top, 0), dst_origin=(0, to * plane.rows, 0),
            region=(FLOAT * plane.columns, plane.rows, 1), src_pitches=(FLOAT * pitch, 0),
            dst_pitches=(FLOAT * plane.columns, 0),
        )  # fmt: skip
        events.append(("join colors", event))
