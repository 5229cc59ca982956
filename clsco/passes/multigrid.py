"""An approximation: sources of wide blur are blurred on grids of half, a quarter, ... of the resolution.

A wide PSF has no fine detail, so its radiance can be added up on a coarse grid and interpolated: at s px between nodes
that takes s^4 times fewer taps. The error is that of the PSF's edge, which the grid rounds off; how far is
set by the smallest radius that a grid may hold, in its own pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import nan, sqrt

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import TAP_LANES
from clsco.frame.strips import Grid, frame_struct
from clsco.opencl.buffers import download, empty, filled_with, upload
from clsco.opencl.program import build
from clsco.optics.multigrid import (
    FADE,
    STEEPEST,
    coarse_psf,
    coarse_radii,
    loss,
    plane_shape,
    sharpening,
)
from clsco.optics.psf import shape_of
from clsco.optics.psf_tables import psf_features
from clsco.passes.blur import (
    BLOCKS,
    PIXELS,
    PLAIN,
    Events,
    FrameBlur,
    FrameSum,
    Sources,
    TableBlur,
    Target,
    blur_target,
)
from clsco.passes.exact import exact_blur
from clsco.plan.buffers import coarser_grid, coarser_spec, level_buffers
from clsco.plan.methods import BlurSpec
from clsco.records import Struct, structs


@dataclass(frozen=True)
class Level:
    """A grid, what is on it, and its blur; value and source of the finest one are those of a time sample."""

    blur: FrameSum
    pitch: int
    radius: cl.Buffer
    tilt: cl.Buffer | None
    moved: cl.Buffer
    light: cl.Buffer
    kept: cl.Buffer
    value: cl.Buffer | None = None
    source: cl.Buffer | None = None

    @property
    def camera(self) -> Struct:
        return self.blur.camera

    @property
    def size(self) -> tuple[int, int]:
        return int(self.camera["width"]), int(self.camera["height"])


class Multigrid:
    """A blur that moves sources of wide blur to coarser grids; a `FrameBlur`.

    A source moves on to the next coarser grid while its radius is at least `spec.least` px there, as long as its radius
    changes by STEEPEST px at most from it to its neighbors; sub-pixel sources and those with something in their way
    stay.

    Parameters
    ----------
    blur : FrameSum
        Of the frame's own grid, by "gather" or "tiles", with border "lose".
    grid : Grid
        Of the whole frame.
    places : ndarray of int32 (n, 2), optional
        (row, column) of pixels at which `missed` reports what that changes.

    Notes
    -----
    Validated against `clsco.reference.blur.multigrid`, and by its error against the exact blur.
    """

    def __init__(self, blur: FrameSum, grid: Grid, places: NDArray[np.int32] | None = None) -> None:
        spec, session, real = blur.spec, blur.target.session, blur.target.real
        assert spec.least is not None
        self.blur, self.places = blur, places
        radii = coarse_radii(spec.psf, spec.largest, spec.least)
        self.levels = [_level(blur, grid, True)] if radii else []
        if not radii:
            return
        features = PLAIN | psf_features(spec.psf) | {"CHANNELS": grid.channels, "TILT": int(spec.tilt)}
        features["SAMPLED"] = int(shape_of(coarse_psf(spec.psf)).sampled)
        self.tools = Target(session, build(session, ["blur/multigrid.cl"], features, structs(real), real), real)
        for radius in radii:
            grid, inner = coarser_grid(grid), coarser_spec(spec, radius)
            camera = frame_struct(grid.rows, grid.columns, grid.guard, real)
            target = blur_target(session, inner, grid.channels, real)
            self.levels.append(_level(exact_blur(target, inner, grid, camera), grid, False))
        if places is not None:
            self.pixels = upload(session, places)
            self.misses = empty(session, 4 * grid.channels * len(places))

    @property
    def camera(self) -> Struct:
        return self.blur.camera

    @camera.setter
    def camera(self, camera: Struct) -> None:
        self.blur.camera = camera

    @property
    def spec(self) -> BlurSpec:
        return self.blur.spec

    @property
    def channels(self) -> int:
        return self.blur.channels

    @property
    def struct(self) -> Struct:
        return self.blur.struct

    @property
    def layout(self) -> tuple[object, ...]:
        return self.blur.layout

    @property
    def sink(self) -> tuple[object, ...]:
        return self.blur.sink

    def clear(self) -> None:
        self.blur.clear()
        for level in self.levels[1:]:
            level.blur.clear()
        if self.places is not None and self.levels:
            queue = self.blur.target.session.queue
            cl.enqueue_fill_buffer(queue, self.misses, np.zeros(1, np.float32), 0, self.misses.size)

    def add(self, sources: Sources, events: Events) -> None:
        """Add the radiance of one time sample; marks the records of those sources that move."""
        if self.levels:
            self._move(sources, events)
            sources = replace(sources, value=self.levels[0].kept)
        self.blur.add(sources, events)
        for level in self.levels[1:]:
            assert level.value is not None
            level.blur.add(Sources(level.source, level.value), events)

    def _move(self, sources: Sources, events: Events) -> None:
        finest, spec = replace(self.levels[0], value=sources.value, source=sources.source), self.spec
        sampled, pitch = np.int32(shape_of(spec.psf).sampled), np.int32(finest.pitch)
        self.tools.run(
            "measure_radii", _blocks(*finest.size), BLOCKS, events,
            self.camera, self.struct, finest.source, np.int32(spec.marked), sampled, pitch, finest.radius, finest.tilt,
        )  # fmt: skip
        for fine, coarse in pairwise([finest, *self.levels[1:]]):
            lost = loss(spec.psf, fine is finest)
            assert spec.least is not None
            least = sqrt(4.0 * spec.least**2 + lost)
            limits = (np.float32(least), np.float32(FADE * least), np.float32(STEEPEST), np.int32(fine.pitch))
            planes = (fine.moved, fine.light)
            self.tools.run(
                "pick", _blocks(*fine.size), BLOCKS, events,
                fine.camera, fine.radius, fine.value, *limits, fine.source, fine.kept, *planes,
            )  # fmt: skip
            pitches = (np.int32(fine.pitch), np.int32(coarse.pitch))
            self.tools.run(
                "halve", _blocks(*coarse.size), BLOCKS, events, fine.camera, coarse.camera, *planes, fine.tilt,
                np.float32(lost), *pitches, coarse.value, coarse.radius, coarse.tilt,
            )  # fmt: skip
            blunt = np.float32(shape_of(coarse.blur.spec.psf).pixel_moment / shape_of(spec.psf).second_moment)
            self.tools.run(
                "aim_nodes", coarse.size, PIXELS, events,
                coarse.camera, coarse.blur.struct, coarse.radius, coarse.tilt, blunt, pitches[1], coarse.source,
            )  # fmt: skip
        if self.places is not None:
            count, own = len(self.places), self.blur
            assert isinstance(own, TableBlur)
            self.tools.run(
                "probe", (count,), (8,), events, self.camera, self.struct, finest.source, finest.light, pitch,
                *own.tables[0], np.int32(count), self.pixels, self.misses,
            )  # fmt: skip

    def resolve(self, events: Events) -> None:
        """Enqueue what adds the coarser grids to the frame: of a frame once, of which there are no strips."""
        if self.levels:
            self._sample_frame(-1.0, events)
        sharp = np.float32(sharpening(self.spec.psf))
        for coarse, fine in pairwise(reversed(self.levels)):
            layouts = (coarse.camera, *coarse.blur.layout, fine.camera, *fine.blur.layout)
            rows, columns = int(fine.camera["rows"]), int(fine.camera["columns"])
            self.tools.run("enlarge", _blocks(columns + 1, rows), BLOCKS, events, *layouts, sharp)
        if self.levels:
            self._sample_frame(1.0, events)

    def image(self, events: Events, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        self.resolve(events)
        return self.blur.image(events, out)

    def missed(self) -> NDArray[np.float32]:
        """Error (places, channels) at `places` of the frame that `image` returned last, 0 where nothing could move."""
        count = 0 if self.places is None else len(self.places)
        if not (self.levels and count):
            return np.zeros((count, self.channels), np.float32)
        return download(self.blur.target.session, self.misses, (count, self.channels), np.float32)

    def _sample_frame(self, sign: float, events: Events) -> None:
        if self.places is not None:
            pitch, pad, total = self.layout
            count = len(self.places)
            args = (self.camera, total, pitch, pad, np.float32(sign), np.int32(count), self.pixels, self.misses)
            self.tools.run("sample_frame", (count,), (8,), events, *args)


def make_blur(
    target: Target, spec: BlurSpec, grid: Grid, camera: Struct, places: NDArray[np.int32] | None = None
) -> FrameBlur:
    """The blur of a frame: on coarser grids where `spec.least` says so, with `places` as for `Multigrid`.

    Parameters
    ----------
    target, spec, grid, camera
        As for `clsco.passes.exact.exact_blur`.
    places : ndarray of int32 (n, 2), optional

    Returns
    -------
    FrameBlur
    """
    blur = exact_blur(target, spec, grid, camera)
    return blur if spec.least is None else Multigrid(blur, grid, places)


def _level(blur: FrameSum, grid: Grid, finest: bool) -> Level:
    """finest: value and source are those of a time sample."""
    session, sizes = blur.target.session, level_buffers(blur.spec, grid, finest)
    radius = filled_with(session, sizes["radius"], nan)
    tilt = filled_with(session, sizes["tilt"]) if "tilt" in sizes else None
    moved, light = (filled_with(session, sizes[name]) for name in ("moved", "light"))
    kept = empty(session, sizes["kept"])
    value, source = (None, None) if finest else (kept, empty(session, sizes["source"]))
    _, pitch = plane_shape(grid.width, grid.height)
    return Level(blur, pitch, radius, tilt, moved, light, kept, value, source)


def _blocks(width: int, height: int) -> tuple[int, int]:
    """Work-items where each makes TAP_LANES numbers of a row."""
    return -(-width // TAP_LANES), height
