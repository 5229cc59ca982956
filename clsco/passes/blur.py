"""Host side of the blur: PSF tables on the device, launches of its kernels, and the frame that they add up to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import log

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import BAND
from clsco.opencl.buffers import empty, mapped, upload
from clsco.opencl.program import kernel, launch
from clsco.opencl.session import Program, Session
from clsco.optics.psf_tables import NEAR, TAP_LANES, PsfTable, psf_features, psf_table
from clsco.optics.visibility import lens_floats
from clsco.passes.convolve import Convolution
from clsco.passes.pack import psf_struct
from clsco.plan.memory import MOST_IN_ONE_SUM, Scratch, band_scratch, bands_at_a_time, margin, spread_bytes
from clsco.plan.methods import MANY_RADII, Blur
from clsco.records import Real, Struct
from clsco.scene.model import Psf

PIXELS = (64, 1)  # local size of kernels with a work-item per pixel
BLOCKS = (8, 1)  # of kernels with one per TAP_LANES pixels of a row
GROUP = (16, 8)  # pixels of a group of `tiles`, as in kernels/blur/tiles.cl
# A pixel gets at most 2.6 + 2 ln R times the brightest source from pillboxes; the tilt at most doubles it.
GAIN, GAIN_PER_LOG, TILT_GAIN = 2.6, 2.0, 2.0

# The kernel files of each method in the program that its caller builds; `convolve` builds its own.
FILES_OF: dict[Blur, tuple[str, ...]] = {
    "gather": ("blur/blur.cl", "blur/cpu/gather.cl"),
    "scatter": ("blur/blur.cl",),
    "tiles": ("blur/blur.cl", "blur/tiles.cl"),
    "convolve": (),
    "none": ("blur/accumulate.cl",),
}

# Features that only surfaces need.
PLAIN = dict.fromkeys(("SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED", "FILTER", "SUBPIXELS", "OCCLUDED"), 0)

Events = list[tuple[str, cl.Event]]


def blur_features(method: Blur, psf: Psf, largest: float, fp64: bool, prepare: bool) -> dict[str, int]:
    """Which kernels of blur.cl are compiled, and for what; largest: |R| in px; fp64: the device has doubles."""
    kept = band_scratch(psf, largest, fp64) if method == "gather" else "none"
    return {
        "GATHER": int(method == "gather"),
        "BY_ROWS": int(kept in ("rows", "near")),
        "NEAR": NEAR * (kept == "near"),
        "BY_COLUMNS": int(kept == "columns"),
        "SCATTER": int(method == "scatter"),
        "RENORMALIZE": int(psf.border == "renormalize" and method != "none"),
        "PREPARE": int(prepare and method in MANY_RADII),
        "BAND": BAND,
    }


def image_features(blur: Blur, psf: Psf, largest: float, channels: int, tilt: bool, fp64: bool) -> dict[str, int]:
    """Features of a program that spreads an image with radii up to `largest` px, whatever surfaces it shows: the same
    one for all scenes that agree in these."""
    found = PLAIN | psf_features(psf) | blur_features(blur, psf, largest, fp64, prepare=True)
    return found | {"CHANNELS": channels, "TILT": int(tilt and blur != "convolve")}


@dataclass(frozen=True)
class Sources:
    """Light sources of one moment on the device, in the layout of trace.cl.

    source: planes of frame and guard band (sources.clh), None for `convolve` and `none`; value: radiance times
    weight; sub_source, sub_value: of `capacity` pixels near silhouettes, None without them. surfaces, layer, depth,
    sub_depth: what stands in the way, and of what; None where nothing does.
    """

    source: cl.Buffer | None
    value: cl.Buffer
    sub_source: cl.Buffer | None = None
    sub_value: cl.Buffer | None = None
    capacity: int = 0
    surfaces: cl.Buffer | None = None
    layer: Struct | None = None
    depth: cl.Buffer | None = None
    sub_depth: cl.Buffer | None = None


def prepare_sources(
    session: Session, program: Program, camera: Struct, psf: Struct, coc: cl.Buffer, valid: cl.Buffer,
    source: cl.Buffer, events: Events,
) -> None:  # fmt: skip
    """Enqueue what makes sources of a map of signed radii; psf: struct of the Spreader that adds them."""
    size = -(-int(camera["width"]) // TAP_LANES), int(camera["height"])
    args = (camera, psf, coc, valid, source)
    events.append(("prepare_sources", launch(session, kernel(program, "prepare_sources"), size, BLOCKS, *args)))


class Spreader:
    """Adds the blurred light of moments to a frame, or a strip of it; owns its buffers and the PSF tables.

    camera: of the frame, or of the strip that it begins with, which is the tallest; another one can be set. Holds for
    |R| in [smallest, largest] px; other radii are clamped to it (`convolve` makes the PSF of its radius, and has a
    program of its own).
    brightest: largest |radiance|, which sets the fixed point of `scatter`; features: those of the program.
    """

    def __init__(
        self, session: Session, program: Program, psf: Psf, method: Blur, camera: Struct, channels: int,
        smallest: float, largest: float, subpixels: int, real: Real, brightest: float, features: Mapping[str, int],
    ) -> None:  # fmt: skip
        self.session, self.program, self.psf, self.method = session, program, psf, method
        self.camera, self.channels = camera, channels
        self.main = psf_table(psf, smallest, largest)
        self.sub: PsfTable | None = psf_table(psf, smallest, largest, subpixels) if subpixels else None
        self.struct = psf_struct(psf, self.main, self.sub, real)
        tables = [self.main] if self.sub is None else [self.main, self.sub]
        kept: Scratch = "near" if features["NEAR"] else "rows" if features["BY_ROWS"] else "none"
        kept = "columns" if features["BY_COLUMNS"] else kept
        self.tables = [(upload(session, t.intervals), upload(session, t.coefficients)) for t in tables]
        self.lens = upload(session, lens_floats(psf).astype(np.float32))
        rows, columns = int(camera["rows"]), int(camera["columns"])
        far, cores = int(self.struct["reach"]), session.device.compute_units
        self.pad, self.pitch = margin(columns, int(camera["guard"]), far)
        sizes = spread_bytes(psf, method, channels, rows, columns, int(camera["guard"]), far, kept, cores)
        self.total = empty(session, sizes["total"])
        row_taps = 2 * far + 1
        # Rows of sources after which sums go on to the frame, 0 where they are short.
        self.group = max(MOST_IN_ONE_SUM // row_taps, 1) if "part" in sizes else 0
        self.part, self.scratch = self.total, tuple[object, ...]()
        self.alike = tuple(upload(session, array) for array in (self.main.taps, self.main.outlines))
        self.bands = -(-rows // BAND)
        if {"part", "scratch"} & sizes.keys():
            # Some bands at a time, so that a large frame does not take several times its size.
            self.bands = bands_at_a_time(rows, cores)
            if "part" in sizes:
                self.part = _zeros(session, sizes["part"])
            if "scratch" in sizes:
                number = sizes["scratch"] // (4 if kept == "near" else 8)  # of floats, or doubles
                self.scratch = (_zeros(session, sizes["scratch"]), np.int32(number // self.bands))
        if method == "convolve":
            self.convolution = Convolution(session, psf, channels, brightest, sizes)
        self.scale = 1.0
        if method == "scatter":
            wide = session.device.has_int64_atomics
            gain = TILT_GAIN * (GAIN + GAIN_PER_LOG * log(max(largest, 1.0)))
            most = 2.0 ** (40 if wide else 31) / (max(brightest, 1e-30) * (1.0 if wide else gain))
            self.scale = min(most, 2.0**126)  # a float32, also where there is no light at all
            self.sums = empty(session, sizes["sums"])

    def clear(self) -> None:
        """Begin a frame, or a strip of it."""
        if self.method == "convolve":
            self.convolution.fresh = True
            return
        buffer = self.sums if self.method == "scatter" else self.total
        cl.enqueue_fill_buffer(self.session.queue, buffer, np.zeros(1, np.uint32), 0, buffer.size)

    def add(self, sources: Sources, radius: float, events: Events) -> None:
        """Add the light of one moment; radius: |R| in px, for `convolve` only."""
        camera, value = self.camera, sources.value
        frame = (int(camera["columns"]), int(camera["rows"]))
        layout = (np.int32(self.pitch), np.int32(self.pad), self.total)
        if self.method == "none":
            self._launch("accumulate", frame, PIXELS, events, camera, value, *layout)
            return
        if self.method == "convolve":
            self.convolution.add(camera, value, radius, self.total, self.pitch, self.pad, events)
            return
        head = (camera, self.struct, sources.source, value, *self.tables[0])
        tail: tuple[object, ...] = ()
        if self.sub is not None:
            tail = (sources.sub_source, sources.sub_value, np.int32(sources.capacity), *self.tables[1])
        if self.psf.border == "renormalize":
            self._launch("renormalize", (frame[0], int(camera["height"])), PIXELS, events, *head, *tail)
        if sources.layer is not None:
            tail += (sources.surfaces, sources.layer, self.lens, sources.depth)
            tail += () if self.sub is None else (sources.sub_depth,)
        if self.method == "gather":
            parts = np.int32(self.group), self.part
            for start in range(0, -(-frame[1] // BAND), self.bands):
                args = (*head, *self.alike, *self.scratch, np.int32(start), *parts, *layout, *tail)
                self._launch("gather", (self.bands,), (1,), events, *args)
        elif self.method == "tiles":
            self._launch("tiles", frame, GROUP, events, *head, *layout, *tail)
        else:
            padded = (int(camera["width"]), int(camera["height"]))
            self._launch("scatter", padded, PIXELS, events, *head, np.float32(self.scale), self.sums, *tail)

    def image(self, events: Events, out: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """The frame, or its strip, (rows, columns[, channels]), in `out` where it is given; waits for the device."""
        rows, columns = int(self.camera["rows"]), int(self.camera["columns"])
        if self.method == "scatter":
            args = (np.float32(self.scale), np.int32(self.pitch), np.int32(self.pad), self.sums, self.total)
            self._launch("resolve", (columns, rows), PIXELS, events, self.camera, *args)
        if out is None:
            out = np.empty((rows, columns) if self.channels == 1 else (rows, columns, self.channels), np.float32)
        with mapped(self.session, self.total, (self.channels, rows, self.pitch)) as total:
            planes = total[:, :, self.pad : self.pad + columns]
            out[...] = planes[0] if self.channels == 1 else np.moveaxis(planes, 0, -1)
        if self.method == "convolve":
            self.convolution.held.clear()
        return out

    def _launch(self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: object) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))  # type: ignore[arg-type]


def _zeros(session: Session, size: int) -> cl.Buffer:
    """A buffer of so many bytes, all 0."""
    buffer = empty(session, size)
    cl.enqueue_fill_buffer(session.queue, buffer, np.zeros(1, np.uint32), 0, size)
    return buffer
