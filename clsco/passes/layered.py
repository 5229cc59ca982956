"""Host side of layered occlusion: depth layers, each blurred with its coverage, composited front to back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pyopencl as cl

from clsco.constants import DISCONTINUITY_CLASSES, PUSH_PIXELS, REACH_PIXELS, SEED_COLUMNS
from clsco.frame.strips import Grid
from clsco.opencl.buffers import allocate, download, empty
from clsco.opencl.program import build
from clsco.optics.depth_layers import LayerBounds, bins_of, depth_of_hidden, layer_bounds, levels_of
from clsco.passes.blur import BLOCKS, PIXELS, PLAIN, BlurredPlane, Events, Sources, Target, blur_target, prepare_sources
from clsco.passes.frame_blur import make_blur
from clsco.plan.buffers import Sizes, depth_layer_spec, layered_buffers
from clsco.plan.methods import BlurSpec
from clsco.records import Real, Struct, structs

LINES = (8,)  # local size of kernels with a work-item per row or column
RUNS = (1, 8)  # of those with a work-item per run of a row
ZERO = np.zeros(1, np.uint32)

Planes = tuple[cl.Buffer, cl.Buffer, cl.Buffer]


class Labels:
    """Labels of a grid's pixels: the depth layer of each, the one that goes on behind it, and the distance of an edge.

    Buffers, by the names of `clsco.plan.buffers.layered_buffers`: latest: where discontinuities of a time sample are,
    by class and bin; layer, seed, hidden, edge: uchar (height, width); offset: int (height, width).
    """

    def __init__(self, target: Target, spec: BlurSpec, sizes: Sizes) -> None:
        self.target, self.psf = target, spec.psf
        self.low, self.bins = bins_of(spec.largest)
        self.reach = spec.psf.reach(spec.largest)
        self.latest = empty(target.session, sizes["latest"])
        self.offset = empty(target.session, sizes["offset"])
        self.layer, self.seed, self.hidden, self.edge = (
            empty(target.session, sizes[name]) for name in ("layer", "seed", "hidden", "edge")
        )
        self._forget()

    def find(self, grid: Struct, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> None:
        """Record the depth discontinuities of a strip of a time sample, or of all of it."""
        far = np.int32(2 * self.reach + 1)
        args = (grid, _real(self.low, self.target.real), np.int32(self.bins), far, coc, valid, self.latest)
        width, height = _padded(grid)
        self.target.run("find_discontinuities", (height + width,), LINES, events, *args)

    def found(self) -> LayerBounds:
        """Depth layers of the time sample whose strips went through `find` since the last call. Waits for the
        device."""
        latest = download(self.target.session, self.latest, (DISCONTINUITY_CLASSES * self.bins + 1,), np.int32)
        self._forget()
        deep = depth_of_hidden(self.psf, int(latest[-1]))
        return LayerBounds(tuple(layer_bounds(latest[:-1].reshape(DISCONTINUITY_CLASSES, self.bins))), deep)

    def _forget(self) -> None:
        cl.enqueue_fill_buffer(self.target.session.queue, self.latest, ZERO, 0, self.latest.size)

    def label(self, grid: Struct, found: LayerBounds, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> None:
        """The depth layer of every pixel, and the one behind it."""
        run, size = self.target.run, _padded(grid)
        some = (*found.bounds, *(0,) * (8 - len(found.bounds)))  # at most MOST_LAYERS - 1
        bounds = cl.cltypes.make_int8(*some)  # type: ignore[attr-defined]
        head = (grid, _real(self.low, self.target.real), np.int32(self.bins), np.int32(len(found.bounds)), bounds)
        run("label_depth_layers", size, PIXELS, events, *head, coc, valid, self.layer)
        run("seed_hidden", size, PIXELS, events, grid, coc, self.layer, self.seed)
        columns = (-(-size[0] // SEED_COLUMNS),)
        run("column_seeds", columns, LINES, events, grid, self.seed, self.offset)
        runs = (-(-size[0] // REACH_PIXELS), size[1])
        args = (grid, np.int32(found.deep), self.layer, self.seed, self.offset, self.hidden, self.edge)
        run("reach_hidden", runs, RUNS, events, *args)


class DepthLayers:
    """Adds time samples to a frame with occlusion from what the pinhole sees: psf.occlusion = "layered".

    `add` takes the place of that of the frame's blur. Where a frame is made in strips, `find` of all of them comes
    first.

    Parameters
    ----------
    blur : BlurredPlane
        Blur of the frame, or a strip of it, by one of MANY_RADII and without sub-pixel sources.
    target : Target
        Target of the frame's blur.
    tallest : Grid
        Grid of the frame, or the tallest of its strips.

    Raises
    ------
    DeviceError, KernelError

    Notes
    -----
    Pixels are put into depth layers by their signed blur radius, so that the two sides of every depth discontinuity
    beyond DISCONTINUITY px fall into different ones; at most MOST_LAYERS. At discontinuities each layer is extrapolated
    behind nearer ones, as deep as the blur of both sides reaches, with values from its own pixels as near by, by
    push-pull (Gortler et al. 1996). Near discontinuities its radiance and its coverage are blurred by the PSF as one
    image, and it gets at each pixel the room that the coverage of nearer layers leaves; elsewhere radiance simply adds
    up. A cut through a continuous surface has no hidden part and shows nowhere; without discontinuities there is one
    layer, and the frame is that of psf.occlusion = "none", to the bit.
    Validated against `clsco.reference.layered.layered` and the ray tracer.
    """

    def __init__(self, blur: BlurredPlane, target: Target, tallest: Grid) -> None:
        session, real, spec = target.session, target.real, depth_layer_spec(blur.spec)
        planes = tallest.channels + 1
        self.outer, self.values = blur, planes
        own = blur_target(session, spec, planes, real)
        # By itself, since nothing else changes its eleven kernels.
        features = PLAIN | {"SAMPLED": 0, "GENERAL": 0, "CHANNELS": planes, "SCATTER": int(spec.method == "scatter")}
        program = build(session, ["layered/layered.cl"], features, structs(real), real)
        self.target = Target(session, own.program | program, real)
        wider = Grid(tallest.rows, tallest.columns, tallest.guard, planes, tallest.height)
        self.inner = make_blur(own, spec, wider, blur.grid)
        sizes = layered_buffers(blur.spec, tallest, session.device)
        self.labels = Labels(self.target, spec, sizes)
        names = ("source", "pyramid", "value", "coc", "valid", "covered")
        buffers = allocate(session, {name: sizes[name] for name in names})
        self.source, self.pyramid, self.covered = (buffers[name] for name in ("source", "pyramid", "covered"))
        self.value, self.coc, self.valid = (buffers[name] for name in ("value", "coc", "valid"))

    @property
    def grid(self) -> Struct:
        """grid_t of the strip that is being made."""
        return self.outer.grid

    def find(self, coc: cl.Buffer, valid: cl.Buffer, events: Events) -> None:
        """Record the depth discontinuities in a strip of a time sample, or in all of it; arguments as for `add`."""
        self.labels.find(self.grid, coc, valid, events)

    def add(self, planes: Planes, events: Events, found: LayerBounds | None = None) -> int:
        """Add the radiance of one time sample to the frame, or strip.

        Parameters
        ----------
        planes : (Buffer, Buffer, Buffer)
            On the padded grid: float (channels, height, width), radiance, which is written to with border =
            "renormalize"; real (height, width), signed R in px; uchar (height, width), where it is known.
        events : list
        found : LayerBounds, optional
            Depth layers of the whole time sample; without, they are found first, which waits once for the device.

        Returns
        -------
        int
            Number of depth layers.
        """
        value, coc, valid = planes
        if found is None:
            self.find(coc, valid, events)
            found = self.labels.found()
        if found.bounds:
            self.labels.label(self.grid, found, coc, valid, events)
            cl.enqueue_fill_buffer(self.target.session.queue, self.covered, ZERO, 0, self.covered.size)
            for which in range(1, len(found.bounds) + 2):
                self._extend(which, found.deep, value, coc, events)
                self._blur(events)
        prepare_sources(self.target, self.grid, self.outer.struct, (coc, valid), self.source, events)
        if found.bounds:
            self._keep(near_edges=False, events=events)
        # Last, since border = "renormalize" writes to value.
        self.outer.add(Sources(self.source, value), events)
        return len(found.bounds) + 1

    def _keep(self, near_edges: bool, events: Events) -> None:
        """Leave only the sources near edges, or only the others."""
        args = (self.grid, np.int32(near_edges), self.labels.edge, self.source)
        self.target.run("keep_sources", _padded(self.grid), PIXELS, events, *args)

    def _extend(self, which: int, deep: int, value: cl.Buffer, coc: cl.Buffer, events: Events) -> None:
        """One depth layer with its hidden part."""
        run, number, labels = self.target.run, np.int32(which), self.labels
        planes = (value, coc, labels.layer)
        width, height = _padded(self.grid)
        run("open_depth_layer", (width, height), PIXELS, events, self.grid, number, *planes, self.pyramid)
        levels = levels_of(height, width, deep, self.values + 1)
        pairs = list(pairwise(levels))
        for name, chosen in (("push", pairs), ("pull", pairs[:0:-1])):
            for (rows, columns, start), (half_rows, half_columns, half_start) in chosen:
                sizes = (np.int32(n) for n in (rows, columns, half_rows, half_columns, start, half_start))
                if name == "push":
                    last, size = np.int32(half_start == levels[-1][2]), (-(-half_columns // PUSH_PIXELS), half_rows)
                    run(name, size, BLOCKS, events, *sizes, last, self.pyramid)
                else:
                    run(name, (columns, rows), PIXELS, events, *sizes, self.pyramid)
        coarse = (np.int32(n) for n in levels[1])
        out = (labels.hidden, self.pyramid, self.value, self.coc, self.valid)
        run("take_depth_layer", (width, height), PIXELS, events, self.grid, number, *coarse, *planes, *out)

    def _blur(self, events: Events) -> None:
        """Blur the depth layer and put it behind those before."""
        inner, frame = self.inner, (int(self.grid["columns"]), int(self.grid["rows"]))
        inner.grid = self.grid
        prepare_sources(self.target, self.grid, inner.struct, (self.coc, self.valid), self.source, events)
        self._keep(near_edges=True, events=events)
        inner.clear()
        inner.add(Sources(self.source, self.value), events)
        inner.resolve(events)
        self.target.run("composite", frame, PIXELS, events, self.grid, *inner.layout, self.covered, *self.outer.sink)


def _padded(grid: Struct) -> tuple[int, int]:
    return int(grid["width"]), int(grid["height"])


def _real(value: float, real: Real) -> np.generic:
    return np.float64(value) if real == "double" else np.float32(value)
