"""Host side of the blur of sources that all have one radius: buffers and launches of convolve.cl."""

from __future__ import annotations

from math import floor, log2

import numpy as np
import pyopencl as cl

from clsco.constants import CONVOLVED_COLUMNS, CONVOLVED_ROWS, DROPPED_BITS, TILES_ABREAST
from clsco.frame.strips import Grid
from clsco.opencl.buffers import Refilled, empty
from clsco.opencl.program import Events, Target
from clsco.optics.stencil import Stencil, stencils
from clsco.passes.blur import BlurredPlane, Sources
from clsco.plan.buffers import SUMS_BEYOND, Sizes
from clsco.plan.methods import BlurSpec
from clsco.records import Struct

BITS = 56  # bits of a sum over a disc
# Sums without DROPPED_BITS lose less than a unit per row of a disc: at most (2 R + 1) 2^-29 of the brightest source,
# 2e-7 at R = 60, and 1e-8 RMS. If the radiance exceeds BRIGHTEST times white, sums have 64 bits, so that the loss does
# not affect darker pixels nearby.
BRIGHTEST = 4.0

Layout = tuple[cl.Buffer | None, int, int, int]  # buffer, offset of a plane, offset in it of pixel (0, 0), pitch


class Convolve(BlurredPlane):
    """The blur of sources that all have one radius, up to `spec.largest`; `target` needs no kernels.

    Validated against sums over rectangles (tests/kernels/test_convolve.py).
    """

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid, grid: Struct, sizes: Sizes) -> None:
        session, self.wide = target.session, spec.brightest > BRIGHTEST
        super().__init__(target, spec, tallest, grid, sizes)
        self.own = Target(session, ["blur/convolve.cl"], {"WIDE_SUMS": self.wide}, "float")
        self.across = empty(session, sizes["across"]) if "across" in sizes else None
        self.sums: cl.Buffer | None = None
        if "sums" in sizes:
            self.sums = empty(session, sizes["sums"])
            unit = 8 if self.wide else 4
            end = unit * (sizes["sums"] // 8 - SUMS_BEYOND)
            cl.enqueue_fill_buffer(session.queue, self.sums, np.zeros(1, np.uint32), end, unit * SUMS_BEYOND)
        arrays = [name for name in sizes if name[-1].isdecimal()]
        self.stencils = {name: Refilled(session, sizes[name]) for name in arrays}

    def clear(self) -> None:
        """Do nothing, because `add` overwrites the plane."""

    def add(self, sources: Sources, events: Events) -> None:
        names = ("columns", "rows", "width", "height", "above", "guard")
        columns, rows, width, height, above, guard = (int(self.grid[name]) for name in names)
        chain = stencils(self.spec.psf, sources.radius)
        tables = [self._tables(number, stencil) for number, stencil in enumerate(chain)]
        *first, last = zip(chain, tables, strict=True)
        for k in range(self.channels):
            source: Layout = (sources.value, k * width * height, above * width + guard, width)
            for across in first:
                line = -(-columns // CONVOLVED_COLUMNS) * CONVOLVED_COLUMNS
                rows_of = (sources.value, k * width * height, guard, width)
                self._convolve(across, (height, columns), rows_of, 0.0, (self.across, 0, line), events)
                source = (self.across, 0, above * line, line)
            unit = self._sum(last[0], (height, width), source, events) if last[0].rectangles else 0.0
            target = (self.total, k * rows * self.pitch + self.pad, self.pitch)
            self._convolve(last, (rows, columns), source, last[0].share * unit, target, events)

    def _tables(self, number: int, stencil: Stencil) -> list[cl.Buffer | None]:
        """Buffers of the runs, weights and pairs of stencil number `number` of a chain, None for an array that is
        empty. The arrays are copied to the buffers after the queued launches that read the previous ones.
        """
        arrays = {"runs": stencil.runs, "weights": stencil.weights, "pairs": stencil.pairs}
        return [self.stencils[f"{k} {number}"].fill(a) if a.size else None for k, a in arrays.items()]

    def _sum(self, stencil: Stencil, size: tuple[int, int], source: Layout, events: Events) -> float:
        """Enqueue the summed-area table of a plane; returns the radiance of one unit of the table."""
        scale = 2.0 ** floor(BITS - log2(stencil.area * max(self.spec.brightest, 1e-20)))
        shape, (value, start, *_) = tuple(map(np.int32, size)), source
        args = (*shape, value, np.int32(start), np.float32(scale), self.sums)
        self.own.run("sum_across", (size[0],), (1,), events, *args)
        self.own.run("sum_down", (-(-size[1] // CONVOLVED_COLUMNS),), (1,), events, *shape, self.sums)
        return (1.0 if self.wide else 2.0**DROPPED_BITS) / scale

    def _convolve(
        self, step: tuple[Stencil, list[cl.Buffer | None]], size: tuple[int, int], source: Layout, share: float,
        target: tuple[cl.Buffer | None, int, int], events: Events,
    ) -> None:  # fmt: skip
        """Enqueue a convolution. share: weight of sums over rectangles; target: buffer, offset of pixel 0, pitch."""
        stencil, (runs, weights, pairs) = step
        args = (
            *map(np.int32, size), source[0], *map(np.int32, source[1:]), runs, np.int32(len(stencil.runs)), weights,
            self.sums, pairs, np.int32(len(stencil.pairs)), np.float32(share),
            *map(np.int32, stencil.reach),
            target[0], *map(np.int32, target[1:]),
        )  # fmt: skip
        tiles = (TILES_ABREAST, -(-size[0] // CONVOLVED_ROWS), -(-size[1] // (TILES_ABREAST * CONVOLVED_COLUMNS)))
        self.own.run("convolve", tiles, (1, 1, 1), events, *args)
