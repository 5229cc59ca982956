"""Host side of a frame's exposure, which adds up the blurred planes of its time samples."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import SUMMED_PIXELS
from clsco.opencl.buffers import copied, empty
from clsco.opencl.program import Events, Target
from clsco.opencl.session import Session
from clsco.passes.blur import BLOCKS, Plane
from clsco.plan.buffers import Sizes


class FrameSum:
    """Weighted sum of the planes of a frame or a strip; a plane has a weight per row, or with `by_columns` per column.

    sizes: sizes from `clsco.plan.buffers.sum_buffers`. Validated against sums by NumPy
    (tests/kernels/test_accumulate.py).
    """

    def __init__(self, session: Session, sizes: Sizes, by_columns: bool = False) -> None:
        self.target = Target(session, ["blur/accumulate.cl"], {"SCAN_COLUMNS": by_columns}, "float")
        self.local = (1, 1) if session.device.kind == "cpu" else BLOCKS  # PoCL compiles (1, 1) three times as fast
        self.sum, self.lost = (empty(session, sizes[name]) for name in ("sum", "lost"))
        self.begins = True

    def clear(self) -> None:
        """Begin a new frame or strip with a sum of 0."""
        self.begins = True

    def add(
        self, plane: Plane, weights: NDArray[np.floating], events: Events, top: int = 0, rows: int | None = None
    ) -> Plane:
        """Add a plane to the sum, and return the sum so far.

        weights: weight of each row or column of the plane; top: row of the sum to which the plane's first row is added;
        rows: number of rows of the sum, by default that of the plane.
        """
        height, columns, channels = rows or plane.rows, plane.columns, plane.shape[0]
        if self.begins and plane.rows < height:
            for buffer in (self.sum, self.lost):
                cl.enqueue_fill_buffer(self.target.session.queue, buffer, np.zeros(1, np.uint32), 0, buffer.size)
            self.begins = False
        head = (np.int32(n) for n in (self.begins, plane.rows, columns, channels))
        line_weights = copied(self.target.session, weights.astype(np.float32))  # faster than a command in the queue
        args = (*head, *plane.layout, line_weights, np.int32(top), np.int32(height), self.sum, self.lost)
        self.begins = False
        self.target.run("accumulate", (-(-columns // SUMMED_PIXELS), plane.rows), self.local, events, *args)
        return Plane(self.sum, (channels, height, columns), height, columns)
