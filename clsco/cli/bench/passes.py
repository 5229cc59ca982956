"""The defocus pass by itself, part by part, so that it can be timed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import frame_struct
from clsco.opencl.buffers import empty, upload
from clsco.opencl.program import build
from clsco.opencl.session import Session
from clsco.optics.psf import reach
from clsco.optics.psf_tables import TAP_LANES
from clsco.passes.blur import FILES_OF, Events, Sources, image_features, prepare_sources
from clsco.passes.convolve import Convolution
from clsco.passes.multigrid import Coarse, Level, make_spreader
from clsco.plan.approximation import METHODS
from clsco.plan.memory import source_bytes
from clsco.plan.methods import Blur, many_radii
from clsco.records import Real, flat, in_parts, structs
from clsco.scene.model import Psf

Array = NDArray[Any]


class Pass:
    """The defocus pass of one image on the device, from its radii to the frame; warm after its first call.

    places: see `clsco.passes.multigrid.Coarse`, of an approximation.
    """

    def __init__(
        self,
        session: Session,
        image: Array,
        radii: Array,
        psf: Psf,
        method: str,
        real: Real,
        places: NDArray[np.int32] | None = None,
    ) -> None:
        rows, columns = radii.shape
        channels = image.shape[2] if image.ndim == 3 else 1
        size = np.abs(radii)
        smallest, self.largest = float(size.min()), float(size.max())
        constant, least = method == "convolve", METHODS.get(method)
        blur = many_radii(session.device.kind == "gpu", approximate=True) if least else cast(Blur, method)
        guard = reach(psf, self.largest) + 2 * TAP_LANES if constant else 0
        features = image_features(blur, psf, self.largest, channels, psf.tilt, session.device.has_fp64)
        self.session, self.camera = session, frame_struct(rows, columns, guard, real)
        self.program = {} if constant else build(session, FILES_OF[blur], features, structs(real), real)
        self.spreader = make_spreader(
            session, self.program, psf, blur, self.camera, channels, smallest, self.largest, 0, real,
            float(np.abs(image).max()), features, least, places,
        )  # fmt: skip
        padded = np.pad(flat(image, np.float32), ((0, 0), (guard, guard), (guard, guard)))
        source = None if constant else empty(session, source_bytes(rows * columns, psf.tilt))
        self.sources = Sources(source, upload(session, padded))
        valid = np.ones(radii.shape, np.uint8)
        self.radii: tuple[cl.Buffer, ...] = (
            () if constant else (upload(session, in_parts(radii, real)), upload(session, valid))
        )

    def missed(self) -> NDArray[np.float32]:
        """Error at the places, after a call."""
        assert isinstance(self.spreader, Coarse)
        return self.spreader.missed()

    def prepare(self, events: Events) -> None:
        """Enqueue the prepass: radii to records of sources."""
        if self.sources.source is not None:
            source, (coc, valid) = self.sources.source, self.radii
            prepare_sources(self.session, self.program, self.camera, self.spreader.struct, coc, valid, source, events)

    def spread(self, events: Events) -> None:
        """Enqueue the blur of all sources into an empty frame."""
        self.spreader.clear()
        self.spreader.add(self.sources, self.largest, events)

    def __call__(self, events: Events) -> Array:
        """All of it: the frame (rows, columns[, channels]) on the host."""
        self.prepare(events)
        self.spread(events)
        return self.spreader.image(events)

    @property
    def bytes(self) -> int:
        """Size of the buffers on the device."""
        held = _buffers([*vars(self.spreader).values(), *vars(self.sources).values(), *self.radii])
        return sum({buffer.int_ptr: int(buffer.size) for buffer in held}.values())


def _buffers(things: Sequence[object]) -> Iterator[cl.Buffer]:
    for thing in things:
        if isinstance(thing, cl.Buffer):
            yield thing
        elif isinstance(thing, Convolution):
            yield from _buffers([*vars(thing).values()])
        elif isinstance(thing, Level):
            yield from _buffers([*vars(thing).values(), *(vars(thing.spreader).values() if thing.source else ())])
        elif isinstance(thing, list | tuple):
            yield from _buffers(thing)
