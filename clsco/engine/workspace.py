"""Workspaces: the buffers of a plan on a device, with a method for each kind of pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import pyopencl as cl

from clsco.frame.strips import Grid
from clsco.opencl.buffers import allocate
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.lens_path import colored
from clsco.optics.quadrics import axial_blur_radius
from clsco.passes.accumulate import FrameSum
from clsco.passes.blur import (
    BehindRims,
    BlurredPlane,
    Image,
    Maps,
    Plane,
    Sources,
    blur_target,
    padded_plane,
    prepare_sources,
)
from clsco.passes.fill import FillPlanes
from clsco.passes.frame_blur import make_blur
from clsco.passes.job import Job, SceneJob
from clsco.passes.pack import psf_struct, towards
from clsco.passes.placed import PlacedScene
from clsco.passes.static_image import StaticMap
from clsco.passes.tables import tables_of
from clsco.passes.trace import Hits, Tracer
from clsco.passes.warp import ForwardWarp
from clsco.plan.buffers import SHARED, hit_buffers, sensor_buffers, sum_buffers
from clsco.plan.image import ImagePlan
from clsco.plan.memory import buffer_bytes
from clsco.plan.methods import BlurSpec
from clsco.plan.passes import Kind, Pass, run_passes
from clsco.plan.plan import Plan
from clsco.records import Real, Struct

if TYPE_CHECKING:  # imported at run time only for plans that need them
    from clsco.passes.clusters import Clusters, Layers
    from clsco.passes.colors import JoinedColors
    from clsco.passes.layered import DepthLayers
    from clsco.passes.sensor import FrameSensor
    from clsco.passes.vignetting import Vignetting

Pixels = ForwardWarp | StaticMap | None
"""Supplier of the pixels in the reference pose: a forward warp or a static map; None if rays are cast."""
Outputs = tuple[Any, ...]
"""Outputs of a pass, in the order of `Pass.gives`."""


def shared_buffers(session: Session, plan: Plan | ImagePlan, absent: Iterable[str] = ()) -> dict[str, cl.Buffer]:
    """Allocate the buffers of `SHARED` that a plan needs, except the `absent` ones. Raises DeviceError."""
    sizes = buffer_bytes(plan)
    return allocate(session, {name: sizes[name] for name in SHARED if name in sizes and name not in absent})


class Workspace:
    """Buffers of `SHARED` that a plan has, and a method for each kind of pass; base class of all workspaces.

    A pass is run by the method that is named after its kind. The method takes a job, the pass and the pass's inputs,
    and returns the pass's outputs.
    """

    def __init__(self, session: Session, buffers: Mapping[str, cl.Buffer]) -> None:
        self.session, self.buffers = session, buffers

    def run(self, passes: Iterable[Pass], job: Any, after: Callable[[Kind], None] | None = None) -> Mapping[str, Any]:
        """Run passes on the part of an image that `job` describes; returns their outputs, named as in `Pass`.

        after: called after each pass with its kind. Raises CanceledError.
        """

        def run_pass(step: Pass, *inputs: Any) -> Outputs:
            self.session.go_on()
            self.session.doing(step.kind)
            outputs = self.run_pass(job, step, *inputs)
            if after is not None:
                after(step.kind)
            return outputs

        return run_passes(passes, run_pass)

    def run_pass(self, job: Any, step: Pass, *inputs: Any) -> Outputs:
        """Run a pass by the method that is named after its kind."""
        outputs: Outputs = getattr(self, step.kind.replace(" ", "_"))(job, step, *inputs)
        return outputs


class BlurWorkspace(Workspace):
    """Runs the passes from an image or sources to the blurred plane.

    buffers: include "source" if images become sources; tallest: grid of the frame, or of the tallest of its strips;
    grid: grid_t of the first strip; maps: kind of map in which images have their blur radii; behind_rims: returns the
    lens for a job, needed if rims of the aperture cut the light of images.
    """

    _target: Target
    _blurred: BlurredPlane
    _clusters: Clusters
    _composite: DepthLayers

    def __init__(
        self,
        session: Session,
        buffers: Mapping[str, cl.Buffer],
        spec: BlurSpec,
        tallest: Grid,
        grid: Struct,
        real: Real,
        maps: Maps,
        behind_rims: BehindRims | None = None,
    ) -> None:
        super().__init__(session, buffers)
        self.spec, self._behind_rims = spec, behind_rims if spec.occluders else None
        if spec.method == "none":
            return
        self._target = blur_target(session, spec, tallest.channels, real, maps)
        self._blurred = make_blur(self._target, spec, tallest, grid)
        if spec.layered:
            from clsco.passes.clusters import Clusters, layered_program
            from clsco.passes.layered import DepthLayers

            kernels = layered_program(session, tallest.channels, real, alpha=spec.images > 0, cells=spec.cells)
            self._clusters = Clusters(kernels, spec, tallest)
            self._composite = DepthLayers(self._blurred, self._clusters, tallest, behind_rims)

    def find_layers(self, passes: Iterable[Pass], jobs: Iterable[Any]) -> tuple[tuple[int, ...], ...]:
        """Bounds of depth layers, from the discontinuities in all strips together; empty without layered occlusion.

        jobs: one for each strip.
        """
        if not self.spec.layered:
            return ()
        before = tuple(takewhile(lambda step: step.kind != "cluster", passes))
        for job in jobs:
            self._clusters.find(job, _all_of(self.run(before, job)["image"]))
        return (self._clusters.read_bounds(),)

    def sources(self, job: Job, _: Pass, image: Image) -> Outputs:
        behind = {} if self._behind_rims is None else self._behind_rims(job) | {"depth": self.buffers["depth"]}
        rims = (behind["lens"], behind["depth"]) if behind else ()
        source = self.buffers["source"]
        prepare_sources(self._target, job.grid, self._blurred.struct, image.maps, source, job.events, rims)
        return (Sources(source, image.value, **behind),)

    def blur(self, job: Job, _: Pass, sources: Sources | None, plane: Plane | None = None) -> Outputs:
        if plane is None:
            self._blurred.begin(job.grid)
        if sources is not None:
            self._blurred.add(sources, job.events)
        return (self._blurred.plane(job.events),)

    def cluster(self, job: Job, step: Pass, image: Image | tuple[Image, ...]) -> Outputs:
        images = _all_of(image)
        if job.bounds is not None:
            return (self._clusters.divide(job, images, job.bounds[step.color or 0]),)
        self._clusters.find(job, images)
        return (self._clusters.divide(job, images, self._clusters.read_bounds()),)

    def depth_layers(self, job: Job, _: Pass, layers: Layers) -> Outputs:
        self._blurred.begin(job.grid)
        return self._composite.add(job, layers), layers.count


def _all_of(image: Image | tuple[Image, ...]) -> tuple[Image, ...]:
    return image if isinstance(image, tuple) else (image,)


@dataclass(frozen=True)
class ColorChannel:
    """Textures and pixels of all colors together, or of one color. scene: its textures have only these colors."""

    scene: PlacedScene
    pixels: Pixels


class PlaneWorkspace(BlurWorkspace):
    """Runs the passes up to the blurred plane of a time sample, for all colors together or for one color.

    buffers: those of `SHARED`, shared by all colors; hits: ray hits shared with other lenses; grid: grid_t of the first
    strip.
    """

    def __init__(
        self, plan: Plan, channel: ColorChannel, buffers: dict[str, cl.Buffer], hits: Hits | None, grid: Struct
    ) -> None:
        scene = channel.scene
        self.plan = plan
        if isinstance(channel.pixels, StaticMap):
            self._static = channel.pixels
        elif channel.pixels is not None:
            self._warp = channel.pixels
        spec = replace(plan.spec, brightest=scene.brightest)
        psf = psf_struct(spec.psf, *tables_of(spec, scene.session), scene.real)
        self.tracer = Tracer(plan, scene, buffers, psf, hits)
        from_image = plan.forward or plan.static_map or plan.occlusion == "layered"
        maps: Maps = "wide" if from_image else "none"
        behind_rims = self.tracer.without_occluders
        super().__init__(scene.session, buffers, spec, plan.grid, grid, scene.real, maps, behind_rims)

    def run_pass(self, job: SceneJob, step: Pass, *inputs: Any) -> Outputs:
        if step.color is not None and self.plan.scene.shifts_colors:  # each color has its own rays
            camera = colored(job.sample.camera, self.plan.scene.lens, step.color)
            job = replace(job, grid=towards(job.grid, camera), sample=replace(job.sample, camera=camera))
        return super().run_pass(job, step, *inputs)

    def trace(self, job: SceneJob, step: Pass) -> Outputs:
        if job.changes.get(step.group, ()) is None:
            return (None,)
        return (self._for_blur(job, self.tracer.trace(job, step.group)),)

    def silhouettes(self, job: SceneJob, step: Pass, sources: Sources | None) -> Outputs:
        return (None if sources is None else self.tracer.silhouettes(job, step.group, sources),)

    def pinhole(self, job: SceneJob, _: Pass) -> Outputs:
        return (self._for_blur(job, self.tracer.pinhole(job)),)

    def static_image(self, job: SceneJob, _: Pass) -> Outputs:
        missing = int(self._static.missing.sum())
        image = self._for_blur(job, self._static.image(job, self.buffers))
        return image, {"missing_pixels": missing, "unfilled_pixels": missing}

    def reproject(self, job: SceneJob, _: Pass) -> Outputs:
        self._warp.nearest(job.sample, job.events)
        self._warp.gather(job.events)
        return (self._warp.filler.planes,)

    def fill(self, job: SceneJob, _: Pass, moved: FillPlanes) -> Outputs:
        counters = self._warp.fill(job.sample, job.events)
        self._warp.note_radii(self.buffers["statistics"], job.events)
        image = self._for_blur(job, Image(moved.value, (moved.coc, moved.valid)))
        return image, counters, *((self._warp.missing(),) if "missing" in self.plan.truth else ())

    count_missing = fill

    def _for_blur(self, job: SceneJob, light: Image | Sources) -> Image | Sources | Plane:
        """Convert the output of a pass to the kind that `clsco.plan.image.light_of` names."""
        if self.plan.blur not in ("none", "convolve"):
            return light
        if self.plan.blur == "none":
            return padded_plane(job.grid, light.value, self.plan.channels)
        surface = next(placed for placed in job.sample.placed if placed is not None)  # one plane at one depth
        lens = Lens.of(job.sample.camera, self.plan.scene.lens, self.plan.only)
        return Sources(None, light.value, radius=abs(axial_blur_radius(lens, surface)))


class SceneWorkspace(Workspace):
    """Runs all passes of a scene.

    channels: one for all colors, or one for each color in `Plan.color_plans`; hits: ray hits shared with other lenses;
    grid: grid_t of the first strip.
    """

    _joined: JoinedColors
    _darkened: Vignetting
    _frame: FrameSum
    _sensor: FrameSensor

    def __init__(self, plan: Plan, channels: Sequence[ColorChannel], hits: Hits | None, grid: Struct) -> None:
        session, scene = channels[0].scene.session, plan.scene
        buffers = shared_buffers(session, plan, () if hits is None else hit_buffers(plan.grid, plan.mapped > 0))
        super().__init__(session, buffers)
        pairs = zip(plan.color_plans or (plan,), channels, strict=True)
        self.planes = tuple(PlaneWorkspace(color_plan, channel, buffers, hits, grid) for color_plan, channel in pairs)
        if plan.color_plans:
            from clsco.passes.colors import JoinedColors

            self._joined = JoinedColors(session, plan.channels, plan.colors)
        if plan.color and scene.lens is not None and scene.darkens:
            from clsco.passes.vignetting import Vignetting

            self._darkened = Vignetting(session, scene.lens.vignetting, plan.colors, plan.rows * plan.columns)
        if plan.color and plan.averages:
            self._frame = FrameSum(session, sum_buffers(plan.grid), scene.sequence.by_columns)
        if plan.sensor_model is not None:
            from clsco.passes.sensor import FrameSensor

            self._sensor = FrameSensor(session, plan.sensor_model, sensor_buffers(plan.sensor_model, plan.grid))

    def run_pass(self, job: SceneJob, step: Pass, *inputs: Any) -> Outputs:
        if hasattr(self, step.kind.replace(" ", "_")):
            return super().run_pass(job, step, *inputs)
        return self.planes[step.color or 0].run_pass(job, step, *inputs)

    def find_layers(self, passes: Sequence[Pass], jobs: Iterable[SceneJob]) -> tuple[tuple[int, ...], ...] | None:
        """Bounds of depth layers by `BlurWorkspace.find_layers`; None without layered occlusion. There is one entry for
        all colors, or one for each of red, green and blue.
        """
        strips, bounds = tuple(jobs), list[tuple[int, ...]]()
        for plane in self.planes:
            bounds += plane.find_layers([step for step in passes if step.color == plane.plan.only], strips)
        return tuple(bounds) or None

    def join_colors(self, job: SceneJob, step: Pass, plane: Plane, *_: Plane) -> Outputs:
        return (self._joined.put(plane, step.color or 0, job.events),)

    def vignetting(self, job: SceneJob, _: Pass, plane: Plane) -> Outputs:
        return (self._darkened.darken(plane, job.sample.camera, job.strip.top, job.events),)

    def accumulate(self, job: SceneJob, _: Pass, plane: Plane) -> Outputs:
        if job.is_first:
            self._frame.clear()
        strip = job.whole_strip
        return (self._frame.add(plane, job.weights, job.events, job.strip.top - strip.top, strip.rows),)

    def sensor(self, job: SceneJob, _: Pass, light: Plane) -> Outputs:
        stream = job.noise_stream
        return (None if stream is None else self._sensor.expose(job.whole_strip, light, stream, job.events),)
