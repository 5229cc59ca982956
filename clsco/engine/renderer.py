"""Frames of a plan on a device: its passes for every time sample, again with more room where the plan was too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from time import perf_counter
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco import __version__
from clsco.constants import STATISTIC_LARGEST, STATISTIC_MOST_SLOTS, STATISTIC_SMALLEST
from clsco.engine.workspace import Workspace, make_workspace
from clsco.errors import DeviceError
from clsco.frame.frame import Frame
from clsco.frame.strips import Strip
from clsco.opencl.buffers import download
from clsco.opencl.pace import spent
from clsco.opencl.session import Progress, Session
from clsco.optics.depth_layers import LayerBounds
from clsco.optics.exposure import Exposure, frame_exposure
from clsco.passes.blur import Events
from clsco.passes.pack import camera_grid
from clsco.passes.placed import PlacedScene, TimeSample
from clsco.passes.static_image import StaticMap
from clsco.passes.trace import EMPTY_STATISTICS, Hits, Work
from clsco.passes.truth import GroundTruth
from clsco.passes.warp import ForwardWarp
from clsco.plan.memory import Limit, device_bytes, fitted
from clsco.plan.plan import Plan, widened
from clsco.plan.prepare import Prepared
from clsco.records import Real, Struct

SLACK = 1.0 + 1e-6  # the host's float64 and the device's float round differently
NOTHING_MISSING = {"missing_pixels": 0, "filled_pixels": 0, "unfilled_pixels": 0, "sweeps": 0}


class Renderer:
    """Renders the frames of one plan on one device.

    Parameters
    ----------
    session : Session
    plan : Plan
        Fitted to the limit.
    prepared : Prepared
        The scene, its files and its plan.
    limit : Limit
        Limit that a larger plan is fitted to, if the plan turns out to be too small.
    hits : Hits, optional
        Shared with the renderers of other lenses, whose plans have the same apron.

    Raises
    ------
    DeviceError, KernelError
    """

    def __init__(
        self, session: Session, plan: Plan, prepared: Prepared, limit: Limit, hits: Hits | None = None
    ) -> None:
        device, precision = session.device, prepared.request.precision
        if (needed := device_bytes(plan)) > device.global_mem:
            raise DeviceError(f"device {device}: the scene needs {needed >> 20} MiB; got {device.global_mem >> 20} MiB")
        wants_double = precision == "double" or (precision is None and device.has_fp64)
        real: Real = "double" if wants_double else "float"
        self.plan, self.limit, self.prepared, self.hits = plan, limit, prepared, hits
        self.scene = PlacedScene(session, plan.scene, plan.psf, prepared.textures, real, plan.eye, plan.alpha)
        self.space: Workspace | None = None
        self.moved = self._pixels()
        self.space = self._workspace()

    def _pixels(self) -> ForwardWarp | StaticMap | None:
        plan, maps = self.plan, self.prepared.maps
        if plan.static_map:
            assert maps[0] is not None
            radiance = self.prepared.textures[0].radiance
            return StaticMap(plan.scene.camera, radiance, maps[0], plan.guard_px, self.scene.real)
        return ForwardWarp(plan, self.scene, maps) if plan.forward else None

    def _workspace(self) -> Workspace:
        grid = self._grid(self.plan.strips[0])
        return make_workspace(self.plan, self.scene, self.moved, self.hits, grid)

    def _grid(self, strip: Strip) -> Struct:
        return camera_grid(self.plan.scene.camera, self.plan.guard_px, self.scene.real, strip)

    @property
    def _ready(self) -> Workspace:
        assert self.space is not None
        return self.space

    def begin(self, exposure: Exposure) -> None:
        """Begin a frame of these time samples: no radiance yet."""
        plan, space, times = self.plan, self._ready, exposure.times.tolist()
        self.exposure, self.weights = exposure, exposure.of_rows(plan.rows)
        self.began = perf_counter()
        self.events: Events = []
        self.reports: list[dict[str, Any]] = []
        shape = (plan.rows, plan.columns)
        image = shape if plan.channels == 1 else (*shape, plan.channels)
        self.color = np.empty(image, np.float32)
        alone = len(times) if "subframes" in plan.truth else 0
        self.subframes = np.empty((alone, *image), np.float32)
        self.missing = np.zeros(shape, np.bool_)
        if isinstance(space.pixels, StaticMap):
            self.missing |= space.pixels.missing
        if "statistics" in space.buffers:
            cl.enqueue_copy(self.scene.session.queue, space.buffers["statistics"], EMPTY_STATISTICS)
        self.depth_layers = {time: self._depth_layers(time) for time in times if len(plan.strips) > 1 and space.layers}

    def _depth_layers(self, time: float) -> LayerBounds:
        """Depth layers of a time sample, from all strips."""
        space, sample = self._ready, self.scene.at(time)
        assert space.layers is not None
        for strip in self.plan.strips:
            work = self._work(strip, sample)
            space.radii(work)
            assert work.planes is not None
            space.layers.find(*work.planes[1:], self.events)
        return space.layers.labels.found()

    def _work(self, strip: Strip, sample: TimeSample) -> Work:
        grid = self._grid(strip)
        if self._ready.making is not None:
            self._ready.blur.grid = grid
        return Work(strip, grid, self.events, sample)

    def begin_strip(self) -> None:
        """Begin one of the strips of the frame."""
        self.reports = []  # the same for every strip
        if (frame := self._ready.frame) is not None:
            frame.clear()

    def add(self, strip: Strip, number: int) -> None:
        """Run the passes of a time sample, by its number, on a strip."""
        time, weights = float(self.exposure.times[number]), self.exposure.weights[number]
        work = self._work(strip, self.scene.at(time))
        work.depth_layers, work.weights = self.depth_layers, self.weights[number, strip.inside]
        work.report = {"time": time, "weight": float(weights.mean())} | NOTHING_MISSING
        if self._ready.making is not None:
            self._ready.blur.clear()
        for step in self.plan.passes:
            self.scene.session.go_on()
            self.scene.session.doing(step.kind)
            if step.kind != "ground truth":
                self._ready.run(step, work)
        self.reports.append(work.report)
        if work.missing is not None:
            self.missing |= work.missing
        if self.plan.color:
            plane = self._ready.plane(work)
            if len(self.subframes):
                plane.read(self.scene.session, self.subframes[number][strip.inside])
            self.image = work.image or plane

    def end_strip(self, strip: Strip) -> None:
        """Read back a strip to which all time samples have been added."""
        if self.plan.color:
            self.image.read(self.scene.session, self.color[strip.inside])

    def finish(self, index: int) -> Frame:
        """The frame of this number, of the strips added: again with larger buffers where the plan was too small."""
        while self._outgrown():
            expose([self], index)
        space = self._ready
        truth = GroundTruth(self.plan, self.scene, space.tracer, space.pixels).of_frame(index, self.events)
        of_samples = {"missing": self.missing, "subframes": self.subframes}
        truth |= {name: array for name, array in of_samples.items() if name in self.plan.truth}
        self.scene.release()
        eye = self.plan.eye if self.plan.scene.stereo else ""
        about = self._metadata(index)
        if not self.plan.color:
            none: Any = None
            return Frame(index=index, color=none, metadata=about, eye=eye, **truth)
        if not self.plan.alpha:
            return Frame(index=index, color=self.color, metadata=about, eye=eye, **truth)
        for name in {"sharp", "subframes"} & truth.keys():
            truth[name] = _without_alpha(truth[name])
        alpha = np.ascontiguousarray(self.color[..., -1])
        return Frame(index=index, color=_without_alpha(self.color), alpha=alpha, metadata=about, eye=eye, **truth)

    def _change(self, plan: Plan) -> None:
        """Go on with another plan of the scene."""
        self.space = None  # before the larger one takes memory
        if plan.guard_px != self.plan.guard_px or plan.strips != self.plan.strips:
            self.hits = None  # the apron may not be that of the others any more
        if isinstance(self.moved, ForwardWarp) and plan.guard_px != self.plan.guard_px:
            self.moved = None
            self.plan = plan
            self.moved = ForwardWarp(plan, self.scene, self.prepared.maps)
        self.plan = plan
        self.space = self._workspace()

    def _outgrown(self) -> bool:
        """True if the frame met more than was predicted; then makes room for it."""
        plan = self.plan
        if plan.static_map or not plan.color:
            return False
        statistics = self._ready.buffers["statistics"]
        found = download(self.scene.session, statistics, EMPTY_STATISTICS.shape, np.int32)
        radii = found.view(np.float32)
        largest, smallest = float(radii[STATISTIC_LARGEST]), float(radii[STATISTIC_SMALLEST])
        slots = int(found[STATISTIC_MOST_SLOTS])
        fits = largest <= plan.largest_blur * SLACK + 1e-6 and smallest >= plan.smallest_blur / SLACK - 1e-6
        if largest == 0.0 or (fits and slots <= plan.slots):
            return False
        wider = replace(plan, least_slots=max(slots, plan.slots) if plan.silhouettes else 0)
        if not fits:
            ends = min(smallest / SLACK, plan.smallest_blur), max(largest * SLACK, plan.largest_blur)
            wider = fitted(widened(wider, *ends), self.limit)
        self._change(wider)
        return True

    def _metadata(self, index: int) -> dict[str, Any]:
        seconds: dict[str, float] = {}
        for name, event in self.events:
            seconds[name] = seconds.get(name, 0.0) + spent(event)
        seconds["host"] = perf_counter() - self.began - sum(seconds.values())
        device, report = self.scene.session.device, self.prepared.approximation
        return {
            "frame": index,
            "intermediate": self.reports,
            "samples": len(self.reports),
            "guard_px": self.plan.guard_px,
            "strips": len(self.plan.strips),
            "blur_method": self.plan.blur,
            "approximation": None if report is None else asdict(report),
            "bits": self.scene.bits,
            "f_number": self.plan.scene.camera.opening,
            "device": str(device),
            "precision": "double" if self.scene.real == "double" else "single",
            "version": __version__,
            "seconds": seconds,
        }


def _without_alpha(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Color (..., rows, columns[, 3]) of images whose last channel is coverage."""
    return np.ascontiguousarray(image[..., 0] if image.shape[-1] == 2 else image[..., :-1])


def expose(renderers: Sequence[Renderer], index: int) -> None:
    """Radiance of the frame of this number, strip by strip and time sample by time sample, for renderers with the same
    of both."""
    plan = renderers[0].plan
    exposure, strips = frame_exposure(plan.scene, index, plan.samples), plan.strips
    samples = len(exposure.times)
    for renderer in renderers:
        renderer.begin(exposure)
    if {step.kind for step in renderers[0].plan.passes} <= {"ground truth"}:
        return
    for number, strip in enumerate(strips):
        for renderer in renderers:
            renderer.begin_strip()
        for count in range(samples):
            before = [renderer.events[-1:] for renderer in renderers]
            for renderer in renderers:
                renderer.add(strip, count)
            if (progress := renderers[0].scene.session.progress) is not None:
                _keep_pace(before, progress, number * samples + count, len(strips) * samples)
        for renderer in renderers:
            renderer.end_strip(strip)


def _keep_pace(before: Sequence[Events], progress: Progress, done: int, total: int) -> None:
    """Wait for all but the latest time sample, so that a cancel comes soon, and what is done is known."""
    for _, event in (latest for events in before for latest in events):
        event.wait()
    progress.done, progress.total = done, total
