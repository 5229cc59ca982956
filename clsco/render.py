"""From a plan to frames on a device: upload once, enqueue the passes, read back once per frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco import __version__
from clsco.device import Session, choose
from clsco.errors import DeviceError
from clsco.forward import ForwardWarp
from clsco.frame import TRUTH_NAMES, Frame
from clsco.layout import Real, camera_struct, flat, pose_struct, structs, surface_struct
from clsco.motion import Pose, middle_time, pose_at
from clsco.optics import blur_radius
from clsco.plan import Plan, exposure, make_plan, widened
from clsco.program import build, download, empty, kernel, launch, upload
from clsco.scene import Scene
from clsco.spread import PIXELS, Events, Sources, Spreader, blur_features
from clsco.surfaces import PlacedSurface, place
from clsco.textures import Texture, load_scene_textures

# Outputs that ground_truth writes, with what one pixel of each takes: dtype and components (0: the channels).
TRUTH_BUFFERS: dict[str, tuple[type[np.generic], int]] = {
    "depth": (np.float32, 1),
    "coc": (np.float32, 1),
    "normal": (np.float32, 3),
    "flow": (np.float32, 2),
    "hidden": (np.uint8, 1),
    "sharp": (np.float32, 0),
}
SLACK = 1.0 + 1e-6  # the host's float64 and the device's float round differently
# What of the statistics a frame must begin with: no radius met, no slot taken (trace.cl).
EMPTY_STATISTICS = np.array([0, np.iinfo(np.int32).max, 0, 0], dtype=np.int32)


def render(
    scene: Scene,
    *,
    truth: Sequence[str] = TRUTH_NAMES,
    device: str | None = None,
    precision: str | None = None,
    method: str = "auto",
    frames: Iterable[int] | None = None,
) -> Iterator[Frame]:
    """Render frames of a scene.

    truth: names of the outputs besides color (`clsco.frame.TRUTH_NAMES`), none of which costs anything when it is
    left out; device: part of the name of an OpenCL device; precision: "double" or "single" for geometry, by default
    double where the device has it; method: of the blur, see `clsco.plan.make_plan`; frames: numbers of the frames
    wanted, by default all.
    Yields frames in order. Raises SceneError, ImageError, DeviceError, KernelError.
    Validated against `clsco.reference.render` on every scene in examples/ and a ray tracer (benchmarks/accuracy.py).
    """
    scene, textures = load_scene_textures(scene)
    texture = textures[0]
    plan = make_plan(scene, texture.radiance.shape[2] if texture.radiance.ndim == 3 else 1, tuple(truth), method)
    wanted = range(scene.sequence.frames) if frames is None else frames
    with Session(choose(device), profiling=True) as session:
        renderer = Renderer(session, plan, texture, precision)
        for index in wanted:
            yield renderer.frame(index)


class Renderer:
    """Owns the buffers and programs for one plan on one device."""

    def __init__(self, session: Session, plan: Plan, texture: Texture, precision: str | None = None) -> None:
        device = session.device
        if precision not in (None, "single", "double"):
            raise DeviceError(f"precision: must be single or double; got {precision}")
        if plan.memory_bytes > device.global_mem:
            raise DeviceError(
                f"device {device}: the scene needs {plan.memory_bytes >> 20} MiB; got {device.global_mem >> 20} MiB"
            )
        wants_double = precision == "double" or (precision is None and device.has_fp64)
        self.real: Real = "double" if wants_double else "float"
        self.session, self.plan = session, plan
        self.item = plan.scene.objects[0]
        self.bits = texture.bits
        self.smallest, self.largest, self.slots = plan.smallest_blur, plan.largest_blur, plan.slots
        self.brightest = float(np.abs(texture.radiance).max(initial=0.0))
        self.texture = upload(session, flat(texture.radiance, np.float32))
        self.camera = camera_struct(plan.scene.camera, plan.guard_px, self.real)
        blur = blur_features(plan.blur, plan.scene.psf.border, plan.forward)
        features = plan.features() | blur | {"TRUTH": int(bool(plan.truth))}
        features |= {f"TRUTH_{name.upper()}": int(name in self._truth_names()) for name in TRUTH_BUFFERS}
        declared = structs(self.real)
        sources = ["trace.cl"] + (["accumulate.cl"] if plan.blur == "none" else ["blur.cl"])
        self.program = build(session, sources, features, declared, self.real)
        self.forward = None
        if plan.forward:
            self.forward = ForwardWarp(session, plan, self.camera, self.texture, self._surface(0.0), self.real)
        self._allocate()

    def _truth_names(self) -> list[str]:
        """Outputs of ground_truth; a forward warp makes its own focused image."""
        return [n for n in TRUTH_BUFFERS if n in self.plan.truth and not (n == "sharp" and self.plan.forward)]

    def _allocate(self) -> None:
        """Buffers whose size depends on the range of radii and on the number of silhouette pixels."""
        plan, session = self.plan, self.session
        area = plan.width * plan.height
        self.spreader = Spreader(
            session, self.program, plan.scene.psf, plan.blur, self.camera, plan.channels, self.smallest, self.largest,
            plan.silhouettes, self.real, self.brightest,
        )  # fmt: skip
        self.source = empty(session, 16 * area)
        self.value = empty(session, 4 * plan.channels * area)
        self.statistics = empty(session, EMPTY_STATISTICS.nbytes)
        each = plan.silhouettes**2
        self.label = empty(session, area if each else 0)
        self.pixels = empty(session, 4 * self.slots)
        self.sub_source = empty(session, 16 * self.slots * each)
        self.sub_value = empty(session, 4 * plan.channels * self.slots * each)

    def _pose(self, time: float) -> Pose:
        return pose_at(self.item.motion, time, self.plan.scene.motion.rotation)

    def _surface(self, time: float) -> PlacedSurface:
        return place(self.item, self._pose(time))

    def frame(self, index: int) -> Frame:
        """Render one frame: again with larger buffers where the prediction of the plan was too small."""
        while True:
            events: Events = []
            self.spreader.clear()
            cl.enqueue_copy(self.session.queue, self.statistics, EMPTY_STATISTICS)
            times, weights = exposure(self.plan, index)
            moments = [
                self._moment(time, weight, events)
                for time, weight in zip(times.tolist(), weights.tolist(), strict=True)
            ]
            color = self.spreader.image(events)
            if not self._outgrown():
                break
        truth = self._ground_truth(index, events)
        return Frame(index=index, color=color, metadata=self._metadata(index, moments, events), **truth)

    def _moment(self, time: float, weight: float, events: Events) -> dict[str, Any]:
        """One intermediate frame: its sources, blurred and added; returns what is told of it."""
        report: dict[str, Any] = {"time": time, "weight": weight}
        counters = {"missing_pixels": 0, "filled_pixels": 0, "unfilled_pixels": 0, "sweeps": 0}
        if self.forward is not None:
            warped = self.forward.warp(self._pose(time), self._surface(time), weight, events)
            counters |= warped.counters
            sources = Sources(self.source, warped.value)
            if self.plan.blur in ("gather", "scatter"):
                args = (self.camera, self.spreader.struct, warped.coc, warped.valid, self.source)
                self._per_pixel("prepare_sources", events, *args)
        else:
            sources = self._trace(self._surface(time), weight, events)
        self.spreader.add(sources, self._central_radius(time), events)
        return report | counters

    def _central_radius(self, time: float) -> float:
        """|R| on the axis, which is that of every pixel where the blur is a convolution."""
        if self.plan.blur != "convolve":
            return 0.0
        surface = self._surface(time)
        inverse_depth = -2.0 * float(surface.canonical.l @ surface.turn[:, 2]) / surface.constant
        return abs(float(blur_radius(self.plan.scene.camera, inverse_depth)))

    def _trace(self, surface: PlacedSurface, weight: float, events: Events) -> Sources:
        plan, psf, camera = self.plan, self.spreader.struct, self.camera
        placed = surface_struct(self.item, surface, self.real)
        share, slots = np.float32(weight), np.int32(self.slots)
        if plan.silhouettes:
            cl.enqueue_fill_buffer(self.session.queue, self.statistics, np.zeros(1, np.int32), 8, 4)
        args = (camera, placed, psf, share, self.texture, self.source, self.value, self.label, self.statistics)
        self._per_pixel("trace", events, *args)
        if not plan.silhouettes:
            return Sources(self.source, self.value)
        self._per_pixel(
            "mark_silhouettes", events, camera, self.label, slots, self.source, self.pixels, self.statistics
        )
        out = (self.sub_source, self.sub_value, self.statistics)
        self._launch(
            "trace_subpixels", (self.slots * plan.silhouettes**2,), (64,), events,
            camera, placed, psf, share, self.texture, self.pixels, slots, *out,
        )  # fmt: skip
        return Sources(self.source, self.value, self.sub_source, self.sub_value, self.slots)

    def _outgrown(self) -> bool:
        """Whether the frame met more than was predicted; if so, makes room for it."""
        if self.forward is not None:
            return False
        found = download(self.session, self.statistics, EMPTY_STATISTICS.shape, np.int32)
        largest, smallest = (float(r) for r in found[:2].view(np.float32))
        slots = int(found[3])
        fits = largest <= self.largest * SLACK + 1e-6 and smallest >= self.smallest / SLACK - 1e-6
        if largest == 0.0 or (fits and slots <= self.slots):
            return False
        self.largest, self.smallest = max(largest * SLACK, self.largest), min(smallest / SLACK, self.smallest)
        self.slots = max(slots, self.slots)
        self.plan = widened(self.plan, self.largest)
        self.camera = camera_struct(self.plan.scene.camera, self.plan.guard_px, self.real)
        self._allocate()
        return True

    def _ground_truth(self, index: int, events: Events) -> dict[str, NDArray[Any]]:
        plan = self.plan
        if not plan.truth:
            return {}
        time = middle_time(plan.scene.sequence, index) if plan.moves else 0.0
        later = middle_time(plan.scene.sequence, index + 1) if plan.moves else 0.0
        pixels = plan.rows * plan.columns
        names = self._truth_names()
        sizes = {n: TRUTH_BUFFERS[n][1] or plan.channels for n in names}
        mask = empty(self.session, pixels)
        buffers = {n: empty(self.session, pixels * sizes[n] * TRUTH_BUFFERS[n][0]().itemsize) for n in names}
        surface, still = (surface_struct(self.item, self._surface(t), self.real) for t in (time, 0.0))
        head = (self.camera, surface, still, pose_struct(self._pose(later), self.real), self.texture, mask)
        self._launch("ground_truth", (plan.columns, plan.rows), PIXELS, events, *head, *buffers.values())
        shape = (plan.rows, plan.columns)
        found = download(self.session, mask, shape, np.bool_)
        out: dict[str, NDArray[Any]] = {}
        for name, buffer in buffers.items():
            full = shape if sizes[name] == 1 else (*shape, sizes[name])
            out[name] = download(self.session, buffer, full, np.bool_ if name == "hidden" else TRUTH_BUFFERS[name][0])
        if self.forward is not None:
            out |= self.forward.truth(self._pose(time), self._surface(time), events)
        out |= {"filled": np.zeros(shape, np.uint8), "mask": found} | out
        out["object_id"] = np.where(found, 0, -1).astype(np.int32)
        return {name: array for name, array in out.items() if name in plan.truth}

    def _metadata(self, index: int, moments: list[dict[str, Any]], events: Events) -> dict[str, Any]:
        seconds: dict[str, float] = {}
        for name, event in events:
            spent = 1e-9 * (event.profile.end - event.profile.start)
            seconds[name] = seconds.get(name, 0.0) + spent
        device = self.session.device
        return {
            "frame": index,
            "intermediate": moments,
            "samples": len(moments),
            "guard_px": self.plan.guard_px,
            "blur_method": self.plan.blur,
            "bits": self.bits,
            "device": str(device),
            "precision": "double" if self.real == "double" else "single",
            "version": __version__,
            "seconds": seconds,
        }

    def _per_pixel(self, name: str, events: Events, *args: Any) -> None:
        self._launch(name, (self.plan.width, self.plan.height), PIXELS, events, *args)

    def _launch(self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: Any) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))
