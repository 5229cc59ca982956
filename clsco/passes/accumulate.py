"""Exposure of a frame: adds up the blurred planes of its time samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.constants import SUMMED_PIXELS
from clsco.opencl.buffers import copied, empty
from clsco.opencl.program import build
from clsco.opencl.session import Session
from clsco.passes.blur import BLOCKS, PLAIN, Events, Plane, Target
from clsco.plan.buffers import Sizes
from clsco.records import structs

FEATURES = PLAIN | {"SAMPLED": 0, "GENERAL": 0, "CHANNELS": 0}


class FrameSum:
    """A frame, or a strip of it, as the sum of planes, each with one weight for each row.

    Parameters
    ----------
    session : Session
    sizes : dict
        Sizes of the buffers, by `clsco.plan.buffers.sum_buffers`.

    Notes
    -----
    Validated against `clsco.reference.blur.accumulate`.
    """

    def __init__(self, session: Session, sizes: Sizes) -> None:
        program = build(session, ["blur/accumulate.cl"], FEATURES, structs("float"), "float")
        self.target = Target(session, program, "float")
        self.local = (1, 1) if session.device.kind == "cpu" else BLOCKS  # there PoCL compiles it in a third of the time
        self.sum, self.lost = (empty(session, sizes[name]) for name in ("sum", "lost"))
        self.begins = True

    def clear(self) -> None:
        """Begin a frame, or a strip of it."""
        self.begins = True

    def add(self, plane: Plane, weights: NDArray[np.floating], events: Events) -> Plane:
        """Add a plane with weights (rows,); the sum so far."""
        rows, columns, channels = plane.rows, plane.columns, plane.shape[0]
        head = (np.int32(n) for n in (self.begins, rows, columns, channels))
        given = copied(self.target.session, weights.astype(np.float32))  # sooner than by a command in the queue
        args = (*head, *plane.layout, given, self.sum, self.lost)
        self.begins = False
        self.target.run("accumulate", (-(-columns // SUMMED_PIXELS), rows), self.local, events, *args)
        return Plane(self.sum, (channels, rows, columns), rows, columns)
