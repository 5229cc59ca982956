"""Host side of the kernels that split an image into depth layers, and make a sheet of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY_CLASSES, LAYER_TILE
from clsco.frame.strips import Grid
from clsco.opencl.buffers import allocate, download
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.depth_layers import bins_of, layer_bounds, levels_of, most_deep, reaches_of, signs_of
from clsco.passes.blur import PIXELS, Image
from clsco.passes.job import Job
from clsco.plan.buffers import cluster_buffers, label_buffers
from clsco.plan.methods import BlurSpec
from clsco.records import Real, Struct

FILES = ("layered/layered.cl", "layered/sheets.cl")
LINES = (8,)  # local size of kernels with a work-item per row or column
TILES = (8, 1)  # local size of kernels with a work-item per tile
ZERO, ONE = np.zeros(1, np.uint32), np.ones(1, np.uint32)
NONE = np.full(1, -1, np.int32)


@dataclass(frozen=True)
class Sheet:
    """A depth layer with radiance, radius and coverage in all pixels.

    image: radiance times coverage, coverage and ones; left, needed: int of each tile, 1 if nearer sheets leave room in
    it, and if the sheet reaches it, too; to_needed: px to the nearest tile of the latter kind; still_left: like `left`,
    with the sheet, 0 so far; signs: of its radii.
    """

    image: Image
    left: cl.Buffer
    needed: cl.Buffer
    to_needed: cl.Buffer
    still_left: cl.Buffer
    signs: tuple[int, ...]


@dataclass(frozen=True)
class Layers:
    """Depth layers of an image, the input of `clsco.passes.layered.DepthLayers`.

    Attributes
    ----------
    count : int
        Number of layers.
    sheets : iterator of Sheet
        The layers from near to far. Each sheet is computed when requested and may overwrite the previous one. Empty if
        there is only one layer.
    image : Image or None
        The whole image, blurred without occlusion away from edges; overwritten with border = "renormalize". None for
        images with alpha.
    marked, to_plain : Buffer
        int of each tile: 1 where `sheets` are used, 0 where `image` is used, and the distance in px to a tile of the
        latter kind; not read if there is one layer.
    """

    count: int
    sheets: Iterator[Sheet]
    image: Image | None
    marked: cl.Buffer
    to_plain: cl.Buffer


def layered_program(session: Session, channels: int, real: Real, alpha: bool = False, cells: int = 1) -> Target:
    """Target with the kernels of layered occlusion, for images of `channels` channels, the last of which may be alpha.

    The kernels have a program of their own, because they depend on few features.
    """
    features = {"CHANNELS": channels - alpha, "ALPHA": int(alpha), "QUADRANTS": int(cells > 1)}
    return Target(session, FILES, features, real)


class Clusters:
    """Splits an image, or several with alpha that lie over each other, into depth layers by their signed blur radii.

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
        Buffers named as in `clsco.plan.buffers.cluster_buffers`, and described in layered.cl.
    labels : list of dict
        The same for `clsco.plan.buffers.label_buffers`, for each image.

    Raises
    ------
    DeviceError, KernelError

    Notes
    -----
    Pixels are assigned to at most MOST_LAYERS layers so that the two sides of each depth discontinuity of more than
    DISCONTINUITY px are in different layers, if these suffice. Pixels next to a discontinuity are split into the colors
    of its two surfaces. Push-pull (Gortler et al. 1996) extrapolates each layer over the whole image. Validated against
    `clsco.reference.layered.layered`.
    """

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid) -> None:
        self.target, self.alpha, self.colors = target, spec.images > 0, tallest.channels - (spec.images > 0)
        self.low, self.bins = bins_of(spec.largest)
        self.gap = 2 * spec.psf.reach(spec.largest) + 1
        self.deep = most_deep(spec.psf, spec.largest)
        self.far = int(reaches_of(spec.psf, np.array([spec.largest]))[0])
        # Within it, pixels of the pyramid are computed, up to the size of tiles, from which sheets are interpolated.
        self.near = self.deep + 2 * LAYER_TILE
        self.spread = real_pair(spec.psf.extent, spec.psf.pupil.margin, target.real)
        self.buffers = allocate(target.session, cluster_buffers(spec, tallest))
        sizes = label_buffers(spec, tallest)
        self.labels = [allocate(target.session, sizes) for _ in range(max(spec.images, 1))]
        self._fill(ZERO, "latest")

    def find(self, job: Job, images: Sequence[Image]) -> None:
        """Record the depth discontinuities in the images of a time sample, or of one of its strips."""
        head = (job.grid, real_scalar(self.low, self.target.real), np.int32(self.bins), np.int32(self.gap))
        width, height = size_of(job.grid)
        for image in images:
            args = (*head, *image.maps, self.buffers["latest"])
            self.target.run("find_discontinuities", (height + width,), LINES, job.events, *args)

    def read_bounds(self) -> tuple[int, ...]:
        """First bins of all depth layers but the nearest, from all strips passed to `find` since the last call. Waits
        for the device.
        """
        shape = DISCONTINUITY_CLASSES, self.bins
        latest = download(self.target.session, self.buffers["latest"], shape, np.int32)
        self._fill(ZERO, "latest")
        return tuple(layer_bounds(latest))

    def divide(self, job: Job, images: Sequence[Image], bounds: tuple[int, ...]) -> Layers:
        """Split images, or one of their strips, into the depth layers between `bounds`. Of images in the same layer,
        the first is the nearest.
        """
        tiles, count = self._named("marked", "to_plain"), len(bounds) + 1
        if count == 1 and not self.alpha:
            return Layers(1, iter(()), images[0], *tiles)
        for image, labels in zip(images, self.labels, strict=True):
            self._label(job, image, labels, bounds)
        self._mark(job)
        pairs = product(range(1, count + 1), zip(images, self.labels, strict=True))
        sheets = (self._sheet(job, image, labels, number, bounds) for number, (image, labels) in pairs)
        return Layers(count, sheets, None if self.alpha else images[0], *tiles)

    def _label(self, job: Job, image: Image, labels: Mapping[str, cl.Buffer], bounds: tuple[int, ...]) -> None:
        """Compute the depth layer of each pixel, and the surfaces in pixels at edges."""
        run, size, (coc, valid) = self.target.run, size_of(job.grid), image.maps
        layer, sides, mixed = labels.values()
        padded = (*bounds, *(0,) * (8 - len(bounds)))  # at most MOST_LAYERS - 1
        packed = cl.cltypes.make_int8(*padded)  # type: ignore[attr-defined]
        head = (job.grid, real_scalar(self.low, self.target.real), np.int32(self.bins), np.int32(len(bounds)), packed)
        run("label_depth_layers", size, PIXELS, job.events, *head, coc, valid, layer)
        args = (job.grid, self.spread, image.value, coc, layer, sides, *self._named("reach", "edge"))
        run("find_edges", tiles_of(job.grid), TILES, job.events, *args)
        rows = tiles_of(job.grid)[0], size[1]
        run("unmix", rows, TILES, job.events, job.grid, self.buffers["edge"], image.value, layer, sides, mixed)

    def _mark(self, job: Job) -> None:
        """Mark the tiles in which edges matter, or with alpha all."""
        marked, left = self._named("marked", "left")
        if self.alpha:
            self._fill(ONE, "marked")
        else:
            self._run_tiles(job, "mark_tiles", self.far, *self._named("reach", "edge"), marked)
        for name, which, far in (("to_plain", 0, self.far), ("to_marked", 1, self.near)):
            self._run_tiles(job, "measure_tiles", far, np.int32(which), marked, self.buffers[name])
        cl.enqueue_copy(self.target.session.queue, left, marked)

    def _sheet(
        self, job: Job, image: Image, labels: Mapping[str, cl.Buffer], index: int, bounds: tuple[int, ...]
    ) -> Sheet:  # fmt: skip
        """The sheet of depth layer number `index`, from 1."""
        run, number, (width, height) = self.target.run, np.int32(index), size_of(job.grid)
        pyramid, left, to_left = self._named("pyramid", "left", "to_left")
        sheet_reach, needed, to_needed = self._named("sheet_reach", "needed", "to_needed")
        value, coc, valid = self._named("value", "coc", "valid")
        planes = (image.value, image.maps[0], *labels.values(), pyramid)
        levels = levels_of(height, width, self.deep, self.colors + 4)
        rows, columns, _ = levels[0]
        head = (job.grid, number, np.int32(rows), np.int32(columns))
        marked = (np.int32(self.near), self.buffers["to_marked"])
        self._run_tiles(job, "measure_tiles", self.far, np.int32(1), left, to_left)
        run("open_sheet", (tiles_of(job.grid)[0], rows), TILES, job.events, *head, *marked, *planes)
        pairs = [(fine, coarse, [np.int32(n) for n in (*fine[:2], *coarse[:2], fine[2], coarse[2])])
                 for fine, coarse in pairwise(levels)]  # fmt: skip
        for _, coarse, sizes in pairs:
            run("push", coarse[1::-1], PIXELS, job.events, *sizes, pyramid)
        for level, (fine, _, sizes) in reversed(list(enumerate(pairs, 1))):
            args = (job.grid, *sizes, np.int32(1 << level), *marked, pyramid)
            run("pull", fine[1::-1], PIXELS, job.events, *args)
        self._fill(NONE, "sheet_reach")
        out = (to_left, value, coc, valid, sheet_reach)
        reach = (np.int32(self.far), self.spread)
        run("take_sheet", (tiles_of(job.grid)[0], height), TILES, job.events, *head, *reach, *planes, *out)
        self._run_tiles(job, "need_tiles", self.far, sheet_reach, left, needed)
        self._run_tiles(job, "measure_tiles", self.far, np.int32(1), needed, to_needed)
        self._fill(ZERO, "still_left")
        self.buffers["left"], self.buffers["still_left"] = self._named("still_left", "left")
        signs = signs_of(self.low, (0, *bounds, self.bins)[index - 1 : index + 1])
        return Sheet(Image(value, (coc, valid)), left, needed, to_needed, self.buffers["left"], signs)

    def _run_tiles(self, job: Job, name: str, far: int, *args: object) -> None:
        """Enqueue a kernel that looks at the tiles up to `far` px around each tile."""
        columns, rows = tiles = tiles_of(job.grid)
        head = (np.int32(rows), np.int32(columns), np.int32(-(-far // LAYER_TILE) + 1))
        self.target.run(name, tiles, TILES, job.events, *head, *args)

    def _named(self, *names: str) -> tuple[cl.Buffer, ...]:
        return tuple(self.buffers[name] for name in names)

    def _fill(self, pattern: NDArray[Any], name: str) -> None:
        buffer = self.buffers[name]
        cl.enqueue_fill_buffer(self.target.session.queue, buffer, pattern, 0, buffer.size)


def size_of(grid: Struct) -> tuple[int, int]:
    """Columns and rows of the source grid."""
    return int(grid["width"]), int(grid["height"])


def tiles_of(grid: Struct) -> tuple[int, int]:
    """Columns and rows of tiles of the source grid."""
    width, height = size_of(grid)
    return -(-width // LAYER_TILE), -(-height // LAYER_TILE)


def real_scalar(value: float, real: Real) -> np.generic:
    """A kernel argument of type real."""
    return np.float64(value) if real == "double" else np.float32(value)


def real_pair(first: float, second: float, real: Real) -> np.void:
    """A kernel argument of type real2."""
    make = cl.cltypes.make_double2 if real == "double" else cl.cltypes.make_float2  # type: ignore[attr-defined]
    pair: np.void = make(first, second)
    return pair
