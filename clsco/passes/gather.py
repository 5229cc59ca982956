"""The method "gather" of blur, for processors: bands of rows gather all sources that reach them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl

from clsco.constants import BAND, COLUMN_STEP, WIDE_LANES
from clsco.frame.strips import Grid
from clsco.opencl import pace
from clsco.opencl.buffers import download_into, empty, filled_with, upload_cached
from clsco.opencl.program import Events, Target, launch_whole
from clsco.passes.blur import UNITS_PER_TAP, TableBlur
from clsco.plan.buffers import MOST_IN_ONE_SUM, Sizes, bands_at_a_time
from clsco.plan.methods import BlurSpec
from clsco.records import Struct

HIDDEN_TAP = 3e-9  # assumed time in s of a tap of a partly hidden source, including sub-pixel sources
LONGEST = 2.0  # longest time in s, at HIDDEN_TAP per tap, of a launch that is not cut into pieces
VECTOR = 1.5e-9  # assumed time in s of a vector of taps, until its time is measured
BRIEF = 2  # factor by which the first piece is planned shorter than later pieces
MOST_VECTORS, OTHERS, DONE = 2**30, 2**30, 2**31 - 1  # OTHERS and DONE as in gather.cl
INT2 = cl.cltypes.int2


class Gather(TableBlur):
    """Method "gather": each work-item gathers the sources that reach its band of rows. If bands need memory of their
    own, few of them are processed at a time.
    """

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid, grid: Struct, sizes: Sizes) -> None:
        super().__init__(target, spec, tallest, grid, sizes)
        session, table = target.session, self.weights[0]
        arrays = {"taps": table.taps, "outlines": table.outlines}
        self.tap_tables = tuple(
            upload_cached(session, array, (table.place, name)) if array.size else None for name, array in arrays.items()
        )
        # Number of rows of sources after which partial sums are added to the total; 0 without partial sums.
        self.group = max(MOST_IN_ONE_SUM // (2 * spec.reach + 1), 1) if "part" in sizes else 0
        self.part = filled_with(session, sizes["part"]) if "part" in sizes else self.total
        self.bands = -(-tallest.rows // BAND)
        if {"part", "scratch"} & sizes.keys():
            self.bands = bands_at_a_time(tallest.rows, session.device.compute_units)
        self.scratch, self.ends = (
            filled_with(session, sizes[name]) if name in sizes else None for name in ("scratch", "ends")
        )
        self.scratch_size = np.int32(sizes.get("scratch", 0) // 8 // self.bands)  # doubles of a band
        self.step = tallest.columns if self.scratch is None else COLUMN_STEP  # least number of columns in a piece
        self.position = empty(session, sizes["position"])

    def spread(self, head: tuple[object, ...], tail: tuple[object, ...], events: Events) -> None:
        session, run = self.target.session, self.target["gather"]
        rows, width, height = (int(self.grid[name]) for name in ("rows", "width", "height"))
        walked = min(BAND + 2 * self.spec.reach, height)
        taps = self.bands * walked * width * (2 * self.spec.reach + 1) ** 2
        work, most = UNITS_PER_TAP * taps, HIDDEN_TAP * taps / session.device.compute_units
        parts = np.int32(self.group), self.part, self.ends
        for start in range(0, -(-rows // BAND), self.bands):
            before = (*head, *self.tap_tables, self.scratch, self.scratch_size, np.int32(start))
            after = (self.position, *parts, *self.layout, *tail)
            expected = session.pace.expected(run, work)
            if expected <= pace.PIECE and (not self.spec.occluders or most <= LONGEST):
                pieces = [self._launch(before, 0, 0, after)]
                session.pace.record_launch(run, work, pieces, expected)
            else:
                pieces = self._in_pieces(before, after, min(self.bands, -(-rows // BAND) - start))
                session.pace.record_time(run, work, sum(map(pace.event_seconds, pieces)))
            events.extend(("gather", event) for event in pieces)

    def _launch(self, before: tuple[Any, ...], steps: int, vectors: int, after: tuple[Any, ...]) -> cl.Event:
        budget = np.array((steps, vectors), INT2)[()]
        run = self.target["gather"]
        return launch_whole(self.target.session, run, (self.bands,), (1,), *before, budget, *after)

    def _in_pieces(self, before: tuple[Any, ...], after: tuple[Any, ...], bands: int) -> list[cl.Event]:
        """Launch pieces that process a few steps or vectors of each band, and wait for them; returns their events.

        The time of each piece determines the size of the next one, as the cost of occlusion is not known in advance.
        """
        session, columns = self.target.session, int(self.grid["columns"])
        at_once = -(-bands // session.device.compute_units)  # number of bands that a core processes in sequence
        steps, vectors = 1, max(1, int(pace.PIECE / BRIEF / VECTOR / at_once))
        walked = np.zeros(self.bands, np.int32)
        all_steps = 0 if self.scratch is None else -(-columns // self.step)
        band_steps = all_steps + (BAND + 2 * self.spec.reach) * -(-int(self.grid["width"]) // WIDE_LANES)
        cl.enqueue_copy(session.queue, self.position, walked)
        pieces: list[cl.Event] = []
        while (walked[:bands] != DONE).any():
            least = int((walked[:bands] % OTHERS).min())
            session.go_on()
            pieces.append(self._launch(before, steps, vectors, after))
            download_into(session, self.position, walked)
            if least * self.step < columns:
                steps = pace.next_size(steps, pace.event_seconds(pieces[-1]))
            else:
                vectors = min(pace.next_size(vectors, pace.event_seconds(pieces[-1])), MOST_VECTORS)
            if session.progress is not None:
                session.progress.share = float(np.minimum(walked[:bands] % OTHERS / band_steps, 1.0).mean())
        return pieces
