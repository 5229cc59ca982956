"""One plan on one device: upload once, enqueue the passes, read back once per frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco import __version__
from clsco.errors import DeviceError
from clsco.frame.frame import STEREO_NAMES, Frame
from clsco.frame.strips import Strip
from clsco.inputs.textures import Texture
from clsco.opencl.buffers import download, download_into, empty, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.optics.depth_truth import map_flow, map_normal, map_stereo
from clsco.optics.lens import blur_radius
from clsco.optics.motion import Pose, middle_time, poses_at, rest_poses
from clsco.optics.quadrics import PlacedSurface, place
from clsco.optics.slabs import Slabs
from clsco.optics.visibility import Layer
from clsco.passes.blur import FILES_OF, PIXELS, Events, Sources, Target, blur_features, image_features, prepare_sources
from clsco.passes.layered import DepthLayers
from clsco.passes.multigrid import Multigrid, make_blur
from clsco.passes.pack import camera_struct, layer_struct, pose_structs, surface_structs, texture_planes
from clsco.passes.static_image import StillMap
from clsco.passes.warp import ForwardWarp
from clsco.plan.approximation import METHODS, ApproximationReport, estimate, sample_places
from clsco.plan.buffers import TRUTH_BUFFERS, source_bytes
from clsco.plan.memory import Limit, device_bytes, fitted
from clsco.plan.methods import MANY_RADII, BlurSpec
from clsco.plan.plan import Plan, exposure, widened
from clsco.plan.predict import Maps
from clsco.records import WIDE_BYTES, Real, Struct, structs
from clsco.scene.model import DepthMap

BOOLEAN = ("hidden", "occluded")
Planes = tuple[cl.Buffer, cl.Buffer, cl.Buffer]  # value, coc, valid on the padded grid, as in layers.py
OUTGROWN = (
    "blur", "source", "value", "label", "pixels", "sub_source", "depth", "sub_depth", "sub_value", "slabs", "coc",
    "valid",
)  # fmt: skip
SLACK = 1.0 + 1e-6  # the host's float64 and the device's float round differently
# What of the statistics a frame must begin with: no radius met, no slot taken (trace.cl).
EMPTY_STATISTICS = np.array([0, np.iinfo(np.int32).max, 0, 0], dtype=np.int32)


class Hits:
    """What `cast` found for the lenses of one group: planes of hits, the last moment's of each layer."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.buffers: dict[Layer, tuple[cl.Buffer, cl.Buffer, cl.Buffer]] = {}
        self.times: dict[Layer, float] = {}

    def planes(self, plan: Plan, time: float, layer: Layer) -> tuple[tuple[cl.Buffer, cl.Buffer, cl.Buffer], bool]:
        """Planes value, depth and hit of a layer, as in trace.cl, and whether they are still to be cast for `time`."""
        area = plan.width * plan.height
        if layer not in self.buffers:
            sizes = (4 * plan.channels * area, WIDE_BYTES * area, area)
            value, depth, hit = (empty(self.session, n) for n in sizes)
            self.buffers[layer] = value, depth, hit
        new = self.times.get(layer) != time
        self.times[layer] = time
        return self.buffers[layer], new


class Renderer:
    """Owns the buffers and programs for one plan on one device.

    textures, maps: of every object, as `textures.load_scene_textures` and `depth_maps.load_scene_depths`
    give them; precision: "single", "double", or None for double where the device has it; hits: shared with the
    renderers of other lenses, whose plans have the same guard band; limit: the plan is fitted to it.
    """

    def __init__(
        self, session: Session, plan: Plan, textures: Sequence[Texture], maps: Maps, limit: Limit,
        precision: str | None = None, hits: Hits | None = None,
    ) -> None:  # fmt: skip
        device = session.device
        if precision not in (None, "single", "double"):
            raise DeviceError(f"precision: must be single or double; got {precision}")
        if (needed := device_bytes(plan, device)) > device.global_mem:
            raise DeviceError(f"device {device}: the scene needs {needed >> 20} MiB; got {device.global_mem >> 20} MiB")
        wants_double = precision == "double" or (precision is None and device.has_fp64)
        self.real: Real = "double" if wants_double else "float"
        self.session, self.plan, self.limit, self.hits = session, plan, limit, hits
        self.items = plan.scene.objects
        self.bits = max(texture.bits for texture in textures)
        self.approximations = plan.approximations  # that are left to try
        self.tried: tuple[tuple[str, float], ...] = ()
        self.smallest, self.largest, self.slots = plan.smallest_blur, plan.largest_blur, plan.slots
        self.brightest = max(float(texture.radiance.max(initial=0.0)) for texture in textures)  # none is below 0
        stack = list(dict.fromkeys(textures))  # those that several objects have in common once
        self.texture_of = [stack.index(texture) for texture in textures]
        self.still: StillMap | None = None
        if plan.still_map:
            assert maps[0] is not None
            self.still = StillMap(plan.scene.camera, textures[0].radiance, maps[0], plan.guard_px, self.real)
        else:
            self.texture = upload(session, texture_planes([texture.radiance for texture in stack], plan.channels))
        self.held: list[cl.Buffer] = []  # what queued launches still read: the host runs ahead of the device
        self.camera = self._camera(plan.strips[0])
        self.lenses = int(hits is not None)
        self.built: dict[str, int] = {}
        self.forward, self.maps = None, maps if plan.forward else ()
        if plan.forward:
            self.forward = self._forward()
        self._allocate()

    def _forward(self) -> ForwardWarp:
        at_rest = self._placed_at(rest_poses(self.plan.scene))
        return ForwardWarp(
            self.session, self.plan, self.camera, self.texture, at_rest, self.maps, self.real,
            textures=self.texture_of, brightest=self.brightest,
        )  # fmt: skip

    def _truth_names(self) -> list[str]:
        """Outputs of ground_truth; a forward warp makes its own focused image."""
        return [n for n in TRUTH_BUFFERS if n in self.plan.truth and not (n == "sharp" and self.plan.forward)]

    def _spec(self) -> BlurSpec:
        """What the blur is made for, with the range of radii met so far and the approximations that are left."""
        least = METHODS[self.approximations[0]] if self.approximations else None
        spec = replace(self.plan.spec, smallest=self.smallest, largest=self.largest)
        return replace(spec, brightest=self.brightest, least=least)

    def _build(self) -> dict[str, int]:
        """The program for the range of radii, again where a larger one needs other kernels; what it is built with."""
        plan, spec, fp64 = self.plan, self._spec(), self.session.device.has_fp64
        files = FILES_OF[plan.blur]
        if plan.still_map:
            features = image_features(spec, plan.channels, fp64)
        else:
            files = ("trace/trace.cl", *files)
            prepare = plan.forward or plan.occlusion == "layered"
            features = plan.features() | blur_features(spec, fp64, prepare)
            features |= {"TRUTH": int(bool(plan.truth)), "LENSES": self.lenses}
            features["PINHOLE"] = int(plan.occlusion == "layered" and not plan.forward)
            features |= {f"TRUTH_{name.upper()}": int(name in self._truth_names()) for name in TRUTH_BUFFERS}
        if features != self.built:
            self.program = build(self.session, files, features, structs(self.real), self.real)
            self.built = features
        return features

    def _allocate(self) -> None:
        """Buffers whose size depends on the range of radii and on the number of silhouette pixels."""
        plan, session = self.plan, self.session
        for name in OUTGROWN:
            vars(self).pop(name, None)  # before the larger ones take memory
        self.strips = plan.strips
        self.camera = self._camera(self.strips[0])
        area, features = plan.width * plan.tallest, self._build()
        self.target = Target(session, self.program, self.real)
        places = sample_places(plan.rows, plan.columns)
        self.blur = make_blur(self.target, self._spec(), plan.grid, self.camera, places)
        marked = bool(features["SUBPIXELS"] or features["OCCLUDED"])
        layered = plan.occlusion == "layered"  # which has a plane of its own
        self.source = empty(session, 0 if layered else source_bytes(area, bool(features["TILT"]), marked))
        self.value = empty(session, 4 * plan.channels * area)
        self.statistics = empty(session, EMPTY_STATISTICS.nbytes)
        each = plan.silhouettes**2
        self.label = empty(session, area if each else 0)
        self.pixels = empty(session, 4 * self.slots)
        self.sub_source = empty(session, 16 * self.slots * each)
        occluded = WIDE_BYTES * bool(features["OCCLUDED"])
        self.depth, self.sub_depth = empty(session, occluded * area), empty(session, occluded * self.slots * each)
        self.sub_value = empty(session, 4 * plan.channels * self.slots * each)
        self.slabs: DepthLayers | None = None
        if layered:
            self.slabs = DepthLayers(self.blur, self.target, plan.grid)
        if layered or plan.still_map:
            self.coc, self.valid = empty(session, WIDE_BYTES * area), empty(session, area)

    def _poses(self, time: float) -> tuple[Pose, ...]:
        return poses_at(self.plan.scene, time, self.plan.eye)

    def _placed_at(self, poses: Sequence[Pose]) -> list[PlacedSurface | None]:
        """The objects in their poses; a depth map is no surface that a ray could meet."""
        pairs = zip(self.items, poses, strict=True)
        return [None if isinstance(item, DepthMap) else place(item, pose) for item, pose in pairs]

    def _surfaces(self, time: float) -> list[PlacedSurface]:
        return [surface for surface in self._placed_at(self._poses(time)) if surface is not None]

    def _upload(self, array: NDArray[Any]) -> cl.Buffer:
        """What a launch of this frame reads."""
        self.held.append(upload(self.session, array))
        return self.held[-1]

    def _placed(self, surfaces: Sequence[PlacedSurface]) -> cl.Buffer:
        return self._upload(surface_structs(self.items, surfaces, self.real, self.texture_of))

    def _camera(self, strip: Strip) -> Struct:
        return camera_struct(self.plan.scene.camera, self.plan.guard_px, self.real, strip)

    def begin(self, times: Sequence[float]) -> None:
        """Begin a frame of these moments: no light yet."""
        self.events: Events = []
        shape = (self.plan.rows, self.plan.columns)
        self.color = np.empty(shape if self.plan.channels == 1 else (*shape, self.plan.channels), np.float32)
        cl.enqueue_copy(self.session.queue, self.statistics, EMPTY_STATISTICS)
        self.slabs_at = {time: self._slabs_at(time) for time in times if len(self.strips) > 1 and self.slabs}

    def _slabs_at(self, time: float) -> Slabs:
        """Slabs of a moment, from all strips."""
        assert self.slabs is not None
        for strip in self.strips:
            self._turn_to(strip)
            _, coc, valid = self._look(time, 0.0, self.events)
            self.slabs.find(coc, valid, self.events)
        return self.slabs.labels.found()

    def _turn_to(self, strip: Strip) -> None:
        self.strip = strip
        self.camera = self.blur.camera = self._camera(strip)

    def begin_strip(self, strip: Strip) -> None:
        """Begin one of the strips of the frame."""
        self._turn_to(strip)
        self.moments: list[dict[str, Any]] = []  # the same for every strip
        self.blur.clear()

    def add_moment(self, time: float, weight: float) -> None:
        """Add one intermediate frame to the strip."""
        self.moments.append(self._moment(time, weight, self.events))

    def end_strip(self, strip: Strip) -> None:
        """Read back a strip of which all intermediate frames have been added."""
        self.blur.image(self.events, self.color[strip.inside])

    def finish(self, index: int) -> Frame:
        """The frame of this number, of the strips added: again with larger buffers where the plan was too small."""
        while self._outgrown() or self._too_far_off():
            expose([self], index)
        truth = self._ground_truth(index, self.events)
        self.held.clear()
        eye = self.plan.eye if self.plan.scene.stereo else ""
        about = self._metadata(index, self.moments, self.events)
        if self.tried:  # the next frame is what it would be by itself
            self.approximations, self.tried = self.plan.approximations, ()
            self._allocate()
        return Frame(index=index, color=self.color, metadata=about, eye=eye, **truth)

    def _moment(self, time: float, weight: float, events: Events) -> dict[str, Any]:
        """One intermediate frame: its sources, blurred and added; returns what is told of it."""
        report: dict[str, Any] = {"time": time, "weight": weight}
        report |= {"missing_pixels": 0, "filled_pixels": 0, "unfilled_pixels": 0, "sweeps": 0}
        if self.forward is not None:
            poses = self._poses(time)
            warped = self.forward.warp(poses, self._placed_at(poses), weight, events)
            self.forward.note_radii(self.statistics, events)
            report |= warped.counters
            return report | self._add_planes((warped.value, warped.coc, warped.valid), time, events)
        if self.still is not None:
            report["missing_pixels"] = report["unfilled_pixels"] = int(self.still.missing.sum())
            self.still.send(self.session, self.strip, self.value)
        if self.slabs is not None or self.still is not None:
            return report | self._add_planes(self._look(time, weight, events), time, events)
        surfaces = self._placed(self._surfaces(time))
        for layer in self.plan.layers:
            sources = self._trace(surfaces, layer, time, weight, events)
            self.blur.add(replace(sources, radius=self._central_radius(time)), events)
        return report

    def _add_planes(self, planes: Planes, time: float, events: Events) -> dict[str, int]:
        """Light of an image with its blur radii; how many slabs it took where occlusion is layered."""
        value, coc, valid = planes
        if self.slabs is not None:
            return {"slabs": self.slabs.add(planes, events, self.slabs_at.get(time))}
        if self.plan.blur in MANY_RADII:
            prepare_sources(self.target, self.camera, self.blur.struct, (coc, valid), self.source, events)
        self.blur.add(Sources(self.source, value, radius=self._central_radius(time)), events)
        return {}

    def _look(self, time: float, weight: float, events: Events) -> Planes:
        """What the pinhole sees of all objects."""
        planes = (self.value, self.coc, self.valid)
        if self.still is not None:
            self.still.send_radii(self.session, self.strip, self.coc, self.valid)
            return planes
        surfaces = self._placed(self._surfaces(time))
        head = (self.camera, surfaces, self._everything(), np.float32(weight), self.texture)
        self._per_pixel("pinhole", events, *head, *planes, self.statistics)
        return planes

    def _everything(self) -> Struct:
        return layer_struct(Layer((1 << len(self.items)) - 1, 0), len(self.items))

    def _central_radius(self, time: float) -> float:
        """|R| on the axis, which is that of every pixel where the blur is a convolution."""
        if self.plan.blur != "convolve":
            return 0.0
        surface = self._surfaces(time)[0]
        inverse_depth = -2.0 * float(surface.canonical.l @ surface.turn[:, 2]) / surface.constant
        return abs(float(blur_radius(self.plan.scene.camera, inverse_depth)))

    def _trace(self, surfaces: cl.Buffer, layer: Layer, time: float, weight: float, events: Events) -> Sources:
        """Sources of one layer; its buffers are those of the layer before, which the queue is done with by then."""
        plan, camera = self.plan, self.camera
        head = (camera, surfaces, layer_struct(layer, len(self.items)), self.blur.struct)
        occluded = bool(plan.features()["OCCLUDED"])
        share, slots = np.float32(weight), np.int32(self.slots)
        if plan.silhouettes:
            cl.enqueue_fill_buffer(self.session.queue, self.statistics, np.zeros(1, np.int32), 8, 4)
        value, depth, out = self.value, self.depth, (self.source, self.label, self.statistics)
        if self.hits is None:
            args = (*head, share, self.texture, self.source, value, self.label, self.statistics)
            self._per_pixel("trace", events, *args, *((depth,) if occluded else ()))
        else:
            planes, new = self.hits.planes(plan, time, layer)
            value, depth, hit = planes
            if new:
                self._per_pixel("cast", events, *head[:3], share, self.texture, *planes)
            self._per_pixel("aim", events, *head, depth, hit, *out)
        seen: dict[str, Any] = {"surfaces": surfaces, "layer": head[2], "depth": depth} if occluded else {}
        if not plan.silhouettes:
            return Sources(self.source, value, **seen)
        self._per_pixel(
            "mark_silhouettes", events, camera, self.label, slots, self.source, self.pixels, self.statistics
        )
        subs = (self.sub_source, self.sub_value, self.statistics, *((self.sub_depth,) if occluded else ()))
        self._launch(
            "trace_subpixels", (self.slots * plan.silhouettes**2,), (64,), events,
            *head, share, self.texture, self.pixels, slots, *subs,
        )  # fmt: skip
        seen |= {"sub_depth": self.sub_depth} if occluded else {}
        return Sources(self.source, value, self.sub_source, self.sub_value, self.slots, **seen)

    def _outgrown(self) -> bool:
        """Whether the frame met more than was predicted; if so, makes room for it."""
        if self.still is not None:
            return False
        found = download(self.session, self.statistics, EMPTY_STATISTICS.shape, np.int32)
        largest, smallest = (float(r) for r in found[:2].view(np.float32))
        slots = int(found[3])
        fits = largest <= self.largest * SLACK + 1e-6 and smallest >= self.smallest / SLACK - 1e-6
        if largest == 0.0 or (fits and slots <= self.slots):
            return False
        self.slots = max(slots, self.slots)
        if not fits:
            self.largest, self.smallest = max(largest * SLACK, self.largest), min(smallest / SLACK, self.smallest)
            self.plan = fitted(widened(self.plan, self.largest), self.limit)
            self.hits = None  # the guard band may not be that of the others any more
            if self.forward is not None:
                self.forward = None  # before the larger one takes memory
                self.camera = self._camera(self.plan.strips[0])
                self.forward = self._forward()
        self._allocate()
        return True

    def _too_far_off(self) -> bool:
        """Whether the frame's error passes the tolerance; if so, takes the next better approximation."""
        report = self._approximation_report()
        if report is None or report.tolerance is None or report.at_most <= report.tolerance:
            return False
        self.tried += ((report.method, report.at_most),)
        self.approximations = self.approximations[1:]
        self._allocate()
        return True

    def _approximation_report(self) -> ApproximationReport | None:
        """Report of the frame's approximation, None where none was requested."""
        tolerance = self.plan.tolerance
        if isinstance(self.blur, Multigrid):
            missed = self.blur.missed()
            return ApproximationReport(self.approximations[0], tolerance, *estimate(missed), len(missed), self.tried)
        return None if tolerance is None else ApproximationReport("exact", tolerance, 0.0, 0.0, 0, self.tried)

    def _ground_truth(self, index: int, events: Events) -> dict[str, NDArray[Any]]:
        plan = self.plan
        if not plan.truth:
            return {}
        if any(isinstance(item, DepthMap) for item in self.items):
            return self._map_truth(index, events)
        time, later = self._middles(index)
        pixels = self.strips[0].rows * plan.columns
        names = self._truth_names()
        sizes = {n: TRUTH_BUFFERS[n][1] or plan.channels for n in names}
        mask = empty(self.session, pixels)
        buffers = {n: empty(self.session, pixels * sizes[n] * TRUTH_BUFFERS[n][0]().itemsize) for n in names}
        at_rest = [surface for surface in self._placed_at(rest_poses(plan.scene)) if surface is not None]
        surfaces, still = self._placed(self._surfaces(time)), self._placed(at_rest)
        poses = self._upload(pose_structs(self._poses(later), self.real))
        head = (surfaces, still, poses, self._everything(), self.texture, mask)
        args: list[Any] = [buffer for name, buffer in buffers.items() if name not in STEREO_NAMES]
        if set(STEREO_NAMES) & set(names):
            opposite = poses_at(plan.scene, time, "left" if plan.eye == "right" else "right")
            args += [self._placed([surface for surface in self._placed_at(opposite) if surface is not None])]
            args += [self._upload(pose_structs(opposite, self.real)), np.int32(1 if plan.eye == "right" else -1)]
            args += [buffers[name] for name in STEREO_NAMES if name in names]
        shape = (plan.rows, plan.columns)
        out: dict[str, NDArray[Any]] = {"mask": np.empty(shape, np.bool_)}
        for name in names:
            full = shape if sizes[name] == 1 else (*shape, sizes[name])
            out[name] = np.empty(full, np.bool_ if name in BOOLEAN else TRUTH_BUFFERS[name][0])
        for strip in self.strips:
            self._launch("ground_truth", (plan.columns, strip.rows), PIXELS, events, self._camera(strip), *head, *args)
            for name, buffer in ({"mask": mask} | buffers).items():
                download_into(self.session, buffer, out[name][strip.inside])
        if self.forward is not None:
            poses_now = self._poses(time)
            out |= self.forward.truth(poses_now, self._placed_at(poses_now), plan.truth, events)
        out |= {"filled": np.zeros(shape, np.uint8)} | out
        return {name: array for name, array in out.items() if name in plan.truth}

    def _middles(self, index: int) -> tuple[float, float]:
        """Times of the ground truth of a frame and of the next one."""
        if not self.plan.moves:
            return 0.0, 0.0
        return middle_time(self.plan.scene.sequence, index), middle_time(self.plan.scene.sequence, index + 1)

    def _map_truth(self, index: int, events: Events) -> dict[str, NDArray[Any]]:
        """Ground truth of a scene with depth maps, which no ray can be cast at: of the pixels in their new places."""
        now, then = (self._poses(t) for t in self._middles(index))
        needed = {"depth", "object_id", "filled"}  # for the others
        forward = self.forward
        if self.still is not None:
            out = self.still.truth()
        else:
            assert forward is not None
            out = forward.truth(now, self._placed_at(now), needed | set(self.plan.truth), events)
        where = (self.plan.scene.camera, self.items, out["depth"], out["object_id"])
        out |= {"normal": map_normal(self.plan.scene.camera, out["depth"]), "flow": map_flow(*where, now, then)}
        out["hidden"] = out["filled"] > 0
        if forward is not None and self.plan.scene.stereo is not None:
            there = poses_at(self.plan.scene, self._middles(index)[0], "left" if self.plan.eye == "right" else "right")
            opposite = forward.truth(there, self._placed_at(there), ("depth",), events)["depth"]
            out["disparity"], out["occluded"] = map_stereo(*where, now, there, opposite, self.plan.eye)
        out["depth"] = out["depth"].astype(np.float32)
        return {name: array for name, array in out.items() if name in self.plan.truth}

    def _metadata(self, index: int, moments: list[dict[str, Any]], events: Events) -> dict[str, Any]:
        seconds: dict[str, float] = {}
        for name, event in events:
            spent = 1e-9 * (event.profile.end - event.profile.start)
            seconds[name] = seconds.get(name, 0.0) + spent
        device, report = self.session.device, self._approximation_report()
        return {
            "frame": index,
            "intermediate": moments,
            "samples": len(moments),
            "guard_px": self.plan.guard_px,
            "strips": len(self.strips),
            "blur_method": self.plan.blur,
            "approximation": None if report is None else asdict(report),
            "bits": self.bits,
            "device": str(device),
            "precision": "double" if self.real == "double" else "single",
            "version": __version__,
            "seconds": seconds,
        }

    def _per_pixel(self, name: str, events: Events, *args: Any) -> None:
        size = (int(self.camera["width"]), int(self.camera["height"]))
        self._launch(name, size, PIXELS, events, *args)

    def _launch(self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: Any) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))


def expose(renderers: Sequence[Renderer], index: int) -> None:
    """Light of the frame of this number, strip by strip and moment by moment, for renderers with the same of both."""
    times, weights = exposure(renderers[0].plan, index)
    for renderer in renderers:
        renderer.begin(times.tolist())
    for strip in renderers[0].strips:
        for renderer in renderers:
            renderer.begin_strip(strip)
        for time, weight in zip(times.tolist(), weights.tolist(), strict=True):
            for renderer in renderers:
                renderer.add_moment(time, weight)
        for renderer in renderers:
            renderer.end_strip(strip)
