"""An approximation: sources of wide blur are blurred on grids of half, a quarter, ... of the resolution.

A wide PSF has no fine detail, so its light can be added up on a coarse grid and interpolated: at s px between nodes
that takes s^4 times fewer taps. The error is that of the PSF's edge, which the grid rounds off; how far is
set by the smallest radius that a grid may hold, in its own pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import nan, sqrt
from weakref import proxy

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import frame_struct
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Program, Session
from clsco.optics.multigrid import (
    FADE,
    STEEPEST,
    coarse_frame,
    coarse_psf,
    coarse_radii,
    loss,
    plane_shape,
    sharpening,
)
from clsco.optics.psf import shape_of
from clsco.optics.psf_tables import TAP_LANES, psf_features
from clsco.passes.blur import BLOCKS, FILES_OF, PIXELS, PLAIN, Events, Sources, Spreader, image_features
from clsco.plan.memory import grid_bytes
from clsco.plan.methods import Blur
from clsco.records import Real, Struct, structs
from clsco.scene.model import Psf


@dataclass(frozen=True)
class Level:
    """A grid, what is on it, and its spreader; value and source of the finest one are those of a moment."""

    spreader: Spreader
    pitch: int
    radius: cl.Buffer
    tilt: cl.Buffer
    moved: cl.Buffer
    light: cl.Buffer
    kept: cl.Buffer
    value: cl.Buffer | None = None
    source: cl.Buffer | None = None

    @property
    def camera(self) -> Struct:
        return self.spreader.camera

    @property
    def size(self) -> tuple[int, int]:
        return int(self.camera["width"]), int(self.camera["height"])


class Coarse(Spreader):
    """A Spreader that moves sources of wide blur to coarser grids.

    least: a source moves on to the next coarser grid while its radius is at least that many px there, as long as its
    radius changes by STEEPEST px at most from it to its neighbors; sub-pixel sources and those with something in their
    way stay. features: those of the frame's own program; places: (rows, columns) of pixels at which `missed` tells what
    that changes. Other arguments and what is raised as for `Spreader`, with method "gather" or "tiles", and border
    "lose".
    Validated against `clsco.reference.blur.multigrid`, and by its error against the exact way (tests/test_coarse.py).
    """

    def __init__(
        self, session: Session, program: Program, psf: Psf, method: Blur, camera: Struct, channels: int,
        smallest: float, largest: float, subpixels: int, real: Real, brightest: float, features: Mapping[str, int],
        least: float, places: NDArray[np.int32] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(
            session, program, psf, method, camera, channels, smallest, largest, subpixels, real, brightest, features,
        )  # fmt: skip
        self.least, self.places, self.tilt = least, places, bool(features["TILT"])
        self.marked = np.int32(bool(features["SUBPIXELS"] or features["OCCLUDED"]))
        radii = coarse_radii(psf, largest, least)
        # A cycle of references would hold all buffers until the garbage collector comes by.
        self.levels = [self._level(proxy(self), True)] if radii else []
        if not radii:
            return
        coarse = coarse_psf(psf)
        tools = PLAIN | psf_features(psf) | {"CHANNELS": channels, "TILT": int(self.tilt)}
        tools["SAMPLED"] = int(shape_of(coarse).sampled)
        self.tools = build(session, ["blur/multigrid.cl"], tools, structs(real), real)
        for radius in radii:
            plain = image_features(method, coarse, radius, channels, self.tilt, session.device.has_fp64)
            inner = build(session, FILES_OF[method], plain, structs(real), real)
            above = self.levels[-1].camera
            shape = coarse_frame(*(int(above[name]) for name in ("rows", "columns", "guard")))
            spreader = Spreader(
                session, inner, coarse, method, frame_struct(*shape, real), channels, least, radius, 0, real,
                brightest, plain,
            )  # fmt: skip
            self.levels.append(self._level(spreader, False))
        if places is not None:
            self.pixels = upload(session, places)
            self.misses = empty(session, 4 * channels * len(places))

    def _level(self, spreader: Spreader, own: bool) -> Level:
        """own: the finest one, whose value and source are those of a moment."""
        width, height = int(spreader.camera["width"]), int(spreader.camera["height"])
        sizes = grid_bytes(self.channels, width, height, self.tilt, own)
        radius = _filled(self.session, sizes["radius"], nan)
        tilt, moved, light = (_filled(self.session, sizes[name], 0.0) for name in ("tilt", "moved", "light"))
        kept = empty(self.session, sizes["kept"])
        value, source = (None, None) if own else (kept, empty(self.session, sizes["source"]))
        _, pitch = plane_shape(width, height)
        return Level(spreader, pitch, radius, tilt, moved, light, kept, value, source)

    def clear(self) -> None:
        """Begin a frame."""
        super().clear()
        for level in self.levels[1:]:
            level.spreader.clear()
        if self.places is not None and self.levels:
            cl.enqueue_fill_buffer(self.session.queue, self.misses, np.zeros(1, np.float32), 0, self.misses.size)

    def add(self, sources: Sources, radius: float, events: Events) -> None:
        """Add the light of one moment; marks the records of those sources that move."""
        if self.levels:
            self._move(sources, events)
            sources = replace(sources, value=self.levels[0].kept)
        super().add(sources, radius, events)
        for level in self.levels[1:]:
            assert level.value is not None
            level.spreader.add(Sources(level.source, level.value), 0.0, events)

    def _move(self, sources: Sources, events: Events) -> None:
        finest = replace(self.levels[0], value=sources.value, source=sources.source)
        sampled, pitch = np.int32(shape_of(self.psf).sampled), np.int32(finest.pitch)
        self._run(
            "measure_radii", _blocks(*finest.size), BLOCKS, events,
            self.camera, self.struct, finest.source, self.marked, sampled, pitch, finest.radius, finest.tilt,
        )  # fmt: skip
        for fine, coarse in pairwise([finest, *self.levels[1:]]):
            lost = loss(self.psf, fine is finest)
            least = sqrt(4.0 * self.least**2 + lost)
            limits = (np.float32(least), np.float32(FADE * least), np.float32(STEEPEST), np.int32(fine.pitch))
            planes = (fine.moved, fine.light)
            self._run(
                "pick", _blocks(*fine.size), BLOCKS, events,
                fine.camera, fine.radius, fine.value, *limits, fine.source, fine.kept, *planes,
            )  # fmt: skip
            pitches = (np.int32(fine.pitch), np.int32(coarse.pitch))
            self._run(
                "halve", _blocks(*coarse.size), BLOCKS, events, fine.camera, coarse.camera, *planes, fine.tilt,
                np.float32(lost), *pitches, coarse.value, coarse.radius, coarse.tilt,
            )  # fmt: skip
            blunt = np.float32(shape_of(coarse.spreader.psf).pixel_moment / shape_of(self.psf).second_moment)
            self._run(
                "aim_nodes", coarse.size, PIXELS, events,
                coarse.camera, coarse.spreader.struct, coarse.radius, coarse.tilt, blunt, pitches[1], coarse.source,
            )  # fmt: skip
        if self.places is not None:
            count = len(self.places)
            self._run(
                "probe", (count,), (8,), events, self.camera, self.struct, finest.source, finest.light, pitch,
                *self.tables[0], np.int32(count), self.pixels, self.misses,
            )  # fmt: skip

    def image(self, events: Events, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """The frame as of `Spreader.image`, of which there are no strips; of a frame once."""
        if self.levels:
            self._sample_frame(-1.0, events)
        sharp = np.float32(sharpening(self.psf))
        for coarse, fine in pairwise(reversed(self.levels)):
            layouts = [
                argument
                for one in (coarse.spreader, fine.spreader)
                for argument in (one.camera, np.int32(one.pitch), np.int32(one.pad), one.total)
            ]
            rows, columns = int(fine.camera["rows"]), int(fine.camera["columns"])
            self._run("enlarge", _blocks(columns + 1, rows), BLOCKS, events, *layouts, sharp)
        if self.levels:
            self._sample_frame(1.0, events)
        return super().image(events, out)

    def missed(self) -> NDArray[np.float32]:
        """Error (places, channels) at `places` of the frame that `image` returned last, 0 where nothing could move."""
        count = 0 if self.places is None else len(self.places)
        if not (self.levels and count):
            return np.zeros((count, self.channels), np.float32)
        return download(self.session, self.misses, (count, self.channels), np.float32)

    def _sample_frame(self, sign: float, events: Events) -> None:
        if self.places is not None:
            layout = (self.total, np.int32(self.pitch), np.int32(self.pad), np.float32(sign))
            args = (self.camera, *layout, np.int32(len(self.places)), self.pixels, self.misses)
            self._run("sample_frame", (len(self.places),), (8,), events, *args)

    def _run(self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: object) -> None:
        events.append((name, launch(self.session, kernel(self.tools, name), size, local, *args)))  # type: ignore[arg-type]


def make_spreader(
    session: Session, program: Program, psf: Psf, method: Blur, camera: Struct, channels: int, smallest: float,
    largest: float, subpixels: int, real: Real, brightest: float, features: Mapping[str, int], least: float | None,
    places: NDArray[np.int32] | None = None,
) -> Spreader:  # fmt: skip
    """An approximating Spreader with `least` and `places` as for `Coarse`, or the exact one for least = None."""
    if least is None:
        return Spreader(
            session, program, psf, method, camera, channels, smallest, largest, subpixels, real, brightest,
            features,
        )  # fmt: skip
    return Coarse(
        session, program, psf, method, camera, channels, smallest, largest, subpixels, real, brightest, features, least,
        places,
    )  # fmt: skip


def _blocks(width: int, height: int) -> tuple[int, int]:
    """Work-items where each makes TAP_LANES numbers of a row."""
    return -(-width // TAP_LANES), height


def _filled(session: Session, size: int, value: float) -> cl.Buffer:
    """A buffer of so many bytes, all floats of one value."""
    buffer = empty(session, size)
    cl.enqueue_fill_buffer(session.queue, buffer, np.array([value], np.float32), 0, size)
    return buffer
