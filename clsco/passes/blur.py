"""Host side of the blur: a class for each method, which computes the blurred plane of a time sample."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from math import log
from typing import Any, Literal

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import GROUP_COLUMNS, GROUP_ROWS, TAP_LANES
from clsco.frame.strips import Grid
from clsco.opencl.buffers import empty, mapped, upload, upload_cached
from clsco.opencl.program import Events, Target
from clsco.opencl.session import Session
from clsco.optics.psf_tables import psf_features
from clsco.optics.ray_means import has_ray_means, ray_means
from clsco.optics.visibility import lens_floats
from clsco.passes.pack import psf_struct
from clsco.passes.tables import tables_of
from clsco.plan.buffers import Sizes, by_columns, has_spans, margin
from clsco.plan.methods import MANY_RADII, Blur, BlurSpec
from clsco.records import Real, Struct

PIXELS = (64, 1)  # local size of kernels with a work-item per pixel
BLOCKS = (8, 1)  # local size of kernels with a work-item per TAP_LANES pixels of a row
GROUP = (GROUP_COLUMNS, GROUP_ROWS)  # local size of `tiles`
# With pillboxes, a pixel gets at most 2.6 + 2 ln R times the light of the brightest source; tilt at most doubles this.
GAIN, GAIN_PER_LOG, TILT_GAIN = 2.6, 2.0, 2.0

# Kernel files of each method in `blur_target`; `convolve` has a target of its own.
FILES_OF: dict[Blur, tuple[str, ...]] = {
    "gather": ("blur/prepare.cl", "blur/blur.cl", "blur/cpu/gather.cl"),
    "scatter": ("blur/prepare.cl", "blur/blur.cl"),
    "tiles": ("blur/prepare.cl", "blur/blur.cl", "blur/tiles.cl"),
    "convolve": (),
}

# Units of work (`clsco.opencl.pace`) per tap, if taps are counted as if all sources had the largest radius.
UNITS_PER_TAP = 1 / 125

Maps = Literal["none", "wide", "float"]
"""Radii that `prepare_sources` reads: "none"; "wide", a map of type real, and a mask; "float", a map of type float."""
MAPS: tuple[Maps, ...] = ("none", "wide", "float")


def blur_features(spec: BlurSpec, channels: int, fp64: bool, maps: Maps) -> dict[str, int]:
    """Features that the blur's kernels are compiled for; scenes with the same features share a program."""
    method, psf = spec.method, spec.psf
    return psf_features(psf) | {
        "CHANNELS": channels,
        "TILT": int(spec.tilt and method != "convolve"),
        "SUBPIXELS": spec.subpixels,
        "SMALL": int(spec.small),
        "OCCLUDED": spec.occluders,
        "LIMITED": int(spec.limited),
        "CURVED": spec.curved,
        "SHARED": int(spec.shared),
        "RAYS": int(spec.occluders > 0 and has_ray_means(psf)),
        "GATHER": int(method == "gather"),
        "BY_COLUMNS": int(method == "gather" and by_columns(psf)),
        "SPANS": int(has_spans(spec, fp64)),
        "SCATTER": int(method == "scatter"),
        "RENORMALIZE": int(spec.border == "renormalize" and method != "none"),
        "QUADRANTS": int(spec.by_quadrants),
        "PREPARE": MAPS.index(maps) if method in MANY_RADII else 0,
    }


def blur_target(session: Session, spec: BlurSpec, channels: int, real: Real, maps: Maps = "wide") -> Target:
    """Target of the blur with `blur_features`; it has no kernels for `convolve`, which has its own target."""
    features = blur_features(spec, channels, session.device.has_fp64, maps)
    return Target(session, FILES_OF[spec.method], features, real)


@dataclass(frozen=True)
class Image:
    """An image with guard band on the device, float (channels, height, width), and its blur radii.

    maps: signed R in px, real (height, width), and a mask of pixels with known R, uchar (height, width); or only R, as
    float, if it is known in all pixels; empty for an image with a single radius.
    """

    value: cl.Buffer
    maps: tuple[cl.Buffer, ...]


@dataclass(frozen=True)
class Sources:
    """Sources of one time sample on the device, in the layout of trace/cast.cl.

    source: planes of sources in frame and guard band (sources.clh), None for "convolve" and "none"; value: radiance of
    the sources; sub_source, sub_value: sub-pixel sources in slots for `capacity` pixels, and their radiance.

    lens, surfaces, group, depth, sub_depth: for visibility tests, None if no light is hidden. surfaces: those of all
    objects; group: has the occluders; depth, sub_depth: inverse depths of sources and of sub-pixel sources.

    radius: |R| of all sources in px, for "convolve" only; label: label of the ray hits, if rays were cast; bends: plane
    of `clsco.passes.bend.Bends`, if blurs are ellipses; half: QUADRANT_ARGUMENTS of psf.clh for `by_quadrants`.
    """

    source: cl.Buffer | None
    value: cl.Buffer
    sub_source: cl.Buffer | None = None
    sub_value: cl.Buffer | None = None
    capacity: int = 0
    lens: Struct | None = None
    surfaces: cl.Buffer | None = None
    group: Struct | None = None
    depth: cl.Buffer | None = None
    sub_depth: cl.Buffer | None = None
    radius: float = 0.0
    label: cl.Buffer | None = None
    bends: cl.Buffer | None = None
    half: tuple[np.int32, ...] = ()


BehindRims = Callable[[Any], dict[str, Any]]
"""Returns for a job the fields `lens`, `surfaces` and `group` of `Sources`, without occluders: only rims hide light."""


def prepare_sources(
    target: Target, grid: Struct, psf: Struct, maps: tuple[cl.Buffer, ...], source: cl.Buffer, events: Events,
    rims: tuple[object, ...] = (),
) -> None:  # fmt: skip
    """Enqueue the kernel that turns a map of signed radii, in the form of `Image.maps`, into the planes `source`.

    psf: psf_t of the blur that will add the sources; rims: lens_t and a buffer for inverse depths if rims cut the light
    of the sources, else empty.
    """
    size = -(-int(grid["width"]) // TAP_LANES), int(grid["height"])
    coc, valid = (*maps, None)[:2]
    target.run("prepare_sources", size, BLOCKS, events, grid, psf, coc, valid, source, *rims)


@dataclass(frozen=True)
class Plane:
    """An image of `rows` and `columns` on the device that is part of a larger array of floats.

    shape: channels, rows and columns of the array. top, left: row and column of the array at which the image begins.
    """

    buffer: cl.Buffer
    shape: tuple[int, int, int]
    rows: int
    columns: int
    top: int = 0
    left: int = 0

    @property
    def layout(self) -> tuple[object, ...]:
        """Kernel arguments: buffer; in floats, distance of channels, start of the image and distance of rows."""
        _, height, pitch = self.shape
        return self.buffer, np.int32(height * pitch), np.int32(self.top * pitch + self.left), np.int32(pitch)

    def read(self, session: Session, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """The image (rows, columns[, channels]) on the host, in `out` if given; waits for the device."""
        if out is None:
            size = (self.rows, self.columns)
            out = np.empty(size if self.shape[0] == 1 else (*size, self.shape[0]), np.float32)
        with mapped(session, self.buffer, self.shape) as planes:
            image = planes[:, self.top : self.top + self.rows, self.left : self.left + self.columns]
            out[...] = image[0] if len(image) == 1 else np.moveaxis(image, 0, -1)
        return out


def padded_plane(grid: Struct, buffer: cl.Buffer, channels: int) -> Plane:
    """The frame's part of an image with guard band: the blurred plane of a scene without blur. buffer: the image."""
    names = ("columns", "rows", "width", "height", "above", "guard")
    columns, rows, width, height, above, guard = (int(grid[name]) for name in names)
    return Plane(buffer, (channels, height, width), rows, columns, above, guard)


class BlurredPlane(ABC):
    """The blurred image of a time sample; base class of all methods of blur.

    tallest: grid of the frame, or of the tallest of its strips; grid: grid_t of the first strip, replaced by `begin`;
    sizes: sizes from `clsco.plan.buffers.blur_buffers`.
    """

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid, grid: Struct, sizes: Sizes) -> None:
        self.target, self.spec, self.grid, self.channels = target, spec, grid, tallest.channels
        self.weights = tables_of(spec, target.session)
        self.struct = psf_struct(spec.psf, *self.weights, target.real)
        self.pad, self.pitch = margin(tallest.columns, tallest.guard, spec.reach)
        self.total = empty(target.session, sizes["total"])
        self.rays = None
        if spec.occluders and has_ray_means(spec.psf):
            self.rays = upload(target.session, ray_means(spec.psf, spec.largest).floats())
        self.lens_cells = upload(target.session, lens_floats(spec.psf).astype(np.float32)) if spec.occluders else None

    @property
    def layout(self) -> tuple[object, ...]:
        """Kernel arguments of the plane: length of a row, number of scratch columns to its left, buffer."""
        return np.int32(self.pitch), np.int32(self.pad), self.total

    @property
    def sink(self) -> tuple[Any, ...]:
        """Kernel arguments of the buffer to which `add` adds radiance."""
        return self.layout

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the strip."""
        return int(self.grid["columns"]), int(self.grid["rows"])

    def begin(self, grid: Struct) -> None:
        """Begin a time sample with no radiance; grid: grid_t of the frame or strip."""
        self.grid = grid
        self.clear()

    def clear(self) -> None:
        """Set all radiance to 0."""
        *_, buffer = self.sink
        cl.enqueue_fill_buffer(self.target.session.queue, buffer, np.zeros(1, np.uint32), 0, buffer.size)

    @abstractmethod
    def add(self, sources: Sources, events: Events) -> None:
        """Enqueue kernels that add the blurred radiance of sources."""

    def resolve(self, events: Events) -> None:  # noqa: B027  most methods add directly to the plane
        """Enqueue kernels that convert the sums in `sink` to the image in `layout`; most methods need none."""

    def plane(self, events: Events) -> Plane:
        """The image of all sources added so far; valid until the next time sample begins."""
        self.resolve(events)
        columns, rows = self.size
        return Plane(self.total, (self.channels, rows, self.pitch), rows, columns, left=self.pad)


class TableBlur(BlurredPlane):
    """A blur of sources with different radii, by weights from tables."""

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid, grid: Struct, sizes: Sizes) -> None:
        super().__init__(target, spec, tallest, grid, sizes)
        session = target.session
        self.tables = [
            (
                upload_cached(session, table.intervals, (table.place, "intervals")),
                upload_cached(session, table.coefficients, (table.place, "coefficients")),
            )
            for table in self.weights
            if table is not None
        ]

    def add(self, sources: Sources, events: Events) -> None:
        head = (self.grid, self.struct, sources.source, sources.value, *self.tables[0])
        tail: tuple[object, ...] = ()
        if self.spec.subpixels:
            tail = (sources.sub_source, sources.sub_value, np.int32(sources.capacity), *self.tables[1])
        bends = (sources.bends,) if self.spec.psf.stretched else ()
        if self.spec.border == "renormalize":
            size = int(self.grid["columns"]), int(self.grid["height"])
            self.target.run("renormalize", size, PIXELS, events, *head, *tail, *bends)
        if sources.group is not None:
            tail += (sources.lens, sources.surfaces, sources.group, self.lens_cells)
            tail += (sources.depth,) if self.rays is None else (self.rays, sources.depth)
            tail += (sources.sub_depth,) if self.spec.subpixels else ()
        self.spread(head, (*tail, *bends, *sources.half), events)

    @abstractmethod
    def spread(self, head: tuple[object, ...], tail: tuple[object, ...], events: Events) -> None:
        """Enqueue the kernels of the method; head, tail: first and last kernel arguments, which all methods share."""


class Tiles(TableBlur):
    """Method "tiles": each work-item gathers the sources that reach its pixel, from a list of its work-group."""

    def spread(self, head: tuple[object, ...], tail: tuple[object, ...], events: Events) -> None:
        work = UNITS_PER_TAP * (2 * self.spec.reach + 1) ** 2
        self.target.run("tiles", self.size, GROUP, events, *head, *self.layout, *tail, work=work)


class Scatter(TableBlur):
    """Method "scatter": each work-item adds a source to all pixels that the source reaches, by integer atomics."""

    def __init__(self, target: Target, spec: BlurSpec, tallest: Grid, grid: Struct, sizes: Sizes) -> None:
        super().__init__(target, spec, tallest, grid, sizes)
        wide = target.session.device.has_int64_atomics
        gain = TILT_GAIN * (GAIN + GAIN_PER_LOG * log(max(spec.largest, 1.0)))
        most = 2.0 ** (40 if wide else 31) / (max(spec.brightest, 1e-30) * (1.0 if wide else gain))
        self.scale = min(most, 2.0**126)  # a finite float32, even without radiance
        self.sums = empty(target.session, sizes["sums"])

    @property
    def sink(self) -> tuple[object, ...]:
        return np.float32(self.scale), self.sums

    def spread(self, head: tuple[object, ...], tail: tuple[object, ...], events: Events) -> None:
        padded = (int(self.grid["width"]), int(self.grid["height"]))
        work = UNITS_PER_TAP * (2 * self.spec.reach + 1) ** 2
        self.target.run("scatter", padded, PIXELS, events, *head, *self.sink, *tail, work=work)

    def resolve(self, events: Events) -> None:
        layout = np.int32(self.pitch), np.int32(self.pad), self.sums, self.total
        self.target.run("resolve", self.size, PIXELS, events, self.grid, np.float32(self.scale), *layout)
