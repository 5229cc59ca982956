"""Host side of layered occlusion: depth layers, each blurred with its coverage, composited front to back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyopencl as cl

from clsco.frame.strips import Grid
from clsco.opencl.buffers import empty
from clsco.passes.blur import PIXELS, Area, BlurredPlane, Image, Sources, Target, blur_target, prepare_sources
from clsco.passes.clusters import ZERO, Layers
from clsco.passes.frame_blur import make_blur
from clsco.plan.buffers import depth_layer_spec, layered_buffers


class DepthLayers:
    """Blurs depth layers into a plane, with occlusion from what the pinhole sees: psf.occlusion = "layered".

    `add` takes the place of that of the frame's blur.

    Parameters
    ----------
    blur : BlurredPlane
        Blur of the frame, or a strip of it, by one of MANY_RADII and without sub-pixel sources.
    target : Target
        Target of `layered_program`.
    tallest : Grid
        Grid of the frame, or the tallest of its strips.

    Raises
    ------
    DeviceError, KernelError

    Notes
    -----
    Near discontinuities the radiance of a layer and its coverage are blurred by the PSF as one image, and it gets at
    each pixel the room that the coverage of nearer layers leaves; elsewhere radiance simply adds up. A cut through a
    continuous surface, which has no hidden part, shows nowhere; with one layer the frame is that of psf.occlusion =
    "none", to the bit.
    Validated against `clsco.reference.layered.layered` and the ray tracer.
    """

    def __init__(self, blur: BlurredPlane, target: Target, tallest: Grid) -> None:
        session, real, spec, planes = target.session, target.real, depth_layer_spec(blur.spec), tallest.channels + 1
        own = blur_target(session, spec, planes, real)
        self.outer, self.inner = blur, make_blur(own, spec, replace(tallest, channels=planes), blur.grid)
        self.target = Target(session, own.program | target.program, real)
        sizes = layered_buffers(blur.spec, tallest, session.device)
        self.source, self.covered = (empty(session, sizes[name]) for name in ("source", "covered"))

    def add(self, at: Area, layers: Layers) -> None:
        """Add the radiance of layers to the frame, or strip."""
        if layers.count > 1:
            cl.enqueue_fill_buffer(self.target.session.queue, self.covered, ZERO, 0, self.covered.size)
        for layer in layers.each:
            self._blur(at, layer, layers.edge)
        prepare_sources(self.target, at.grid, self.outer.struct, layers.image.maps, self.source, at.events)
        if layers.count > 1:
            self._keep(at, layers.edge, near_edges=False)
        # Last, since border = "renormalize" writes to its value.
        self.outer.add(Sources(self.source, layers.image.value), at.events)

    def _keep(self, at: Area, edge: cl.Buffer, near_edges: bool) -> None:
        """Leave only the sources near edges, or only the others."""
        size = int(at.grid["width"]), int(at.grid["height"])
        args = (at.grid, np.int32(near_edges), edge, self.source)
        self.target.run("keep_sources", size, PIXELS, at.events, *args)

    def _blur(self, at: Area, layer: Image, edge: cl.Buffer) -> None:
        """Blur the depth layer and put it behind those before."""
        inner, frame = self.inner, (int(at.grid["columns"]), int(at.grid["rows"]))
        prepare_sources(self.target, at.grid, inner.struct, layer.maps, self.source, at.events)
        self._keep(at, edge, near_edges=True)
        inner.begin(at.grid)
        inner.add(Sources(self.source, layer.value), at.events)
        inner.resolve(at.events)
        args = (at.grid, *inner.layout, self.covered, *self.outer.sink)
        self.target.run("composite", frame, PIXELS, at.events, *args)
