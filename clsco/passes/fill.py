"""Host side of the filling of missing pixels of a warped image, sweep by sweep (thesis, 4.3.5 and chapter 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl

from clsco.constants import (
    COUNTER_DONE,
    COUNTER_FILLED,
    COUNTER_FILLED_INSIDE,
    COUNTER_LEFT,
    COUNTER_LEFT_INSIDE,
    FILL_CHUNK,
    FILL_LANES,
    SCORE_SUMS,
    SCORED_COLUMNS,
)
from clsco.inpainting.rules import MeanMedian, bits_of, score_of_sums, score_scale
from clsco.opencl.buffers import allocate, download
from clsco.opencl.program import Events, Target
from clsco.opencl.session import Session
from clsco.plan.buffers import COUNTERS, Sizes
from clsco.records import Struct

ZERO = np.array(0, np.int32)
LISTED = (64,)  # local size of kernels with a work-item per source or per entry of a list
OWNERS = (1,)  # local size of kernels with few, large work-items
LINES = (8,)  # local size of kernels with a work-item per row, column, segment, chunk or vector
CHAPTER5 = MeanMedian()


@dataclass(kw_only=True)
class FillPlanes:
    """Buffers of fill.cl, with guard band; before the filling, the caller writes the first six, `value` to `object`.

    value: float (CHANNELS, height, width), radiance. w, coc: real, inverse depth in 1/mm and signed R in px. valid:
    uchar, 1 for known or filled pixels, 0 for others, whose value, w and coc are 0. status: uchar, 0 known or not
    missing, 1 filled, 2 missing and not filled. object: uchar, number of the visible object, 255 for none and in the
    mirror image around a depth map; None if the scene has a single object.

    indices: lists of missing pixels before and after a sweep, an int per pixel; used only during the filling. spans,
    grown: first and last valid pixel of each line, before and after a sweep. counters: numbers of pixels, see
    COUNTER_LEFT. far: bounds on the depth of neighbors; None unless holes are filled from the far side. done, sums,
    other_value, other_w: buffers of mean/median filling, else None.
    """

    value: cl.Buffer
    w: cl.Buffer
    coc: cl.Buffer
    valid: cl.Buffer
    status: cl.Buffer
    object: cl.Buffer | None = None
    indices: tuple[cl.Buffer, cl.Buffer]
    spans: cl.Buffer
    grown: cl.Buffer
    counters: cl.Buffer
    far: Any = None
    done: Any = None
    sums: Any = None
    other_value: Any = None
    other_w: Any = None

    @classmethod
    def create(cls, session: Session, sizes: Sizes) -> FillPlanes:
        """Allocate buffers of the sizes from `clsco.plan.buffers.fill_buffers`. Raises DeviceError."""
        buffers = allocate(session, sizes)
        for name, bytes_of_lane in (("value", 4), ("valid", 1)):  # vectors read beyond the end without effect
            tail = bytes_of_lane * FILL_LANES
            cl.enqueue_copy(session.queue, buffers[name], np.zeros(tail, np.uint8), dst_offset=sizes[name] - tail)
        indices = buffers.pop("list"), buffers.pop("next list")
        fields = {name.replace(" ", "_"): buffer for name, buffer in buffers.items()}
        return cls(indices=indices, **fields)


class Filler:
    """Fills missing pixels of planes on one device (4.3.5, chapter 5).

    target: has the kernels of fill.cl and, for mean/median filling, of score.cl and fill_mean_median.cl, in a program
    built for `features`; lens: determines the radii of filled pixels; sizes: sizes from
    `clsco.plan.buffers.fill_buffers`. Validated against `clsco.reference.inpainting.fill`.
    """

    def __init__(self, target: Target, grid: Struct, lens: Struct, features: Mapping[str, int], sizes: Sizes) -> None:
        self.target, self.session, self.grid, self.lens = target, target.session, grid, lens
        self.interpolates, self.smooths = bool(features["FILL_AIT"]), bool(features["FILL_MEAN_MEDIAN"])
        self.fills = self.interpolates or self.smooths
        self.is_far = bool(features["FILL_FAR"])
        self.rows, self.columns = int(grid["height"]), int(grid["width"])
        self.planes = FillPlanes.create(self.session, sizes)

    def fill(self, surfaces: cl.Buffer, count: int, events: Events, brightest: float = 1.0) -> dict[str, int]:
        """Fill missing pixels sweep by sweep; returns the fields of `clsco.reference.inpainting.fill.FillReport`.

        surfaces: buffer of `count` surface_t; with domain "surface", only pixels whose rays hit one of these surfaces
        are filled. brightest: largest radiance. Waits for the device once per sweep.
        """
        cl.enqueue_fill_buffer(self.session.queue, self.planes.counters, ZERO, 0, self.planes.counters.size)
        source, remaining = self.planes.indices
        placed = (self.grid, surfaces, np.int32(count), self.planes.valid)
        counts = self._mark(placed, source, events)
        wins = self._score(brightest, events) if self.smooths and counts[COUNTER_LEFT] else 0
        sweeps = filled = first = 0
        most, least = CHAPTER5.minimum if self.smooths else 1, 0 if self.is_far else 1
        minimum = most
        while self.fills and counts[COUNTER_LEFT]:
            self._sweep(source, counts[COUNTER_LEFT], np.int32(wins), np.int32(minimum), events)
            counts = self._settle(placed, source, remaining, counts[COUNTER_LEFT], events)
            source, remaining = remaining, source
            if counts[COUNTER_FILLED]:
                sweeps, minimum = sweeps + 1, most
                filled += counts[COUNTER_FILLED_INSIDE]
                first = filled if sweeps == 1 else first
            elif minimum > least:
                minimum -= 1  # after a sweep that fills nothing, fewer known neighbors suffice; 0 allows the near side
            else:
                break
        if self.smooths and counts[COUNTER_DONE]:
            self._smooth(counts[COUNTER_DONE], events)
        return {
            "missing_pixels": filled + counts[COUNTER_LEFT_INSIDE],
            "filled_pixels": filled,
            "unfilled_pixels": counts[COUNTER_LEFT_INSIDE],
            "sweeps": sweeps,
            "filled_first_sweep": first,
        }

    def _mark(self, placed: tuple[Any, ...], source: cl.Buffer, events: Events) -> list[int]:
        """List all missing pixels on the device; returns the counters."""
        p, lines, chunks = self.planes, (self.rows + self.columns,), (-(-self.columns // FILL_CHUNK), self.rows)
        self.target.run("find_spans", lines, LINES, events, self.grid, p.valid, p.spans, p.grown)
        args = (*placed, p.spans, p.status, source, p.counters, p.w, p.far)
        self.target.run("mark_missing", chunks, (1, *LINES), events, *args)
        return self._read_counters()

    def _sweep(self, source: cl.Buffer, count: int, wins: np.int32, minimum: np.int32, events: Events) -> None:
        """Fill those of `count` missing pixels, listed in `source`, that have at least `minimum` known neighbors."""
        p = self.planes
        planes = (minimum, p.far, p.valid, p.value, p.w, p.coc, p.status, p.object)
        head = (self.grid, self.lens, source, np.int32(count))
        if self.interpolates:
            self.target.run("fill_ait", (count,), LISTED, events, *head, *planes)
        else:
            vectors = (-(-count // FILL_LANES),)
            self.target.run("fill_mean_median", vectors, LINES, events, *head, wins, *planes)

    def _settle(
        self, placed: tuple[Any, ...], source: cl.Buffer, remaining: cl.Buffer, count: int, events: Events
    ) -> list[int]:
        """End a sweep over the list `source`: list the pixels still missing in `remaining`; returns the counters."""
        p = self.planes
        cl.enqueue_fill_buffer(self.session.queue, p.counters, ZERO, 0, 4 * COUNTER_DONE)
        lines = (p.spans, p.grown)
        args = (self.grid, source, np.int32(count), *lines, p.status, p.valid, remaining, p.counters, p.done)
        self.target.run("settle_sweep", (count,), LISTED, events, *args)
        grown = (*placed, *lines, p.status, remaining, p.counters, p.w, p.far)
        self.target.run("mark_grown", (self.rows + self.columns,), LISTED, events, *grown)
        return self._read_counters()

    def _score(self, brightest: float, events: Events) -> int:
        """Integer whose bit k is set if the median is better than the mean for pixels with k known neighbors."""
        scale, scored = score_scale(brightest), self.rows * -(-self.columns // SCORED_COLUMNS)
        args = (self.grid, np.float32(scale), self.planes.value, self.planes.valid, self.planes.sums)
        self.target.run("score_mean_median", (scored,), OWNERS, events, *args)
        score = score_of_sums(download(self.session, self.planes.sums, (scored, SCORE_SUMS), np.int64), scale)
        return bits_of(score.median_wins())

    def _smooth(self, count: int, events: Events) -> None:
        """Smooth the `count` filled pixels by rounds of the median, which alternately write to two sets of planes."""
        p = self.planes
        current, next_ = (p.value, p.w), (p.other_value, p.other_w)
        for source, target in zip(current, next_, strict=True):
            cl.enqueue_copy(self.session.queue, target, source, byte_count=source.size)
        vectors, head = (-(-count // FILL_LANES),), (self.grid, self.lens, p.done, np.int32(count), p.far, p.valid)
        for _ in range(CHAPTER5.smoothing_rounds):  # an even number: the last one writes to the first set
            self.target.run("smooth_median", vectors, LINES, events, *head, *current, *next_, p.coc)
            current, next_ = next_, current

    def _read_counters(self) -> list[int]:
        counts: list[int] = download(self.session, self.planes.counters, (COUNTERS,), np.int32).tolist()
        return counts
