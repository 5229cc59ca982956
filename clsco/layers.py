"""Host side of layered occlusion: slabs of depth, each blurred with its coverage, composited front to back."""

from __future__ import annotations

from math import ceil

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.device import Session
from clsco.layout import WIDE_BYTES, Real, structs
from clsco.memory import source_bytes
from clsco.program import build, download, empty, kernel, launch, upload
from clsco.psf import psf_extent, reach
from clsco.spread import FILES_OF, PIXELS, PLAIN, Events, Sources, Spreader, image_features, prepare_sources

# As in layer.cl.
JUMP, BIN, CLASSES, RUN = 1.0, 0.25, 10, 64  # px, px
MOST_SLABS = 8
LINES = (8,)  # local size of kernels with a work-item per row or column
RUNS = (1, 8)  # of those with a work-item per run of a row
ZERO = np.zeros(1, np.uint32)


def slab_bounds(latest: NDArray[np.int32]) -> list[int]:
    """First bins of the second and each further slab, at most MOST_SLABS - 1 of them, in rising order.

    latest: (CLASSES, bins) from `find_jumps` of layer.cl. From near to far, a jump that no bound splits yet gets one in
    the middle of where it can be; where that makes too many, the smaller half of the jumps (a class) is left alone.
    """
    for smallest in range(CLASSES):
        bounds: list[int] = []
        begins = latest[smallest:].max(axis=0)
        for far_bin in np.flatnonzero(begins).tolist():
            begin = int(begins[far_bin])  # the first bin behind the near side
            if not bounds or bounds[-1] < begin:
                bounds.append((begin + far_bin + 1) // 2)
        if len(bounds) < MOST_SLABS:
            return bounds
    return bounds[: MOST_SLABS - 1]


class Layers:
    """Adds moments to a frame with occlusion from what the pinhole sees: psf.occlusion = "layered".

    spreader: of the frame, whose method is one of MANY_RADII and which has no sub-pixel sources; `add` takes the place
    of `Spreader.add`. tilt: whether the spreader's sources have one; largest: px, no |R| is larger; brightest: largest
    |radiance|.

    Pixels are put into slabs of the signed blur radius so that the two sides of every jump between neighbors, beyond
    JUMP px, fall into different ones; at most MOST_SLABS. A slab takes its surface to go on behind the pixels in front
    of it at jumps, as deep as the blur of both sides reaches, with values from its own pixels by push-pull (Gortler et
    al. 1996). Near jumps its radiance and its coverage are blurred by the PSF as one image, and it gets at each pixel
    the room that the coverage of nearer slabs leaves; elsewhere light simply adds up. A cut through a continuous
    surface has no hidden part and shows nowhere; where no neighbors jump there is one slab, and the frame is that of
    psf.occlusion = "none", to the bit.

    Raises DeviceError, KernelError. Validated against `clsco.reference.layer` and the ray tracer.
    """

    def __init__(
        self, session: Session, spreader: Spreader, tilt: bool, largest: float, real: Real, brightest: float,
    ) -> None:  # fmt: skip
        self.session, self.spreader, self.camera, self.real = session, spreader, spreader.camera, real
        self.channels = spreader.channels
        psf, method, planes = spreader.psf, spreader.method, self.channels + 1
        chosen = image_features(method, psf, largest, planes, tilt, session.device.has_fp64)
        blur = build(session, FILES_OF[method], chosen, structs(real), real)
        # By itself, since nothing else changes its eleven kernels.
        layer = PLAIN | {"SAMPLED": 0, "CHANNELS": planes, "SCATTER": chosen["SCATTER"]}
        self.program = blur | build(session, ["layer.cl"], layer, structs(real), real)
        self.inner = Spreader(
            session, blur, psf, method, self.camera, planes, 0.0, largest, 0, real, max(brightest, 1.0), chosen
        )
        half = int(np.ceil(largest / BIN)) + 1
        self.low, self.bins = -half * BIN, 2 * half
        self.reach = reach(psf, largest)
        self.height, self.width = int(self.camera["height"]), int(self.camera["width"])
        self.frame = int(self.camera["columns"]), int(self.camera["rows"])
        self.levels = _levels(self.height, self.width, self.channels + 2)
        pixels = self.height * self.width
        self.latest = empty(session, 4 * (CLASSES * self.bins + 1))
        self.source = empty(session, source_bytes(pixels, tilt))
        self.offset = empty(session, 4 * pixels)
        self.slab, self.seed, self.hidden, self.edge = (empty(session, pixels) for _ in range(4))
        last = self.levels[-1]
        self.pyramid = empty(session, 4 * (last[2] + (self.channels + 2) * last[0] * last[1]))
        self.value, self.coc = empty(session, 4 * (self.channels + 1) * pixels), empty(session, WIDE_BYTES * pixels)
        self.valid = empty(session, pixels)
        self.covered = empty(session, 4 * self.frame[0] * self.frame[1])
        self.held: list[cl.Buffer] = []

    def add(self, value: cl.Buffer, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> int:
        """Add the light of one moment to the spreader's frame, and return the number of slabs that it took.

        value: float (channels, height, width), radiance times the weight of the moment; coc: wide_t, signed R in px,
        and valid: uchar, both (height, width); all on the padded grid. With border = "renormalize" value is written to.
        Waits once for the device.
        """
        bounds, deep = self._bounds(coc, valid, events)
        if bounds:
            self._label(bounds, deep, coc, valid, events)
            cl.enqueue_fill_buffer(self.session.queue, self.covered, ZERO, 0, self.covered.size)
            for which in range(1, len(bounds) + 2):
                self._extend(which, value, coc, events)
                self._blur(events)
        struct = self.spreader.struct
        prepare_sources(self.session, self.program, self.camera, struct, coc, valid, self.source, events)
        if bounds:
            self._keep(near_edges=False, events=events)
        # Last, since border = "renormalize" writes to value.
        self.spreader.add(Sources(self.source, value), 0.0, events)
        return len(bounds) + 1

    def _padded(self) -> tuple[int, int]:
        return self.width, self.height

    def _real(self, value: float) -> np.generic:
        return np.float64(value) if self.real == "double" else np.float32(value)

    def _bounds(self, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> tuple[list[int], int]:
        """Where the slabs of a moment begin, in bins, and how far behind an edge surface may be seen, px."""
        cl.enqueue_fill_buffer(self.session.queue, self.latest, ZERO, 0, self.latest.size)
        far = np.int32(2 * self.reach + 1)
        args = (self.camera, self._real(self.low), np.int32(self.bins), far, coc, valid, self.latest)
        self._launch("find_jumps", (self.height + self.width,), LINES, events, *args)
        found = download(self.session, self.latest, (CLASSES * self.bins + 1,), np.int32)
        largest_sum = int(found[-1])  # of the radii on both sides of a jump
        deep = ceil(float(psf_extent(self.spreader.psf, largest_sum))) + 2
        return slab_bounds(found[:-1].reshape(CLASSES, self.bins)), deep

    def _label(self, bounds: list[int], deep: int, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> None:
        """The slab of every pixel, and the one behind it."""
        self.held = [upload(self.session, np.array(bounds, np.int32))]  # the device reads it later
        head = (self.camera, self._real(self.low), np.int32(self.bins), np.int32(len(bounds)))
        self._launch("label_slabs", self._padded(), PIXELS, events, *head, *self.held, coc, valid, self.slab)
        self._launch("seed_hidden", self._padded(), PIXELS, events, self.camera, coc, self.slab, self.seed)
        self._launch("column_seeds", (self.width,), LINES, events, self.camera, self.seed, self.offset)
        runs = (-(-self.width // RUN), self.height)
        args = (self.camera, np.int32(deep), self.slab, self.seed, self.offset, self.hidden, self.edge)
        self._launch("reach_hidden", runs, RUNS, events, *args)

    def _keep(self, near_edges: bool, events: Events) -> None:
        """Leave only the sources near edges, or only the others."""
        args = (self.camera, np.int32(near_edges), self.edge, self.source)
        self._launch("keep_sources", self._padded(), PIXELS, events, *args)

    def _extend(self, which: int, value: cl.Buffer, coc: cl.Buffer, events: Events) -> None:
        """One slab with its hidden part."""
        number = np.int32(which)
        planes = (value, coc, self.slab)
        self._launch("open_slab", self._padded(), PIXELS, events, self.camera, number, *planes, self.pyramid)
        pairs = list(zip(self.levels, self.levels[1:], strict=False))
        for name, chosen in (("push", pairs), ("pull", pairs[:0:-1])):
            for (rows, columns, start), (half_rows, half_columns, half_start) in chosen:
                sizes = (np.int32(n) for n in (rows, columns, half_rows, half_columns, start, half_start))
                grid = (half_columns, half_rows) if name == "push" else (columns, rows)
                self._launch(name, grid, PIXELS, events, *sizes, self.pyramid)
        coarse = (np.int32(n) for n in self.levels[1])
        out = (self.value, self.coc, self.valid)
        labels = (self.hidden, self.pyramid)
        self._launch("take_slab", self._padded(), PIXELS, events, self.camera, number, *coarse, *planes, *labels, *out)

    def _blur(self, events: Events) -> None:
        """Blur the slab and put it behind those before."""
        inner, outer = self.inner, self.spreader
        maps = (self.coc, self.valid, self.source)
        prepare_sources(self.session, self.program, self.camera, inner.struct, *maps, events)
        self._keep(near_edges=True, events=events)
        inner.clear()
        inner.add(Sources(self.source, self.value), 0.0, events)
        layout = (np.int32(inner.pitch), np.int32(inner.pad))
        if inner.method == "scatter":
            self._launch(
                "resolve", self.frame, PIXELS, events, self.camera, np.float32(inner.scale), *layout, inner.sums,
                inner.total,
            )  # fmt: skip
            target: tuple[object, ...] = (np.float32(outer.scale), outer.sums)
        else:
            target = (np.int32(outer.pitch), np.int32(outer.pad), outer.total)
        blurred = (self.camera, *layout, inner.total, self.covered)
        self._launch("composite", self.frame, PIXELS, events, *blurred, *target)

    def _launch(self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: object) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))  # type: ignore[arg-type]


def _levels(rows: int, columns: int, planes: int) -> list[tuple[int, int, int]]:
    """Rows, columns and start in floats of every level of a pyramid, down to a single pixel."""
    levels = [(rows, columns, 0)]
    while max(rows, columns) > 1:
        start = levels[-1][2] + planes * rows * columns
        rows, columns = -(-rows // 2), -(-columns // 2)
        levels.append((rows, columns, start))
    return levels
