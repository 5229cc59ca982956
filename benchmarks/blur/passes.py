"""The defocus pass by itself, part by part, so that it can be timed."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import TAP_LANES
from clsco.frame.strips import Grid
from clsco.opencl.buffers import empty, upload
from clsco.opencl.program import Events
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.passes.blur import Sources, blur_target, prepare_sources
from clsco.passes.frame_blur import make_blur
from clsco.passes.pack import grid_struct
from clsco.plan.buffers import source_bytes
from clsco.plan.image import ImagePlan
from clsco.plan.memory import buffer_bytes
from clsco.plan.methods import Blur, BlurSpec
from clsco.records import REAL, Real, flat
from clsco.scene.model import Psf

Array = NDArray[Any]


class MeasuredPass:
    """The defocus pass of one image on the device, from its radii to the frame; warm after its first call."""

    def __init__(self, session: Session, image: Array, radii: Array, psf: Psf, method: str, real: Real) -> None:
        rows, columns = radii.shape
        channels = image.shape[2] if image.ndim == 3 else 1
        size = np.abs(radii)
        self.largest = float(size.max())
        constant, blur = method == "convolve", cast(Blur, method)
        guard = point_spread(psf).reach(self.largest) + 2 * TAP_LANES if constant else 0
        brightest = float(np.abs(image).max())
        spec = BlurSpec(
            point_spread(psf),
            blur,
            float(size.min()),
            self.largest,
            tilt=psf.tilt,
            brightest=brightest,
            border=psf.border,
        )
        self.grid, self.target = grid_struct(rows, columns, guard, real), blur_target(session, spec, channels, real)
        grid = Grid.whole(rows, columns, guard, channels)
        self.blur = make_blur(self.target, spec, grid, self.grid)
        self.sizes = buffer_bytes(ImagePlan(spec, session.device, rows, columns, channels, guard))
        padded = np.pad(flat(image, np.float32), ((0, 0), (guard, guard), (guard, guard)))
        source = None if constant else empty(session, source_bytes(rows * columns, psf.tilt))
        self.sources = Sources(source, upload(session, padded), radius=self.largest)
        valid = np.ones(radii.shape, np.uint8)
        self.radii: tuple[cl.Buffer, ...] = (
            () if constant else (upload(session, radii.astype(REAL[real])), upload(session, valid))
        )

    def prepare(self, events: Events) -> None:
        """Enqueue the prepass: radii to records of sources."""
        if self.sources.source is not None:
            coc, valid = self.radii
            struct, source = self.blur.struct, self.sources.source
            prepare_sources(self.target, self.grid, struct, (coc, valid), source, events)

    def spread(self, events: Events) -> None:
        """Enqueue the blur of all sources into an empty frame."""
        self.blur.clear()
        self.blur.add(self.sources, events)

    def __call__(self, events: Events) -> Array:
        """All of it: the frame (rows, columns[, channels]) on the host."""
        self.prepare(events)
        self.spread(events)
        return self.blur.plane(events).read(self.target.session)

    @property
    def bytes(self) -> int:
        """Size of the buffers on the device."""
        return sum(self.sizes.values())
