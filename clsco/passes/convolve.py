"""Blur with one radius: buffers and launches of convolve.cl."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor, log2

import numpy as np
import pyopencl as cl

from clsco.opencl.buffers import empty, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.optics.stencil import Stencil, stencils
from clsco.plan.memory import SUMS_BEYOND
from clsco.records import Struct, structs
from clsco.scene.model import Psf

Events = list[tuple[str, cl.Event]]

SHAPES = ("SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED")
FEATURES = dict.fromkeys((*SHAPES, "FILTER", "SAMPLED", "GENERAL", "CHANNELS"), 0)
CONVOLVED, TILES_ABREAST = (
    (32, 64),
    8,
)  # rows and columns of a work-item; so many are made side by side before those below
BITS, LOWER_BITS = 56, 26  # of a sum over a disc, and those of them that sums of 32 bits leave out
# What they leave out is less than a unit of each row of a disc: (2 R + 1) 2^-29 of the brightest light at most, 2e-7 at
# R = 60, and 1e-8 RMS. With light brighter than so many times white, sums of 64 bits keep that from what is beside it.
BRIGHTEST = 4.0


class Convolution:
    """Adds frames that are blurred with one radius to a frame; owns what they need besides value and total.

    brightest: largest |light| of a pixel; sizes: of its buffers in bytes, see `clsco.plan.memory.spread_bytes`.
    """

    def __init__(self, session: Session, psf: Psf, channels: int, brightest: float, sizes: Mapping[str, int]) -> None:
        self.session, self.psf, self.channels = session, psf, channels
        self.wide, self.brightest = brightest > BRIGHTEST, max(brightest, 1e-20)
        self.program = build(
            session, ["blur/convolve.cl"], FEATURES | {"WIDE_SUMS": self.wide}, structs("float"), "float"
        )
        self.sums, self.across = (empty(session, sizes.get(name, 0)) for name in ("sums", "across"))
        if "sums" in sizes:
            unit = 8 if self.wide else 4
            end = unit * (sizes["sums"] // 8 - SUMS_BEYOND)
            cl.enqueue_fill_buffer(session.queue, self.sums, np.zeros(1, np.uint32), end, unit * SUMS_BEYOND)
        self.fresh = True  # nothing has been added to the frame yet: what is there does not count
        # Tables that queued launches still read: the host runs ahead of the device.
        self.held: list[tuple[cl.Buffer, ...]] = []

    def add(
        self, camera: Struct, value: cl.Buffer, radius: float, total: cl.Buffer, pitch: int, pad: int, events: Events
    ) -> None:
        """Add value (channels, height, width), blurred by |R| = radius px, to total (channels, rows, pitch)."""
        rows, columns, width, height, above, guard = (
            int(camera[name]) for name in ("rows", "columns", "width", "height", "above", "guard")
        )
        *first, last = stencils(self.psf, radius)
        for k in range(self.channels):
            source = (value, k * width * height, above * width + guard, width)
            for stencil in first:
                line = -(-columns // CONVOLVED[1]) * CONVOLVED[1]
                grid = (value, k * width * height, guard, width)
                self._convolve(stencil, (height, columns), grid, 0.0, (self.across, 0, line), True, events)
                source = (self.across, 0, above * line, line)
            unit = self._sum(last, (height, width), source, events) if last.rectangles else 0.0
            target = (total, k * rows * pitch + pad, pitch)
            self._convolve(last, (rows, columns), source, last.share * unit, target, self.fresh, events)
        self.fresh = False

    def _sum(
        self, stencil: Stencil, size: tuple[int, int], source: tuple[cl.Buffer, int, int, int], events: Events
    ) -> float:
        """Make the sums of a plane; the light of a unit of them."""
        scale = 2.0 ** floor(BITS - log2(stencil.area * self.brightest))
        shape, (value, start, *_) = tuple(map(np.int32, size)), source
        args = (*shape, value, np.int32(start), np.float32(scale), self.sums)
        self._launch("sum_across", (size[0],), events, *args)
        self._launch("sum_down", (-(-size[1] // CONVOLVED[1]),), events, *shape, self.sums)
        return (1.0 if self.wide else 2.0**LOWER_BITS) / scale

    def _convolve(
        self, stencil: Stencil, size: tuple[int, int], source: tuple[cl.Buffer, int, int, int], share: float,
        target: tuple[cl.Buffer, int, int], fresh: bool, events: Events,
    ) -> None:  # fmt: skip
        """One launch; source: buffer, its plane, pixel (0, 0) there, pitch; target: buffer, pixel (0, 0), pitch."""
        tables = tuple(upload(self.session, array) for array in (stencil.runs, stencil.weights, stencil.pairs))
        self.held.append(tables)
        runs, weights, pairs = tables
        args = (
            *map(np.int32, size), source[0], *map(np.int32, source[1:]), runs, np.int32(len(stencil.runs)), weights,
            self.sums, pairs, np.int32(len(stencil.pairs)), np.float32(share),
            *map(np.int32, stencil.reach),
            target[0], *map(np.int32, target[1:]), np.int32(fresh),
        )  # fmt: skip
        tiles = (TILES_ABREAST, -(-size[0] // CONVOLVED[0]), -(-size[1] // (TILES_ABREAST * CONVOLVED[1])))
        self._launch("convolve", tiles, events, *args)

    def _launch(self, name: str, size: tuple[int, ...], events: Events, *args: object) -> None:
        one = (1,) * len(size)
        events.append((name, launch(self.session, kernel(self.program, name), size, one, *args)))  # type: ignore[arg-type]
