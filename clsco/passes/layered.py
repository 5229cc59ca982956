"""Host side of layered occlusion, which blurs each depth layer with its coverage and composites front to back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl

from clsco.frame.strips import Grid
from clsco.opencl.buffers import empty
from clsco.opencl.program import Target
from clsco.passes.blur import PIXELS, BehindRims, BlurredPlane, Image, Sources, blur_target, prepare_sources
from clsco.passes.clusters import ZERO, Layers
from clsco.passes.frame_blur import make_blur
from clsco.passes.job import Job
from clsco.plan.buffers import depth_layer_spec, layered_buffers


class DepthLayers:
    """Blurs depth layers into a plane, with occlusion based on the pinhole image: psf.occlusion = "layered".

    Call `add` of this class instead of that of the blur.

    Parameters
    ----------
    blur : BlurredPlane
        Blur of the frame or strip, by one of MANY_RADII and without sub-pixel sources.
    target : Target
        Target of `layered_program`.
    tallest : Grid
        Grid of the frame, or the tallest of its strips.
    behind_rims : callable, optional
        As for `clsco.engine.workspace.BlurWorkspace`.

    Raises
    ------
    DeviceError, KernelError

    Notes
    -----
    Near discontinuities, radiance and coverage of a layer are blurred together by the PSF, and weighted at each pixel
    by the fraction that nearer layers leave uncovered; elsewhere radiance is simply added. A bound that cuts a
    continuous surface has no visible effect. With one layer, the frame is bit-identical to that with psf.occlusion =
    "none". Validated against `clsco.reference.layered.layered` and the ray tracer.
    """

    def __init__(
        self, blur: BlurredPlane, target: Target, tallest: Grid, behind_rims: BehindRims | None = None
    ) -> None:  # fmt: skip
        session, real, spec, planes = target.session, target.real, depth_layer_spec(blur.spec), tallest.channels + 1
        layer_target = blur_target(session, spec, planes, real)
        self.outer, self.inner = blur, make_blur(layer_target, spec, replace(tallest, channels=planes), blur.grid)
        self.target = Target(session, layer_target.program | target.program, real)
        sizes = layered_buffers(blur.spec, tallest, session.device)
        self.source, self.covered = (empty(session, sizes[name]) for name in ("source", "covered"))
        self.behind_rims = behind_rims
        self.depth, self.open = (empty(session, sizes[name]) if name in sizes else None for name in ("depth", "open"))

    def add(self, job: Job, layers: Layers) -> None:
        """Enqueue kernels that add the radiance of layers to the frame or strip."""
        behind: dict[str, Any] = {}
        if self.depth is not None and self.behind_rims is not None:
            behind = self.behind_rims(job) | {"depth": self.depth}
        if layers.count > 1:
            cl.enqueue_fill_buffer(self.target.session.queue, self.covered, ZERO, 0, self.covered.size)
            if behind:
                args = (job.grid, self.inner.struct, behind["lens"], self.inner.lens_cells, self.open)
                self.target.run("open_share", self.inner.size, PIXELS, job.events, *args)
        for layer in layers.images:
            self._blur(job, layer, layers.edge, behind)
        sources = self._sources(job, self.outer, layers.image, behind)
        if layers.count > 1:
            self._keep(job, layers.edge, near_edges=False)
        # Last, since border = "renormalize" overwrites the radiance of the image.
        self.outer.add(sources, job.events)

    def _sources(self, job: Job, blur: BlurredPlane, image: Image, behind: dict[str, Any]) -> Sources:
        rims = (behind["lens"], behind["depth"]) if behind else ()
        prepare_sources(self.target, job.grid, blur.struct, image.maps, self.source, job.events, rims)
        return Sources(self.source, image.value, **behind)

    def _keep(self, job: Job, edge: cl.Buffer, near_edges: bool) -> None:
        """Discard the sources away from edges if `near_edges` is True, otherwise those near edges."""
        size = int(job.grid["width"]), int(job.grid["height"])
        args = (job.grid, np.int32(near_edges), edge, self.source)
        self.target.run("keep_sources", size, PIXELS, job.events, *args)

    def _blur(self, job: Job, layer: Image, edge: cl.Buffer, behind: dict[str, Any]) -> None:
        """Blur a depth layer, and composite it behind the previous layers."""
        inner, frame = self.inner, (int(job.grid["columns"]), int(job.grid["rows"]))
        sources = self._sources(job, inner, layer, behind)
        self._keep(job, edge, near_edges=True)
        inner.begin(job.grid)
        inner.add(sources, job.events)
        inner.resolve(job.events)
        room = (self.covered, self.open) if behind else (self.covered,)
        args = (job.grid, *inner.layout, *room, *self.outer.sink)
        self.target.run("composite", frame, PIXELS, job.events, *args)
