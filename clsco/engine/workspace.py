"""Workspace of a plan on a device: its buffers, and the function that runs each of its passes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import pyopencl as cl

from clsco.frame.strips import Grid
from clsco.opencl.buffers import allocate
from clsco.opencl.session import Session
from clsco.optics.depth_layers import LayerBounds
from clsco.optics.lens import Lens
from clsco.optics.lens_path import colored
from clsco.optics.quadrics import axial_blur_radius
from clsco.passes.accumulate import FrameSum
from clsco.passes.blur import (
    Area,
    BehindRims,
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
from clsco.passes.pack import psf_struct, towards
from clsco.passes.placed import Moment, PlacedScene
from clsco.passes.static_image import StaticMap
from clsco.passes.tables import tables_of
from clsco.passes.trace import Hits, Tracer
from clsco.passes.warp import ForwardWarp
from clsco.plan.buffers import SHARED, hit_buffers, sensor_buffers, sum_buffers
from clsco.plan.image import ImagePlan
from clsco.plan.methods import BlurSpec
from clsco.plan.passes import Kind, Pass, run_passes
from clsco.plan.plan import Plan
from clsco.records import Real, Struct

if TYPE_CHECKING:  # imported where a plan has them
    from clsco.passes.clusters import Clusters, Layers
    from clsco.passes.colors import JoinedColors
    from clsco.passes.sensor import FrameSensor
    from clsco.passes.vignetting import Vignetting

Run = Callable[..., tuple[Any, ...]]
"""Runs a pass: gets the part of the frame, and what the pass takes; returns what it gives."""
Pixels = ForwardWarp | StaticMap | None
"""Pixels of the reference pose that are moved, or taken as they are."""


@dataclass(frozen=True)
class Workspace:
    """Functions that run the passes of a plan on a device, and the state that they share.

    Attributes
    ----------
    session : Session
    runs : mapping
        Function that runs each kind of pass.
    buffers : mapping
        Buffers of `SHARED` that the plan has.
    clusters : tuple of Clusters
        The pass that finds depth layers, if the plan has one.
    colors : tuple of Workspace
        Workspaces of red, green and blue, if each is blurred by itself.
    aims : callable, optional
        Replaces the rays of an area by those of a color, if colors have different rays.
    """

    session: Session
    runs: Mapping[Kind, Run]
    buffers: Mapping[str, cl.Buffer]
    clusters: tuple[Clusters, ...] = ()
    colors: tuple[Workspace, ...] = ()
    aims: Callable[[Any, int], Area] | None = None

    def run(self, passes: Iterable[Pass], at: Area, after: Callable[[Kind], None] | None = None) -> Mapping[str, Any]:
        """Run passes on a part of a frame; returns their outputs, named as in `Pass`. Raises CanceledError.

        after: called after each pass with its kind.
        """

        def run(step: Pass, *given: Any) -> tuple[Any, ...]:
            self.session.go_on()
            self.session.doing(step.kind)
            same = step.group is at.group and step.color == at.color
            part = at if same else replace(at, group=step.group, color=step.color)
            if self.aims is not None and step.color is not None:
                part = self.aims(part, step.color)
            of_color = self.colors and step.color is not None and step.kind != "join colors"
            runs = self.colors[step.color or 0].runs if of_color else self.runs
            result = runs[step.kind](part, *given)
            if after is not None:
                after(step.kind)
            return result

        return run_passes(passes, run)

    def find_layers(self, passes: Iterable[Pass], strips: Iterable[Area]) -> tuple[LayerBounds, ...] | None:
        """Bounds of depth layers over several strips, which one strip cannot find: for all colors, or for red, green
        and blue. None without layers.
        """
        if self.colors:
            steps, areas = tuple(passes), tuple(strips)
            found: tuple[LayerBounds, ...] = ()
            for color, one in enumerate(self.colors):
                found += one.find_layers([step for step in steps if step.color == color], areas) or ()
            return found or None
        bounds = None
        for clusters in self.clusters:
            before = tuple(takewhile(lambda step: step.kind != "cluster", passes))
            for at in strips:
                clusters.find(at, self.run(before, at)["image"])
            bounds = (clusters.found(),)
        return bounds


def shared_buffers(session: Session, plan: Plan | ImagePlan, absent: Iterable[str] = ()) -> dict[str, cl.Buffer]:
    """Buffers of `SHARED` that a plan has, except the `absent` ones. Raises DeviceError."""
    sizes = {name: size for each in plan.passes for name, size in each.buffers.items()}
    return allocate(session, {name: sizes[name] for name in SHARED if name in sizes and name not in absent})


def scene_workspace(plan: Plan, lights: Sequence[Light], hits: Hits | None, grid: Struct) -> Workspace:
    """Workspace of a scene; grid: grid_t of its first strip.

    Parameters
    ----------
    plan : Plan
    lights : sequence of Light
        Textures and pixels of all colors, or of each color in `Plan.apart`.
    hits : Hits, optional
        Ray hits shared with other lenses.
    grid : numpy.void

    Raises
    ------
    DeviceError, KernelError
    """
    session = lights[0].scene.session
    buffers = shared_buffers(session, plan, () if hits is None else hit_buffers(plan.grid, plan.mapped > 0))
    each = [_light_workspace(*pair, buffers, hits, grid) for pair in zip(plan.apart or (plan,), lights, strict=True)]
    runs = dict(each[0].runs)
    if plan.apart:
        from clsco.passes.colors import JoinedColors

        runs = _joining_runs(JoinedColors(session, plan.channels, plan.colors))
    if plan.color and plan.scene.lens is not None and plan.scene.darkens:
        from clsco.passes.vignetting import Vignetting

        runs |= _vignetting_runs(Vignetting(session, plan.scene.lens.vignetting, plan.colors, plan.rows * plan.columns))
    if plan.color and plan.averages:
        runs |= _exposure_runs(FrameSum(session, sum_buffers(plan.grid), plan.scene.sequence.by_columns))
    if plan.sensor_model is not None:
        from clsco.passes.sensor import FrameSensor

        runs |= _sensor_runs(FrameSensor(session, plan.sensor_model, sensor_buffers(plan.sensor_model, plan.grid)))
    return Workspace(session, runs, buffers, each[0].clusters, tuple(each) if plan.apart else (), _aims(plan))


def _aims(plan: Plan) -> Callable[[Moment, int], Moment] | None:
    """Function for `Workspace.aims`, or None."""
    if not plan.scene.shifts_colors:
        return None

    def aimed(at: Moment, color: int) -> Moment:
        camera = colored(at.sample.camera, plan.scene.lens, color)
        return replace(at, grid=towards(at.grid, camera), sample=replace(at.sample, camera=camera))

    return aimed


@dataclass(frozen=True)
class Light:
    """Textures and pixels of all colors, or of one.

    Attributes
    ----------
    scene : PlacedScene
        The scene with its textures in these colors.
    pixels : ForwardWarp or StaticMap, optional
        Source of pixels in the reference pose: moved by a forward warp, or static.
    """

    scene: PlacedScene
    pixels: Pixels


def _light_workspace(
    plan: Plan, light: Light, buffers: dict[str, cl.Buffer], hits: Hits | None, grid: Struct
) -> Workspace:  # fmt: skip
    """The passes up to the blurred plane of a time sample, in buffers that all colors share."""
    scene = light.scene
    session, real, runs = scene.session, scene.real, _pixel_runs(plan, light.pixels, buffers)
    if not plan.color:
        return Workspace(session, runs, buffers)
    spec = replace(plan.spec, brightest=scene.brightest)
    lit = plan.forward or plan.static_map or plan.occlusion == "layered"
    tracer = Tracer(plan, scene, buffers, psf_struct(spec.psf, *tables_of(spec, session), real), hits)
    maps: Maps = "wide" if lit else "none"
    blurs, clusters = blur_runs(session, spec, plan.grid, grid, buffers, real, maps, tracer.nothing_hidden)
    runs |= _ray_runs(tracer, _handed_on(plan)) | blurs
    return Workspace(session, runs, buffers, clusters)


def _handed_on(plan: Plan) -> Callable[[Moment, Any], Any]:
    """Function that turns the sources of a pass into its output, named by `clsco.plan.image.light_of`."""

    def plane(at: Moment, light: Image | Sources) -> Plane:
        return padded_plane(at.grid, light.value, plan.channels)

    def sources(at: Moment, light: Image | Sources) -> Sources:
        surface = next(each for each in at.sample.placed if each is not None)  # one plane at one depth
        lens = Lens.of(at.sample.camera, plan.scene.lens, plan.only)
        return Sources(None, light.value, radius=abs(axial_blur_radius(lens, surface)))

    def itself(_: Moment, light: Image | Sources) -> Image | Sources:
        return light

    return {"none": plane, "convolve": sources}.get(plan.blur, itself)


def _ray_runs(tracer: Tracer, handed_on: Callable[[Moment, Any], Any]) -> dict[Kind, Run]:
    def trace(at: Moment) -> tuple[Any, ...]:
        return (handed_on(at, tracer.trace(at)),)

    def silhouettes(at: Moment, sources: Sources | None) -> tuple[Any, ...]:
        return (tracer.silhouettes(at, sources),)

    def pinhole(at: Moment) -> tuple[Any, ...]:
        return (handed_on(at, tracer.pinhole(at)),)

    return {"trace": trace, "silhouettes": silhouettes, "pinhole": pinhole}


def _pixel_runs(plan: Plan, pixels: Pixels, buffers: Mapping[str, cl.Buffer]) -> dict[Kind, Run]:
    """Functions that run the passes on pixels of the reference pose, by kind of pass."""
    handed_on = _handed_on(plan)
    if isinstance(pixels, StaticMap):
        static, missing = pixels, int(pixels.missing.sum())
        counts = {"missing_pixels": missing, "unfilled_pixels": missing}
        return {"static image": lambda at: (handed_on(at, static.image(at, buffers)), counts)}
    if pixels is None:
        return {}
    warp = pixels

    def reproject(at: Moment) -> tuple[Any, ...]:
        warp.nearest(at.sample, at.events)
        warp.gather(at.events)
        return (warp.filler.planes,)

    def fill(at: Moment, moved: FillPlanes) -> tuple[Any, ...]:
        warped = warp.fill(at.sample, at.events)
        warp.note_radii(buffers["statistics"], at.events)
        light = handed_on(at, Image(moved.value, (moved.coc, moved.valid)))
        return light, warped.counters, *((warp.missing(warped),) if "missing" in plan.truth else ())

    return {"reproject": reproject, "fill": fill, "count missing": fill}


def blur_runs(
    session: Session,
    spec: BlurSpec,
    tallest: Grid,
    grid: Struct,
    buffers: Mapping[str, cl.Buffer],
    real: Real,
    maps: Maps,
    behind_rims: BehindRims | None = None,
) -> tuple[dict[Kind, Run], tuple[Clusters, ...]]:
    """Functions that run the passes from an image or sources to the blurred plane, and the passes that find depth
    layers.

    Parameters
    ----------
    session : Session
    spec : BlurSpec
    tallest : Grid
        Grid of the frame, or the tallest of its strips.
    grid : numpy.void
        grid_t of the first strip.
    buffers : mapping
        With "source", if images become sources.
    real : {"double", "float"}
    maps : Maps
        Blur radii of images.
    behind_rims : callable, optional
        For images with aperture rims.
    """
    if spec.method == "none":
        return {}, ()
    target = blur_target(session, spec, tallest.channels, real, maps)
    blur = make_blur(target, spec, tallest, grid)

    def sources(at: Any, image: Image) -> tuple[Any, ...]:
        behind: dict[str, Any] = {}
        if spec.occluders and behind_rims is not None:
            behind = behind_rims(at) | {"depth": buffers["depth"]}
        rims = (behind["lens"], behind["depth"]) if behind else ()
        prepare_sources(target, at.grid, blur.struct, image.maps, buffers["source"], at.events, rims)
        return (Sources(buffers["source"], image.value, **behind),)

    def spread(at: Area, lit: Sources | None, begun: Plane | None = None) -> tuple[Any, ...]:
        if begun is None:
            blur.begin(at.grid)
        if lit is not None:
            blur.add(lit, at.events)
        return (blur.plane(at.events),)

    if not spec.layered:
        return {"sources": sources, "blur": spread}, ()
    from clsco.passes.clusters import Clusters, layered_program
    from clsco.passes.layered import DepthLayers

    kernels = layered_program(session, spec, tallest.channels, real)
    clusters, composite = Clusters(kernels, spec, tallest), DepthLayers(blur, kernels, tallest, behind_rims)

    def cluster(at: Area, image: Image) -> tuple[Any, ...]:
        if at.bounds is None:
            clusters.find(at, image)
            return (clusters.divide(at, image, clusters.found()),)
        return (clusters.divide(at, image, at.bounds[at.color or 0]),)

    def layers(at: Area, found: Layers) -> tuple[Any, ...]:
        blur.begin(at.grid)
        composite.add(at, found)
        return blur.plane(at.events), found.count

    return {"cluster": cluster, "depth layers": layers}, (clusters,)


def _joining_runs(joined: JoinedColors) -> dict[Kind, Run]:
    def join(at: Moment, plane: Plane, *_: Plane) -> tuple[Any, ...]:
        return (joined.put(plane, at.color or 0, at.events),)

    return {"join colors": join}


def _vignetting_runs(vignetting: Vignetting) -> dict[Kind, Run]:
    def darken(at: Moment, plane: Plane) -> tuple[Any, ...]:
        return (vignetting.darken(plane, at.sample.camera, at.strip.top, at.events),)

    return {"vignetting": darken}


def _exposure_runs(frame: FrameSum) -> dict[Kind, Run]:
    def accumulate(at: Moment, plane: Plane) -> tuple[Any, ...]:
        if at.first:
            frame.clear()
        return (frame.add(plane, at.weights, at.events, at.strip.top - at.of.top, at.of.rows),)

    return {"accumulate": accumulate}


def _sensor_runs(sensor: FrameSensor) -> dict[Kind, Run]:
    def expose(at: Moment, light: Plane) -> tuple[Any, ...]:
        return (None if at.camera is None else sensor.expose(at.of, light, at.camera, at.events),)

    return {"sensor": expose}
