"""Host side of layered occlusion, which blurs sheets with their coverage and lays them over each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl

from clsco.frame.strips import Grid
from clsco.opencl.buffers import empty
from clsco.passes.blur import PIXELS, BehindRims, BlurredPlane, Image, Plane, Sources, blur_target, prepare_sources
from clsco.passes.clusters import TILES, ZERO, Clusters, Layers, Sheet, size_of, tiles_of
from clsco.passes.frame_blur import make_blur
from clsco.passes.job import Job
from clsco.plan.buffers import layered_buffers, sheet_spec

ONE = np.ones(1, np.float32)


class DepthLayers:
    """Blurs depth layers into a plane, with occlusion based on the pinhole image: psf.occlusion = "layered".

    Call `add` of this class instead of that of the blur.

    Parameters
    ----------
    blur : BlurredPlane
        Blur of the frame or strip, by one of MANY_RADII and without sub-pixel sources.
    clusters : Clusters
        Source of the layers.
    tallest : Grid
        Grid of the frame, or the tallest of its strips.
    behind_rims : callable, optional
        As for `clsco.engine.workspace.BlurWorkspace`.

    Raises
    ------
    DeviceError, KernelError

    Notes
    -----
    In tiles with an edge in reach, radiance, coverage and ones of a sheet are blurred together by the PSF; the ratio of
    the first and the last, times the fraction of the lens that nearer sheets leave free, is added to the frame. Other
    tiles have the bits of psf.occlusion = "none". Validated against `clsco.reference.layered.layered` and the ray
    tracer.
    """

    def __init__(
        self, blur: BlurredPlane, clusters: Clusters, tallest: Grid, behind_rims: BehindRims | None = None
    ) -> None:  # fmt: skip
        self.target, self.spread, spec = clusters.target, clusters.spread, sheet_spec(blur.spec)
        session, planes = self.target.session, clusters.colors + 2
        target = blur_target(session, spec, planes, self.target.real)
        self.outer, self.inner = blur, make_blur(target, spec, replace(tallest, channels=planes), blur.grid)
        sizes = layered_buffers(blur.spec, tallest, session.device)
        self.source, self.room, self.light = (empty(session, sizes[name]) for name in ("source", "room", "light"))
        self.behind_rims = behind_rims
        self.depth = empty(session, sizes["depth"]) if "depth" in sizes else None

    def add(self, job: Job, layers: Layers) -> Plane:
        """Enqueue kernels that blur layers into the frame or strip; returns its plane."""
        behind: dict[str, Any] = {}
        if self.depth is not None and self.behind_rims is not None:
            behind = self.behind_rims(job) | {"depth": self.depth}
        several = layers.count > 1 or layers.image is None
        if several:
            self._begin(job, behind)
        for sheet in layers.sheets:
            self._lay(job, sheet, behind)
        if layers.image is not None:
            sources = self._sources(job, self.outer, layers.image, behind)
            if several:
                self._keep(job, layers.image, layers.to_plain)
            # Last, since border = "renormalize" overwrites the radiance of the image.
            self.outer.add(sources, job.events)
        plane = self.outer.plane(job.events)
        if several:
            args = (job.grid, np.int32(self.outer.pitch), np.int32(self.outer.pad), layers.marked)
            out = (self.light, self.room, plane.buffer)
            self.target.run("put_layers", (tiles_of(job.grid)[0], self.outer.size[1]), TILES, job.events, *args, *out)
        return plane

    def _begin(self, job: Job, behind: dict[str, Any]) -> None:
        """Begin a frame without light, in which the lens is free but for rims."""
        queue, (columns, rows) = self.target.session.queue, self.outer.size
        free = 4 * self.inner.spec.cells**2 * rows * columns  # bytes; another plane is the light of ones
        for buffer in (self.light, self.room):
            cl.enqueue_fill_buffer(queue, buffer, ZERO, 0, buffer.size)
        cl.enqueue_fill_buffer(queue, self.room, ONE, 0, free)
        if behind:
            args = (job.grid, self.inner.struct, behind["lens"], self.inner.lens_cells, self.room)
            self.inner.target.run("open_share", self.outer.size, PIXELS, job.events, *args)

    def _sources(self, job: Job, blur: BlurredPlane, image: Image, behind: dict[str, Any]) -> Sources:
        rims = (behind["lens"], behind["depth"]) if behind else ()
        prepare_sources(self.inner.target, job.grid, blur.struct, image.maps, self.source, job.events, rims)
        return Sources(self.source, image.value, **behind)

    def _keep(self, job: Job, image: Image, distance: cl.Buffer, sign: int = 0) -> None:
        """Discard the sources that do not reach the nearest tile, `distance` px away, and unless `sign` is 0, those
        whose radius has another one.
        """
        args = (job.grid, self.spread, np.int32(sign), image.maps[0], distance, self.source)
        self.target.run("keep_sources", (tiles_of(job.grid)[0], size_of(job.grid)[1]), TILES, job.events, *args)

    def _lay(self, job: Job, sheet: Sheet, behind: dict[str, Any]) -> None:
        """Blur a sheet, and lay it behind the previous ones."""
        inner, by_quadrants = self.inner, self.inner.spec.by_quadrants
        inner.begin(job.grid)
        for sign in sheet.signs if by_quadrants else (0,):
            sources = self._sources(job, inner, sheet.image, behind)
            self._keep(job, sheet.image, sheet.to_needed, sign)
            for side in (1, -1) if by_quadrants else (0,):
                # A positive radius lights the pixels on the side of the lens point, a negative one those opposite.
                row, right = 2 * (side * sign < 0), int(sign < 0)
                half = tuple(map(np.int32, (side, row + right, row + 1 - right)))
                inner.add(replace(sources, half=half if by_quadrants else ()), job.events)
        inner.resolve(job.events)
        args = (job.grid, *inner.layout, sheet.left, sheet.needed, self.room, self.light, sheet.still_left)
        args += (sheet.image.maps[0],) if by_quadrants else ()
        self.target.run("composite", (tiles_of(job.grid)[0], inner.size[1]), TILES, job.events, *args)
