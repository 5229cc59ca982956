"""Error of a whole frame against the lens itself, and the CPU time that it takes: the PSFs of clsco, and Mitsuba 3.

The scene is examples/sphere.toml. A ray tracer of clsco's own gives the frame as a thin lens makes it, with a known
noise, which is taken off the errors. What differs in physics shows here, and not against the float64 reference, which
computes with the same PSFs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from math import log10, sqrt
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.truth import mitsuba
from clsco.engine.renderer import Renderer, expose
from clsco.inputs.textures import load_scene_textures
from clsco.opencl.device import Device
from clsco.opencl.session import Session
from clsco.plan.memory import limit_of
from clsco.plan.prepare import prepare
from clsco.scene.examples import example
from clsco.scene.model import Psf, Scene

Array = NDArray[Any]
Call = Callable[[int], Array]

EXAMPLE, EXAMPLE_SIZE = "sphere", 512
NOISE = 2e-4  # RMS, of the traced frame, at most: seconds of work, and it is taken off
EDGES: tuple[Literal["sampled", "area", "integrated"], ...] = ("sampled", "area", "integrated")
PSFS = {
    f"{edge}{', tilt' * tilt}{', silhouettes' * (sources > 1)}": Psf(edge=edge, tilt=tilt, silhouette_samples=sources)
    for edge in EDGES
    for sources in (1, 4)
    for tilt in (False, True)
}
ROUNDS = 3  # each setting is timed once in a round
FRAMES = 5  # of clsco, of which the time of one is the median


@dataclass(frozen=True)
class LensRow:
    """One way to make the frame: a PSF of clsco, or so many rays per pixel of Mitsuba.

    cpu_s, wall_s: of a warm frame, process CPU and wall time, medians; rms_error: of white, over the whole frame, the
    traced frame's noise taken off; mitsuba_cpu_s: what Mitsuba takes for that error; extrapolated: it lies outside of
    what was measured, and assumes a quarter of the time for twice the error; times_less: CPU time.
    """

    tool: str
    setting: str
    cpu_s: float
    wall_s: float
    rms_error: float
    psnr_db: float
    mitsuba_cpu_s: float | None = None
    extrapolated: bool = False
    times_less: float | None = None


@dataclass(frozen=True)
class Lens:
    """The comparison: scene, px a side, RMS noise of the traced frame, and all rows."""

    scene: str
    size: int
    noise: float
    rows: list[LensRow] = field(default_factory=list)


@dataclass
class _Timed:
    """A way to make the frame, with the times and mean square errors of its calls, which get a seed each."""

    tool: str
    setting: str
    call: Call
    repetitions: int
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)
    squares: list[float] = field(default_factory=list)

    def row(self, noise: float) -> LensRow:
        error = sqrt(max(float(np.mean(self.squares)) - noise**2, 1e-12))
        cpu, wall = float(np.median(self.cpu)), float(np.median(self.wall))
        return LensRow(self.tool, self.setting, cpu, wall, error, -20.0 * log10(error))


def missing() -> str | None:
    """Names of packages that tracing needs and that are not installed; None where all are there."""
    return " and ".join(name for name in ("numba", "scipy") if find_spec(name) is None) or None


def steps(samples: Sequence[int]) -> int:
    """Number of times that `run` calls `advance`."""
    return 1 + ROUNDS * (len(PSFS) + len(samples))


def run(device: Device, size: int, samples: Sequence[int], advance: Callable[[], object], cache: Path | None) -> Lens:
    """Measure all PSFs of clsco, and Mitsuba at so many `samples` per pixel, on frames of size x size px.

    cache: folder that keeps the traced frame, or None. Raises DeviceError, KernelError.
    """
    from benchmarks.truth.traced import rms, traced

    scene, (texture,) = load_scene_textures(sized(size))
    truth, errors = traced(scene, NOISE, cache, report=lambda _: None)
    noise = rms(errors)
    advance()
    with Session(device) as session:
        ways = [_Timed("clsco", name, _renderer(session, scene, psf), FRAMES) for name, psf in PSFS.items()]
        if samples:
            render = mitsuba.set_up(scene, texture.radiance)
            ways += [_Timed("Mitsuba", f"{n}", partial(render, n), 1) for n in samples]
        for seed in range(ROUNDS):
            for way in ways:
                for _ in range(way.repetitions):
                    _time(way, seed, truth)
                advance()
    return Lens(EXAMPLE, size, noise, compared([way.row(noise) for way in ways]))


def sized(size: int) -> Scene:
    """The scene at size x size px, with the field of view and the radii in px that it has at 512."""
    scene, ratio = example(EXAMPLE), EXAMPLE_SIZE / size
    camera = scene.camera
    lens = {"pixel_pitch": camera.pixel_pitch * ratio, "aperture_diameter": camera.aperture_diameter * ratio}
    return scene.model_copy(update={"camera": camera.model_copy(update={"resolution": (size, size), **lens})})


def cache_folder() -> Path | None:
    """Folder of traced frames in the user's cache folder; None where it cannot be written."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clsco" / "traced"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # a user without a home is the latter
        return None
    return folder if os.access(folder, os.W_OK) else None


def compared(rows: Sequence[LensRow]) -> list[LensRow]:
    """The rows, those of clsco with the time that Mitsuba takes for their error, where there is Mitsuba."""
    curve = sorted((row.rms_error, row.cpu_s) for row in rows if row.tool == "Mitsuba")
    if not curve:
        return list(rows)
    found = []
    for row in rows:
        if row.tool == "clsco":
            seconds, outside = time_for(row.rms_error, curve)
            times = seconds / row.cpu_s
            row = replace(row, mitsuba_cpu_s=seconds, extrapolated=outside, times_less=times)
        found.append(row)
    return found


def time_for(error: float, curve: Sequence[tuple[float, float]]) -> tuple[float, bool]:
    """Seconds for an error, from a rising `curve` of (error, seconds), and whether it lies outside.

    Inside linear in the logarithms; outside time times error squared is that of the next point.
    """
    errors, seconds = (np.array(values) for values in zip(*curve, strict=True))
    inside = float(np.clip(error, errors[0], errors[-1]))
    between = float(np.exp(np.interp(np.log(inside), np.log(errors), np.log(seconds))))
    return between * (inside / error) ** 2, inside != error


def _renderer(session: Session, scene: Scene, psf: Psf) -> Call:
    """Rendering of a frame from its scene to linear radiance on the host; warm, with programs and tables made."""
    prepared = prepare(scene.model_copy(update={"psf": psf}), device=session.device)
    renderer = Renderer(session, prepared.plan, prepared, limit_of(None, session.device))

    def frame(_: int) -> Array:
        (film,) = expose([renderer], 0)
        return renderer.finish(film).color

    frame(0)
    return frame


def _time(way: _Timed, seed: int, truth: Array) -> None:
    wall, cpu = time.perf_counter(), time.process_time()
    found = way.call(seed)
    way.cpu.append(time.process_time() - cpu)
    way.wall.append(time.perf_counter() - wall)
    way.squares.append(float(np.mean((found - truth) ** 2)))
