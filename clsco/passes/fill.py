"""Filling of missing pixels of a warped image, sweep by sweep (4.3.5, chapter 5)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl

from clsco.inpainting.rules import MeanMedian, bits_of, score_of_sums, score_scale
from clsco.opencl.buffers import download, empty
from clsco.opencl.program import kernel, launch
from clsco.opencl.session import Program, Session
from clsco.passes.blur import Events
from clsco.records import WIDE_BYTES, Struct

COUNTERS = 5
SUMS, SCORED = 13, 128  # sums of score_mean_median, and columns per work-item there
LEFT, LEFT_INSIDE, FILLED, FILLED_INSIDE, DONE = range(COUNTERS)
CHUNK = 64  # pixels per work-item where it counts
LANES = 8  # pixels of a vector; score_mean_median may read so many beyond the end
ZERO = np.array(0, np.int32)
LISTED = (64,)  # local size of kernels with a work-item per source or per entry of a list
OWNERS = (1,)  # of those with few, large work-items
LINES = (8,)  # of those with a work-item per row, column, segment, chunk or vector
CHAPTER5 = MeanMedian()


class Filler:
    """Owns planes with missing pixels on one device, and fills them (4.3.5, chapter 5).

    program: with fill.cl; camera: camera_t, whose padded grid the planes have; features: of the program. value, w, coc,
    valid, status and object (None without SEVERAL) are as in fill.cl, for the caller to write
    before `fill`; indices are two buffers of ints per pixel that only `fill` itself needs.
    Raises DeviceError. Validated against `clsco.reference.inpainting.fill`.
    """

    def __init__(self, session: Session, program: Program, camera: Struct, features: dict[str, int]) -> None:
        self.session, self.program, self.camera = session, program, camera
        self.interpolates, self.smooths = bool(features["FILL_AIT"]), bool(features["FILL_MEAN_MEDIAN"])
        self.is_far, channels = bool(features["FILL_FAR"]), features["CHANNELS"]
        self.rows, self.columns = int(camera["height"]), int(camera["width"])
        self.lines, pixels = self.rows + self.columns, self.rows * self.columns
        self.value, self.w = empty(session, 4 * (channels * pixels + LANES)), empty(session, WIDE_BYTES * pixels)
        self.valid, self.status = empty(session, pixels + LANES), empty(session, pixels)
        self.coc = empty(session, WIDE_BYTES * pixels)
        tail = np.zeros(4 * LANES, np.uint8)  # read beyond the end, and used for nothing
        cl.enqueue_copy(session.queue, self.value, tail, dst_offset=4 * channels * pixels)
        cl.enqueue_copy(session.queue, self.valid, tail[:LANES], dst_offset=pixels)
        self.indices = empty(session, 4 * pixels), empty(session, 4 * pixels)
        self.spans, self.grown = empty(session, 8 * self.lines), empty(session, 8 * self.lines)
        self.counters = empty(session, 4 * COUNTERS)
        self.object = empty(session, pixels) if features["SEVERAL"] else None
        self.far: tuple[cl.Buffer, ...] = (empty(session, 4 * pixels),) if self.is_far else ()
        if self.smooths:
            self.scored = self.rows * -(-self.columns // SCORED)
            self.done, self.sums = empty(session, 4 * pixels), empty(session, 8 * SUMS * self.scored)
            self.other_value, self.other_w = empty(session, self.value.size), empty(session, self.w.size)

    def fill(self, surfaces: cl.Buffer, count: int, events: Events, brightest: float = 1.0) -> dict[str, int]:
        """Fill missing pixels sweep by sweep; returns the fields of `clsco.reference.inpainting.fill.FillReport`.

        surfaces: `count` of surface_t, where pixels may be missing with domain "surface"; brightest: what radiance is
        at most. Waits once per sweep.
        """
        cl.enqueue_fill_buffer(self.session.queue, self.counters, ZERO, 0, self.counters.size)
        source, left = self.indices
        placed = (self.camera, surfaces, np.int32(count), self.valid)
        found = self._mark(placed, source, events)
        wins = self._score(brightest, events) if self.smooths and found[LEFT] else 0
        sweeps = filled = first = 0
        most, least = CHAPTER5.minimum if self.smooths else 1, 0 if self.is_far else 1
        minimum = most
        while (self.interpolates or self.smooths) and found[LEFT]:
            self._sweep(source, found[LEFT], np.int32(wins), np.int32(minimum), events)
            found = self._settle(placed, source, left, found[LEFT], events)
            source, left = left, source
            if found[FILLED]:
                sweeps, minimum = sweeps + 1, most
                filled += found[FILLED_INSIDE]
                first = filled if sweeps == 1 else first
            elif minimum > least:
                minimum -= 1  # fewer neighbors will do where the filling would stall, and then nearer ones
            else:
                break
        if self.smooths and found[DONE]:
            self._smooth(found[DONE], events)
        return {
            "missing_pixels": filled + found[LEFT_INSIDE],
            "filled_pixels": filled,
            "unfilled_pixels": found[LEFT_INSIDE],
            "sweeps": sweeps,
            "filled_first_sweep": first,
        }

    def _mark(self, placed: tuple[Any, ...], source: cl.Buffer, events: Events) -> list[int]:
        """List all missing pixels."""
        chunks, head = (-(-self.columns // CHUNK), self.rows), (self.camera, self.valid)
        self._launch("find_spans", events, (self.lines,), LINES, *head, self.spans, self.grown)
        args = (*placed, self.spans, self.status, source, self.counters, *self._depths())
        self._launch("mark_missing", events, chunks, (1, *LINES), *args)
        return self._found()

    def _depths(self) -> tuple[cl.Buffer, ...]:
        """What the bound on the depth of neighbors is made from, and kept in."""
        return (self.w, *self.far) if self.is_far else ()

    def _sweep(self, source: cl.Buffer, count: int, wins: np.int32, minimum: np.int32, events: Events) -> None:
        """Fill what can be filled of a list of `count` missing pixels; wins: of the median, by count of neighbors."""
        seen = () if self.object is None else (self.object,)
        planes = (*self.far, self.valid, self.value, self.w, self.coc, self.status, *seen)
        head = (self.camera, source, np.int32(count))
        if self.interpolates:
            rule = (minimum,) if self.is_far else ()
            self._launch("fill_ait", events, (count,), LISTED, *head, *rule, *planes)
        else:
            vectors = (-(-count // LANES),)
            self._launch("fill_mean_median", events, vectors, LINES, *head, wins, minimum, *planes)

    def _settle(
        self, placed: tuple[Any, ...], source: cl.Buffer, left: cl.Buffer, count: int, events: Events
    ) -> list[int]:
        """End a sweep over the list `source`; lists in `left` what is missing now."""
        cl.enqueue_fill_buffer(self.session.queue, self.counters, ZERO, 0, 4 * DONE)
        lines = (self.spans, self.grown)
        args = (self.camera, source, np.int32(count), *lines, self.status, self.valid, left, self.counters)
        done = (self.done,) if self.smooths else ()
        self._launch("settle_sweep", events, (-(-count // CHUNK),), LINES, *args, *done)
        grown = (*placed, *lines, self.status, left, self.counters, *self._depths())
        self._launch("mark_grown", events, (self.lines,), LISTED, *grown)
        return self._found()

    def _score(self, brightest: float, events: Events) -> int:
        """For which counts of neighbors the median is the better estimator: bit k for k of them."""
        scale = score_scale(brightest)
        args = (self.camera, np.float32(scale), self.value, self.valid, self.sums)
        self._launch("score_mean_median", events, (self.scored,), OWNERS, *args)
        score = score_of_sums(download(self.session, self.sums, (self.scored, SUMS), np.int64), scale)
        return bits_of(score.median_wins())

    def _smooth(self, count: int, events: Events) -> None:
        """Rounds of the median over the filled pixels, to and fro between two sets of planes."""
        here, there = (self.value, self.w), (self.other_value, self.other_w)
        for source, target in zip(here, there, strict=True):
            cl.enqueue_copy(self.session.queue, target, source, byte_count=source.size)
        vectors, head = (-(-count // LANES),), (self.camera, self.done, np.int32(count), *self.far, self.valid)
        for _ in range(CHAPTER5.smoothing_rounds):  # an even number: the last one writes to the first set
            self._launch("smooth_median", events, vectors, LINES, *head, *here, *there, self.coc)
            here, there = there, here

    def _found(self) -> list[int]:
        found: list[int] = download(self.session, self.counters, (COUNTERS,), np.int32).tolist()
        return found

    def _launch(self, name: str, events: Events, size: tuple[int, ...], local: tuple[int, ...], *args: Any) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))
