"""Host side of layered occlusion: slabs of depth, each blurred with its coverage, composited front to back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pyopencl as cl

from clsco.opencl.buffers import download, empty
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.optics.psf import reach
from clsco.optics.slabs import CLASSES, Slabs, bins_of, depth_of_hidden, levels_of, slab_bounds
from clsco.passes.blur import (
    BLOCKS,
    FILES_OF,
    PIXELS,
    PLAIN,
    Events,
    Sources,
    Spreader,
    image_features,
    prepare_sources,
)
from clsco.plan.memory import pyramid_bytes, source_bytes
from clsco.records import WIDE_BYTES, Real, Struct, structs

REACH_PIXELS, SEED_COLUMNS, PUSH_PIXELS = 64, 16, 4  # px, as in layer.cl
LINES = (8,)  # local size of kernels with a work-item per row or column
RUNS = (1, 8)  # of those with a work-item per run of a row
ZERO = np.zeros(1, np.uint32)


class Layers:
    """Adds moments to a frame with occlusion from what the pinhole sees: psf.occlusion = "layered".

    spreader: of the frame, or a strip of it, whose method is one of MANY_RADII and which has no sub-pixel sources;
    `add` takes the place of `Spreader.add`. tilt: whether the spreader's sources have one; largest: px, no |R| is
    larger; brightest: largest |radiance|; tallest: rows of the largest grid of a strip, where it is not the first one.

    Pixels are put into slabs of the signed blur radius so that the two sides of every jump between neighbors, beyond
    DISCONTINUITY px, fall into different ones; at most MOST_SLABS. A slab takes its surface to go on behind the pixels
    in front of it at jumps, as deep as the blur of both sides reaches, with values from its own pixels as near by, by
    push-pull (Gortler et al. 1996). Near jumps its radiance and its coverage are blurred by the PSF as one image, and
    it gets at each pixel the room that the coverage of nearer slabs leaves; elsewhere light simply adds up. A cut
    through a continuous surface has no hidden part and shows nowhere; where no neighbors jump there is one slab, and
    the frame is that of psf.occlusion = "none", to the bit. Where a frame is made in strips, `look` at all of them
    comes first.

    Raises DeviceError, KernelError. Validated against `clsco.reference.layered.layered` and the ray tracer.
    """

    def __init__(
        self, session: Session, spreader: Spreader, tilt: bool, largest: float, real: Real, brightest: float,
        tallest: int = 0,
    ) -> None:  # fmt: skip
        self.session, self.spreader, self.real = session, spreader, real
        self.channels = spreader.channels
        psf, method, planes = spreader.psf, spreader.method, self.channels + 1
        chosen = image_features(method, psf, largest, planes, tilt, session.device.has_fp64)
        blur = build(session, FILES_OF[method], chosen, structs(real), real)
        # By itself, since nothing else changes its eleven kernels.
        layer = PLAIN | {"SAMPLED": 0, "GENERAL": 0, "CHANNELS": planes, "SCATTER": chosen["SCATTER"]}
        self.program = blur | build(session, ["layered/layered.cl"], layer, structs(real), real)
        self.inner = Spreader(
            session, blur, psf, method, self.camera, planes, 0.0, largest, 0, real, max(brightest, 1.0), chosen
        )
        self.low, self.bins = bins_of(largest)
        self.reach = reach(psf, largest)
        height, width = tallest or int(self.camera["height"]), int(self.camera["width"])
        pixels, rows, columns = height * width, int(self.camera["rows"]), int(self.camera["columns"])
        self.latest = empty(session, 4 * (CLASSES * self.bins + 1))
        self._forget()
        self.source = empty(session, source_bytes(pixels, tilt))
        self.offset = empty(session, 4 * pixels)
        self.slab, self.seed, self.hidden, self.edge = (empty(session, pixels) for _ in range(4))
        self.pyramid = empty(session, pyramid_bytes(psf, self.channels, width, height, largest))
        self.value, self.coc = empty(session, 4 * (self.channels + 1) * pixels), empty(session, WIDE_BYTES * pixels)
        self.valid = empty(session, pixels)
        self.covered = empty(session, 4 * rows * columns)

    @property
    def camera(self) -> Struct:
        """camera_t of the strip that is being made."""
        return self.spreader.camera

    def look(self, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> None:
        """Note the jumps in a strip of a moment, or in all of it; arguments as for `add`."""
        far = np.int32(2 * self.reach + 1)
        args = (self.camera, self._real(self.low), np.int32(self.bins), far, coc, valid, self.latest)
        width, height = self._padded()
        self._launch("find_discontinuities", (height + width,), LINES, events, *args)

    def slabs(self) -> Slabs:
        """Slabs of the moment whose strips were looked at since the last call. Waits for the device."""
        found = download(self.session, self.latest, (CLASSES * self.bins + 1,), np.int32)
        self._forget()
        deep = depth_of_hidden(self.spreader.psf, int(found[-1]))
        return Slabs(tuple(slab_bounds(found[:-1].reshape(CLASSES, self.bins))), deep)

    def _forget(self) -> None:
        cl.enqueue_fill_buffer(self.session.queue, self.latest, ZERO, 0, self.latest.size)

    def add(
        self, value: cl.Buffer, coc: cl.Buffer, valid: cl.Buffer, events: Events, slabs: Slabs | None = None
    ) -> int:
        """Add the light of one moment to the spreader's frame, or strip, and return the number of slabs.

        value: float (channels, height, width), radiance times the weight of the moment; coc: wide_t, signed R in px,
        and valid: uchar, both (height, width); all on the padded grid. With border = "renormalize" value is written to.
        slabs: of the whole moment; without, it is looked at first, which waits once for the device.
        """
        if slabs is None:
            self.look(coc, valid, events)
            slabs = self.slabs()
        if slabs.bounds:
            self._label(slabs, coc, valid, events)
            cl.enqueue_fill_buffer(self.session.queue, self.covered, ZERO, 0, self.covered.size)
            for which in range(1, len(slabs.bounds) + 2):
                self._extend(which, slabs.deep, value, coc, events)
                self._blur(events)
        struct = self.spreader.struct
        prepare_sources(self.session, self.program, self.camera, struct, coc, valid, self.source, events)
        if slabs.bounds:
            self._keep(near_edges=False, events=events)
        # Last, since border = "renormalize" writes to value.
        self.spreader.add(Sources(self.source, value), 0.0, events)
        return len(slabs.bounds) + 1

    def _padded(self) -> tuple[int, int]:
        return int(self.camera["width"]), int(self.camera["height"])

    def _real(self, value: float) -> np.generic:
        return np.float64(value) if self.real == "double" else np.float32(value)

    def _label(self, slabs: Slabs, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> None:
        """The slab of every pixel, and the one behind it."""
        width, height = self._padded()
        some = (*slabs.bounds, *(0,) * (8 - len(slabs.bounds)))  # at most MOST_SLABS - 1
        bounds = cl.cltypes.make_int8(*some)  # type: ignore[attr-defined]
        head = (self.camera, self._real(self.low), np.int32(self.bins), np.int32(len(slabs.bounds)), bounds)
        self._launch("label_depth_layers", self._padded(), PIXELS, events, *head, coc, valid, self.slab)
        self._launch("seed_hidden", self._padded(), PIXELS, events, self.camera, coc, self.slab, self.seed)
        columns = (-(-width // SEED_COLUMNS),)
        self._launch("column_seeds", columns, LINES, events, self.camera, self.seed, self.offset)
        runs = (-(-width // REACH_PIXELS), height)
        args = (self.camera, np.int32(slabs.deep), self.slab, self.seed, self.offset, self.hidden, self.edge)
        self._launch("reach_hidden", runs, RUNS, events, *args)

    def _keep(self, near_edges: bool, events: Events) -> None:
        """Leave only the sources near edges, or only the others."""
        args = (self.camera, np.int32(near_edges), self.edge, self.source)
        self._launch("keep_sources", self._padded(), PIXELS, events, *args)

    def _extend(self, which: int, deep: int, value: cl.Buffer, coc: cl.Buffer, events: Events) -> None:
        """One slab with its hidden part."""
        number = np.int32(which)
        planes = (value, coc, self.slab)
        self._launch("open_depth_layer", self._padded(), PIXELS, events, self.camera, number, *planes, self.pyramid)
        width, height = self._padded()
        levels = levels_of(height, width, deep, self.channels + 2)
        pairs = list(pairwise(levels))
        for name, chosen in (("push", pairs), ("pull", pairs[:0:-1])):
            for (rows, columns, start), (half_rows, half_columns, half_start) in chosen:
                sizes = (np.int32(n) for n in (rows, columns, half_rows, half_columns, start, half_start))
                if name == "push":
                    last, grid = np.int32(half_start == levels[-1][2]), (-(-half_columns // PUSH_PIXELS), half_rows)
                    self._launch(name, grid, BLOCKS, events, *sizes, last, self.pyramid)
                else:
                    self._launch(name, (columns, rows), PIXELS, events, *sizes, self.pyramid)
        coarse = (np.int32(n) for n in levels[1])
        out = (self.value, self.coc, self.valid)
        labels = (self.hidden, self.pyramid)
        self._launch(
            "take_depth_layer", self._padded(), PIXELS, events, self.camera, number, *coarse, *planes, *labels, *out
        )

    def _blur(self, events: Events) -> None:
        """Blur the slab and put it behind those before."""
        inner, outer = self.inner, self.spreader
        inner.camera, frame = self.camera, (int(self.camera["columns"]), int(self.camera["rows"]))
        maps = (self.coc, self.valid, self.source)
        prepare_sources(self.session, self.program, self.camera, inner.struct, *maps, events)
        self._keep(near_edges=True, events=events)
        inner.clear()
        inner.add(Sources(self.source, self.value), 0.0, events)
        layout = (np.int32(inner.pitch), np.int32(inner.pad))
        if inner.method == "scatter":
            self._launch(
                "resolve", frame, PIXELS, events, self.camera, np.float32(inner.scale), *layout, inner.sums,
                inner.total,
            )  # fmt: skip
            target: tuple[object, ...] = (np.float32(outer.scale), outer.sums)
        else:
            target = (np.int32(outer.pitch), np.int32(outer.pad), outer.total)
        blurred = (self.camera, *layout, inner.total, self.covered)
        self._launch("composite", frame, PIXELS, events, *blurred, *target)

    def _launch(self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: object) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))  # type: ignore[arg-type]
