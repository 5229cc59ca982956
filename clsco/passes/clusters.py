"""Host side of the kernels that split an image into depth layers, each extended behind nearer layers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pyopencl as cl

from clsco.constants import DISCONTINUITY_CLASSES, PUSH_PIXELS, REACH_PIXELS, SEED_COLUMNS
from clsco.frame.strips import Grid
from clsco.opencl.buffers import allocate, download
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.depth_layers import LayerBounds, bins_of, depth_of_hidden, layer_bounds, levels_of
from clsco.passes.blur import BLOCKS, PIXELS, Image
from clsco.passes.job import Job
from clsco.plan.buffers import cluster_buffers
from clsco.plan.methods import BlurSpec
from clsco.records import Real, Struct

LINES = (8,)  # local size of kernels with a work-item per row or column
RUNS = (1, 8)  # local size of kernels with a work-item per run of a row
ZERO = np.zeros(1, np.uint32)


@dataclass(frozen=True)
class Layers:
    """Depth layers of an image, the input of `clsco.passes.layered.DepthLayers`.

    Attributes
    ----------
    count : int
        Number of layers.
    images : iterator of Image
        The layers from near to far, with coverage as the last channel. Each layer is computed when requested and may
        overwrite the previous layer. Empty if there is only one layer.
    image : Image
        The whole image, blurred without occlusion away from edges; overwritten with border = "renormalize".
    edge : Buffer
        uchar (height, width): 1 where `images` are used, 0 where `image` is used; not read if there is one layer.
    """

    count: int
    images: Iterator[Image]
    image: Image
    edge: cl.Buffer


def layered_program(session: Session, spec: BlurSpec, channels: int, real: Real) -> Target:
    """Target with the kernels of layered.cl, for images of `channels` channels. The kernels have a program of their
    own, because they depend on few features.
    """
    features = {"CHANNELS": channels + 1, "SCATTER": spec.method == "scatter", "RIMS": len(spec.psf.rims)}
    return Target.build(session, ["layered/layered.cl"], features, real)


class Clusters:
    """Splits an image into depth layers by its signed blur radii.

    For a frame in strips, call `find` for all strips first.

    Parameters
    ----------
    target : Target
        Target of `layered_program`.
    spec : BlurSpec
        Blur of the frame.
    tallest : Grid
        Grid of the frame, or the tallest of its strips.

    Attributes
    ----------
    buffers : dict
        Buffers named as in `clsco.plan.buffers.cluster_buffers`. "latest": discontinuities of a time sample, by size
        class and bin of the radius; "layer": uchar (height, width), depth layer of each pixel; "hidden": uchar (height,
        width), layer that continues behind each pixel, 0 for none; "edge": as in `Layers`. The others are temporary.

    Raises
    ------
    DeviceError, KernelError

    Notes
    -----
    Pixels are assigned to at most MOST_LAYERS layers so that the two sides of each depth discontinuity of more than
    DISCONTINUITY px are in different layers, if these suffice. At discontinuities, push-pull (Gortler et al. 1996)
    extrapolates each layer behind nearer layers from its nearest pixels, as far as the blurs of both sides reach. A cut
    through a continuous surface has no hidden part. Validated against `clsco.reference.layered.layered`.
    """

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid) -> None:
        self.target, self.psf, self.channels = target, spec.psf, tallest.channels
        self.low, self.bins = bins_of(spec.largest)
        self.reach = spec.psf.reach(spec.largest)
        self.buffers = allocate(target.session, cluster_buffers(spec, tallest))
        self._forget()

    def find(self, job: Job, image: Image) -> None:
        """Record the depth discontinuities in the image of a time sample, or of one of its strips."""
        far = np.int32(2 * self.reach + 1)
        head = (job.grid, _real(self.low, self.target.real), np.int32(self.bins), far)
        width, height = _size(job.grid)
        args = (*head, *image.maps, self.buffers["latest"])
        self.target.run("find_discontinuities", (height + width,), LINES, job.events, *args)

    def read_bounds(self) -> LayerBounds:
        """Bounds of depth layers, from all strips passed to `find` since the last call. Waits for the device."""
        size = DISCONTINUITY_CLASSES * self.bins + 1
        latest = download(self.target.session, self.buffers["latest"], (size,), np.int32)
        self._forget()
        deep = depth_of_hidden(self.psf, int(latest[-1]))
        return LayerBounds(tuple(layer_bounds(latest[:-1].reshape(DISCONTINUITY_CLASSES, self.bins))), deep)

    def _forget(self) -> None:
        latest = self.buffers["latest"]
        cl.enqueue_fill_buffer(self.target.session.queue, latest, ZERO, 0, latest.size)

    def divide(self, job: Job, image: Image, bounds: LayerBounds) -> Layers:
        """Split an image, or one of its strips, into the depth layers between `bounds`."""
        if not bounds.bounds:
            return Layers(1, iter(()), image, self.buffers["edge"])
        self._label(job, image, bounds)
        count = len(bounds.bounds) + 1
        images = (self._extend(job, image, number, bounds.deep) for number in range(1, count + 1))
        return Layers(count, images, image, self.buffers["edge"])

    def _label(self, job: Job, image: Image, bounds: LayerBounds) -> None:
        """Compute the depth layer of each pixel, and the layer that continues behind the pixel."""
        run, (width, height), (coc, _) = self.target.run, _size(job.grid), image.maps
        layer, seed, offset, hidden, edge = (self.buffers[n] for n in ("layer", "seed", "offset", "hidden", "edge"))
        padded = (*bounds.bounds, *(0,) * (8 - len(bounds.bounds)))  # at most MOST_LAYERS - 1
        packed = cl.cltypes.make_int8(*padded)  # type: ignore[attr-defined]
        low = _real(self.low, self.target.real)
        head = (job.grid, low, np.int32(self.bins), np.int32(len(bounds.bounds)), packed)
        run("label_depth_layers", (width, height), PIXELS, job.events, *head, *image.maps, layer)
        run("seed_hidden", (width, height), PIXELS, job.events, job.grid, coc, layer, seed)
        run("column_seeds", (-(-width // SEED_COLUMNS),), LINES, job.events, job.grid, seed, offset)
        args = (job.grid, np.int32(bounds.deep), layer, seed, offset, hidden, edge)
        run("reach_hidden", (-(-width // REACH_PIXELS), height), RUNS, job.events, *args)

    def _extend(self, job: Job, image: Image, index: int, deep: int) -> Image:
        """Compute depth layer number `index`, from 1, with its hidden part; deep: `LayerBounds.deep`."""
        run, number, (width, height) = self.target.run, np.int32(index), _size(job.grid)
        layer, hidden, pyramid = (self.buffers[name] for name in ("layer", "hidden", "pyramid"))
        value, coc, valid = (self.buffers[name] for name in ("value", "coc", "valid"))
        planes = (image.value, image.maps[0], layer)
        run("open_depth_layer", (width, height), PIXELS, job.events, job.grid, number, *planes, pyramid)
        levels = levels_of(height, width, deep, self.channels + 2)
        pairs = list(pairwise(levels))
        for name, steps in (("push", pairs), ("pull", pairs[:0:-1])):
            for (rows, columns, start), (half_rows, half_columns, half_start) in steps:
                sizes = (np.int32(n) for n in (rows, columns, half_rows, half_columns, start, half_start))
                if name == "push":
                    last, size = np.int32(half_start == levels[-1][2]), (-(-half_columns // PUSH_PIXELS), half_rows)
                    run(name, size, BLOCKS, job.events, *sizes, last, pyramid)
                else:
                    run(name, (columns, rows), PIXELS, job.events, *sizes, pyramid)
        coarse = (np.int32(n) for n in levels[1])
        out = (hidden, pyramid, value, coc, valid)
        run("take_depth_layer", (width, height), PIXELS, job.events, job.grid, number, *coarse, *planes, *out)
        return Image(value, (coc, valid))


def _size(grid: Struct) -> tuple[int, int]:
    return int(grid["width"]), int(grid["height"])


def _real(value: float, real: Real) -> np.generic:
    return np.float64(value) if real == "double" else np.float32(value)
