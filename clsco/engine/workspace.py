"""Workspace of a plan's passes on a device, and the table of the function that runs each of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import pyopencl as cl

from clsco.opencl.buffers import allocate
from clsco.optics.lens import blur_radius
from clsco.passes.accumulate import FrameSum
from clsco.passes.blur import BlurredPlane, Plane, Sources, Target, blur_target, padded_plane, prepare_sources
from clsco.passes.frame_blur import make_blur
from clsco.passes.layered import DepthLayers
from clsco.passes.pack import psf_struct
from clsco.passes.placed import PlacedScene, TimeSample
from clsco.passes.static_image import StaticMap
from clsco.passes.tables import tables_of
from clsco.passes.trace import Hits, Tracer, Work
from clsco.passes.warp import ForwardWarp
from clsco.plan.buffers import sum_buffers
from clsco.plan.passes import Kind, Pass
from clsco.plan.plan import Plan
from clsco.records import Struct

# Buffers that passes share; the others are owned by what works with them.
SHARED = (
    "statistics",
    "value",
    "coc",
    "valid",
    "source",
    "depth",
    "label",
    "pixels",
    "sub_label",
    "sub_source",
    "sub_value",
    "sub_depth",
    "share",
    "sharper",
)


@dataclass(frozen=True)
class Workspace:
    """Programs and buffers of a plan on a device.

    Attributes
    ----------
    plan : Plan
    scene : PlacedScene
    making : (Target, BlurredPlane), optional
        Makes the blurred image of a time sample, where one is wanted, and anything is blurred.
    buffers : mapping
        Buffers of `SHARED` that the plan has.
    tracer : Tracer
    layers : DepthLayers, optional
    frame : FrameSum, optional
        Sum of time samples, where a frame has several.
    pixels : ForwardWarp or StaticMap, optional
        Moves the pixels of the reference pose, or has them as they are.
    """

    plan: Plan
    scene: PlacedScene
    making: tuple[Target, BlurredPlane] | None
    buffers: Mapping[str, cl.Buffer]
    tracer: Tracer
    layers: DepthLayers | None
    frame: FrameSum | None
    pixels: ForwardWarp | StaticMap | None

    @property
    def target(self) -> Target:
        """Programs of the blur."""
        assert self.making is not None
        return self.making[0]

    @property
    def blur(self) -> BlurredPlane:
        """Blurred plane of a time sample."""
        assert self.making is not None
        return self.making[1]

    def run(self, step: Pass, work: Work) -> None:
        """Enqueue a pass of a time sample."""
        work.group = step.group
        RUN[step.kind](self, work)

    def plane(self, work: Work) -> Plane:
        """Blurred plane of the time sample, after its passes."""
        if work.plane is None and self.making is None:
            work.plane = padded_plane(work.grid, _lit(work).value, self.plan.channels)
        elif work.plane is None:
            work.plane = self.blur.plane(work.events)
        return work.plane

    def radii(self, work: Work) -> None:
        """Only what `layers` needs to find depth layers: the radii of the image of a pinhole, or of a depth map."""
        if isinstance(self.pixels, StaticMap):
            _send_radii(self, self.pixels, work)
        else:
            self.tracer.pinhole(work)


def make_workspace(
    plan: Plan, scene: PlacedScene, pixels: ForwardWarp | StaticMap | None, hits: Hits | None, grid: Struct
) -> Workspace:  # fmt: skip
    """A workspace for a plan, whose first strip has this grid_t. Raises DeviceError, KernelError."""
    session, real = scene.session, scene.real
    sizes = {name: size for each in plan.passes for name, size in each.buffers.items()}
    buffers = allocate(session, {name: sizes[name] for name in SHARED if name in sizes})
    if not plan.color:
        return Workspace(plan, scene, None, buffers, Tracer(plan, scene, buffers, None, hits), None, None, pixels)
    spec = replace(plan.spec, brightest=scene.brightest)
    from_radii = plan.forward or plan.static_map or plan.occlusion == "layered"
    making, layers = None, None
    if plan.blur != "none":
        target = blur_target(session, spec, plan.channels, real, "wide" if from_radii else "none")
        making = target, make_blur(target, spec, plan.grid, grid)
        layers = DepthLayers(making[1], target, plan.grid) if plan.occlusion == "layered" else None
    tracer = Tracer(plan, scene, buffers, psf_struct(spec.psf, *tables_of(spec, session), real), hits)
    frame = FrameSum(session, sum_buffers(plan.grid)) if plan.averages else None
    return Workspace(plan, scene, making, buffers, tracer, layers, frame, pixels)


def _trace(space: Workspace, work: Work) -> None:
    space.tracer.trace(work)


def _silhouettes(space: Workspace, work: Work) -> None:
    space.tracer.silhouettes(work)


def _pinhole(space: Workspace, work: Work) -> None:
    space.tracer.pinhole(work)


def _static_image(space: Workspace, work: Work) -> None:
    static = space.pixels
    assert isinstance(static, StaticMap)
    missing = int(static.missing.sum())
    work.report |= {"missing_pixels": missing, "unfilled_pixels": missing}
    static.send(space.scene.session, work.strip, space.buffers["value"])
    _send_radii(space, static, work)


def _send_radii(space: Workspace, static: StaticMap, work: Work) -> None:
    value, coc, valid = (space.buffers[name] for name in ("value", "coc", "valid"))
    static.send_radii(space.scene.session, work.strip, coc, valid)
    work.planes = value, coc, valid


def _reproject(space: Workspace, work: Work) -> None:
    warp = space.pixels
    assert isinstance(warp, ForwardWarp)
    warp.nearest(work.sample, work.events)
    warp.gather(work.events)


def _fill(space: Workspace, work: Work) -> None:
    warp = space.pixels
    assert isinstance(warp, ForwardWarp)
    warped = warp.fill(work.sample, work.events)
    warp.note_radii(space.buffers["statistics"], work.events)
    work.report |= warped.counters
    if "missing" in space.plan.truth:
        work.missing = warp.missing(warped)
    work.planes = warped.value, warped.coc, warped.valid


def _sources(space: Workspace, work: Work) -> None:
    assert work.planes is not None
    value, coc, valid = work.planes
    source = space.buffers["source"]
    prepare_sources(space.target, work.grid, space.blur.struct, (coc, valid), source, work.events)
    work.sources = Sources(source, value)


def _depth_layers(space: Workspace, work: Work) -> None:
    assert space.layers is not None
    assert work.planes is not None
    work.report["depth_layers"] = space.layers.add(work.planes, work.events, work.depth_layers.get(work.sample.time))


def _lit(work: Work) -> Sources:
    """Sources of a time sample: those of an image whose pixels all have one radius, or none, are the image itself."""
    if work.sources is not None:
        return work.sources
    assert work.planes is not None
    return Sources(None, work.planes[0])


def _blur(space: Workspace, work: Work) -> None:
    sources = _lit(work)
    if space.plan.blur == "convolve":
        sources = replace(sources, radius=_central_radius(space, work.sample))
    space.blur.add(sources, work.events)


def _accumulate(space: Workspace, work: Work) -> None:
    assert space.frame is not None
    assert work.weights is not None
    work.image = space.frame.add(space.plane(work), work.weights, work.events)


def _central_radius(space: Workspace, sample: TimeSample) -> float:
    """|R| on the axis in px, which is that of every pixel where the blur is a convolution."""
    surface = sample.placed[0]
    assert surface is not None
    inverse_depth = -2.0 * float(surface.canonical.l @ surface.turn[:, 2]) / surface.constant
    return abs(float(blur_radius(space.plan.scene.camera, inverse_depth)))


# What runs for a pass of each time sample; ground truth is made once for a frame (`clsco.passes.truth`).
RUN: dict[Kind, Callable[[Workspace, Work], None]] = {
    "static image": _static_image,
    "trace": _trace,
    "silhouettes": _silhouettes,
    "pinhole": _pinhole,
    "reproject": _reproject,
    "fill": _fill,
    "count missing": _fill,
    "sources": _sources,
    "depth layers": _depth_layers,
    "blur": _blur,
    "accumulate": _accumulate,
}
