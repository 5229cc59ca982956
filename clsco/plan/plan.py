"""Plans: the passes that a scene needs, with their buffers and costs; independent of OpenCL.

The engine runs `Plan.passes`, `clsco plan` prints them, and their buffers determine the memory that a frame needs.
Passes that a scene does not need are neither compiled nor run; `Choices.left_out` lists them with reasons.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clsco.constants import BAND, TAP_LANES
from clsco.frame.outputs import SENSOR_NAMES
from clsco.frame.strips import Grid, Strip, make_strip
from clsco.optics.exposure import frame_exposure, subframes_of
from clsco.optics.motion import Eye
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_reach
from clsco.optics.psf_tables import check_tables, psf_features
from clsco.optics.quadrics import Extent
from clsco.optics.resolved_view import Maps, ResolvedView, is_static_map, resolve, shifts_view
from clsco.optics.sensor import SensorModel, sensor_model
from clsco.optics.visibility import OcclusionGroup
from clsco.plan.buffers import (
    STATISTICS,
    Sizes,
    blur_buffers,
    fill_sizes,
    map_buffers,
    ray_truth,
    silhouette_buffers,
    sum_buffers,
    texture_buffers,
    trace_buffers,
    truth_buffers,
    warp_buffers,
)
from clsco.plan.decisions import Choices, choose
from clsco.plan.descriptions import describe_blur, describe_frame, describe_pixels, describe_rays, shapes_of
from clsco.plan.device import DeviceFacts, ThisMachine
from clsco.plan.features import curvature_of, shape_features
from clsco.plan.image import blur_passes, color_passes, light_of, prefix_names, sensor_pass, strips_of, vignetting_pass
from clsco.plan.methods import MANY_RADII, Blur, BlurSpec, Occlusion, lens_cells, occluder_room
from clsco.plan.passes import Kind, Pass
from clsco.plan.request import Request
from clsco.scene.model import Scene

FILTERS = {"nearest": 0, "bilinear": 1, "bicubic": 2}
SILHOUETTE_SLOTS = 12  # initial slots for pixels near silhouettes, per row and per column of the frame


@dataclass(frozen=True)
class Plan:
    """Plan for rendering one view of a scene that has a resolution: passes, buffers and costs."""

    scene: Scene
    psf: PointSpread
    device: DeviceFacts
    eye: Eye
    channels: int  # 1 or 3, and one more with `alpha`
    rows: int
    columns: int
    guard_px: int  # width of the guard band around the frame, of which the outer `spare_px` have no sources
    smallest_blur: float  # predicted range of |R| in px over the whole sequence, with a margin
    largest_blur: float
    choices: Choices
    groups: tuple[OcclusionGroup, ...]  # blurred one after the other
    taps: float  # predicted number of weights that the blur of a frame computes
    spreads: tuple[PointSpread, ...] = ()  # PSFs of red, green and blue, if each color is blurred separately
    only: int | None = None  # color that this plan is for, 0 to 2; None for all
    alpha: bool = False  # True if the last channel is coverage
    strip_rows: int = 0  # rows of the tallest strip, 0 for all rows of the frame
    extents: tuple[Extent, ...] = ()  # extents of objects within which `groups` are valid; empty if always valid
    spare_px: int = 0  # width by which the guard band is wider than needed, to share rays with other plans
    small: bool = False  # True if an object may be so narrow that it needs its own slots of sub-pixel sources

    @cached_property
    def color_plans(self) -> tuple[Plan, ...]:
        """Plans for red, green and blue if the lens blurs colors differently, else empty."""
        if not self.color:
            return ()
        channels = 1 + self.alpha
        return tuple(
            replace(self, channels=channels, psf=psf, spreads=(), only=color) for color, psf in enumerate(self.spreads)
        )

    @property
    def color(self) -> bool:
        """True if the image is made, not only ground truth."""
        return self.choices.image.value

    @cached_property
    def moves(self) -> bool:
        return not self.choices.motion.left_out

    @property
    def samples(self) -> int:
        """Number of time samples while a line is exposed; without a rolling shutter, while the frame is exposed."""
        return max(self.choices.motion.value, 1)

    @property
    def subframes(self) -> int:
        """Number of time samples of a frame."""
        return subframes_of(self.scene, self.samples) if self.moves else 1

    @cached_property
    def repeats(self) -> float:
        """Number of time samples of a frame; one that is rendered only in some rows counts as their fraction."""
        if not self.narrows:
            return float(self.subframes)
        (frame_strip,) = strips_of(self.spec, self.rows, 0, self.guard_px, self.reach_px)
        parts = [self.part(frame_strip, weights) for weights in frame_exposure(self.scene, 0, self.samples).weights]
        return sum(part.height for part in parts if part is not None) / self.height

    @property
    def forward(self) -> bool:
        return self.choices.reproject.value  # a forward warp moves pixels of the reference pose

    @property
    def static_map(self) -> bool:
        """True for a single depth map whose pixels are not moved."""
        return is_static_map(self.scene)

    @property
    def silhouettes(self) -> int:
        return self.choices.silhouettes.value  # sub-pixel sources per axis, 0 for none

    @property
    def tilt(self) -> bool:
        return self.choices.tilt.value  # True if weights depend on the gradient of R

    @property
    def blur(self) -> Blur:
        return self.choices.blur.value

    @property
    def occlusion(self) -> Occlusion:
        return self.choices.occlusion.value

    @property
    def truth(self) -> tuple[str, ...]:
        return self.choices.ground_truth.value  # outputs besides color and alpha

    @property
    def colors(self) -> int:
        return self.channels - self.alpha  # without coverage

    @property
    def width(self) -> int:
        """Columns of frame and guard band."""
        return self.columns + 2 * self.guard_px

    @property
    def height(self) -> int:
        """Rows of frame and guard band."""
        return self.rows + 2 * self.guard_px

    @property
    def reach_px(self) -> int:
        """Distance in px within which a source may affect a pixel, including silhouette detection."""
        reaches = (table_reach(self.psf, self.largest_blur, subpixel) for subpixel in (False, True))
        return max(reaches) + 2

    @cached_property
    def strips(self) -> tuple[Strip, ...]:
        """The strips in which the frame is rendered, in order; the first one is the tallest."""
        return strips_of(self.spec, self.rows, self.strip_rows, self.guard_px, self.reach_px)

    @property
    def narrows(self) -> bool:
        """True if a time sample is rendered only in the rows where it has a weight. This is the case with a rolling
        shutter by rows, but not with depth layers or the output "subframes", which need all rows.
        """
        by_rows = self.scene.rolls and not self.scene.sequence.by_columns
        return by_rows and not self.spec.layered and "subframes" not in self.truth

    def part(self, strip: Strip, weights: NDArray[np.float64]) -> Strip | None:
        """Part of a strip in which a time sample is rendered, None if the sample has no weight in the strip. weights:
        weight of the time sample in each row of the frame, (rows,).
        """
        if not self.narrows:
            return strip
        lit = strip.top + np.flatnonzero(weights[strip.inside])
        if not lit.size:
            return None
        top = max(int(lit[0]) // BAND * BAND, strip.top)
        return make_strip(self.rows, top, int(lit[-1]) + 1, self.guard_px, self.reach_px)

    @cached_property
    def grid(self) -> Grid:
        """Sizes of the frame, or of the tallest of its strips."""
        return Grid.of(self.strips, self.columns, self.guard_px, self.channels)

    @cached_property
    def spec(self) -> BlurSpec:
        room = occluder_room(max(len(self.psf.rims), *(group.occluders.bit_count() for group in self.groups)))
        limited = room > 0 and shape_features(self.scene.objects)["NAPPE"] > 0
        layered, border = self.occlusion == "layered", self.scene.psf.border
        return BlurSpec(
            self.psf, self.blur, self.smallest_blur, self.largest_blur, self.silhouettes, self.tilt,
            occluders=room, limited=limited, border=border, layered=layered,
            cells=lens_cells(self.psf, self.blur, border, self.largest_blur) if layered else 1,
            curved=curvature_of(self.scene) if room or self.psf.stretched else 0,
            shared=room > 0 and self.mapped > 0 and self.silhouettes > 0 and self.psf.shares_lens,
            small=self.small,
        )  # fmt: skip

    @cached_property
    def sensor_model(self) -> SensorModel | None:
        """The sensor of the scene, if its image is made."""
        return sensor_model(self.scene, self.colors) if self.scene.sensor is not None and self.color else None

    @property
    def needs_light(self) -> bool:
        """True if the irradiance of a frame is read back from the device, not only the codes of a sensor."""
        return self.sensor_model is None or self.alpha or not {"electrons", "noise_sigma"}.isdisjoint(self.truth)

    @property
    def slots(self) -> int:
        """Initial number of slots for pixels near silhouettes, which have sub-pixel sources."""
        return SILHOUETTE_SLOTS * (self.width + self.grid.height) if self.silhouettes else 0

    @property
    def eye_moved(self) -> bool:
        """True if the viewpoint of this view is not the one from which textures are projected."""
        return shifts_view(self.scene, self.eye)

    @cached_property
    def averages(self) -> bool:
        """True if a frame is a weighted sum of time samples, False if it is a single one."""
        return not frame_exposure(self.scene, 0, self.samples).is_one_image

    @property
    def device_truth(self) -> tuple[str, ...]:
        """Outputs of ground truth that rays on the device compute; empty for scenes with depth maps."""
        return ray_truth(self.scene, self.truth, self.forward) if self.scene.is_analytic else ()

    @property
    def mapped(self) -> int:
        """Kind of textures on surfaces. 0 if there are none, 1 if the texture coordinates of all are linear in the
        surface point, 2 otherwise.
        """
        kinds = {item.mapped for item in self.scene.objects} - {None}
        return int(bool(kinds)) + int(not kinds <= {"card", "plane", "triplanar"})

    @property
    def background(self) -> int | None:
        """Number of the background object, None without one."""
        return next((k for k, item in enumerate(self.scene.objects) if item.is_background), None)

    @cached_property
    def scene_buffers(self) -> Sizes:
        """Buffers that all passes that trace share."""
        return texture_buffers(self.scene, self.channels, self.alpha) | {"statistics": 4 * STATISTICS}

    @cached_property
    def passes(self) -> tuple[Pass, ...]:
        """Passes that each time sample runs in this order; those in ONCE_A_FRAME run once per frame."""
        return _passes(self)

    @property
    def splits_still(self) -> bool:
        """True if sources that all time samples share are blurred once."""
        return self.moves and self.averages and self.choices.still_sources.value

    def features(self) -> dict[str, int]:
        """Compile-time features of the kernels that cast rays."""
        scene, spec = self.scene, self.spec
        aimed = self.only is not None and scene.shifts_colors
        moved = (scene.is_displaced or self.eye_moved or aimed) and not self.forward
        return shape_features(scene.objects) | {
            "CHANNELS": self.channels,
            "OCCLUDED": int(spec.occluders > 0),
            "LIMITED": int(spec.limited),
            "GATHER": int(spec.occluders > 0 and self.blur == "gather"),
            "MOVED": int(moved),
            "FILTER": FILTERS[scene.motion.texture_filter] if self.choices.texture_sampling.value else 0,
            "TEXTURED": self.mapped,
            "LIT": 0 if scene.light is None else self.channels - self.alpha,
            "DIVIDED": int(self.splits_still),
            "TILT": int(self.tilt),
            "SUBPIXELS": self.silhouettes,
            "SMALL": int(self.small),
            "CURVED": curvature_of(scene),
            "SHARED": int(spec.shared),
            **psf_features(self.psf),
        }


def make_plan(
    scene: Scene,
    psf: PointSpread,
    channels: int,
    request: Request | None = None,
    eye: Eye = "left",
    maps: Maps | None = None,
    device: DeviceFacts | None = None,
) -> Plan:
    """Plan the rendering of a scene with a resolution (`clsco.inputs.textures.load_scene_textures`).

    psf: the scene's (`clsco.inputs.pupils.scene_point_spread`); channels: color channels of its textures, 1 or 3;
    request: by default only color; maps: for each object that is a depth map, its inverse depth (rows, columns) in
    1/mm, 0 without a surface, None for other objects (`clsco.inputs.depth_maps.load_scene_depths`); device: by default
    this machine's processor. Raises SceneError if the scene has no resolution, the blur radius exceeds LARGEST_BLUR, or
    the method does not support the scene.
    """
    columns, rows = scene.camera.frame_size
    request, device = request or Request(), device or ThisMachine()
    view = resolve(scene, psf, channels, eye, maps or (None,) * len(scene.objects))
    choices, groups, extents = choose(view, request, channels, device)
    blur, alpha = choices.blur.value, "alpha" in request.truth
    guard = view.guard + (2 * TAP_LANES if blur == "convolve" else 0)
    if blur in MANY_RADII:
        occluded = any(group.occluders for group in groups)
        check_tables(view.psf, view.smallest, view.largest, choices.silhouettes.value, occluded)
    plan = Plan(
        scene, view.psf, device, eye, channels + alpha, rows, columns, guard, view.smallest, view.largest,
        choices, groups, taps=0.0, spreads=view.spreads, alpha=alpha, extents=extents,
        small=choices.silhouettes.value > 0 and view.has_small_images,
    )  # fmt: skip
    return replace(plan, taps=_predicted_taps(plan, view)) if blur != "none" and plan.color else plan


def _predicted_taps(plan: Plan, view: ResolvedView) -> float:
    """Value of `Plan.taps`, from the predicted radii."""
    if not view.radii.size:
        return 0.0
    lit = plan.psf.blended * np.pi * (view.radii * plan.psf.extent + plan.psf.pupil.margin + 0.7) ** 2
    return float(view.radii.size / view.nearest.size * plan.width * plan.height * plan.repeats * lit.mean())


def _passes(plan: Plan) -> tuple[Pass, ...]:
    passes: list[Pass] = []
    if plan.color_plans:
        passes += color_passes([(*_moving_passes(p), *_image_passes(p)) for p in plan.color_plans], plan.grid)
    else:
        passes += _moving_passes(plan) if plan.color or "missing" in plan.truth else ()
        passes += _image_passes(plan) if plan.color else ()
    if plan.color and plan.scene.darkens:
        passes.append(vignetting_pass(plan.scene, plan.rows, plan.columns))
    if plan.color and plan.averages:
        added = (("time samples", "blurred planes, added up with a weight for each row"),)
        passes.append(Pass("accumulate", added, prefix_names("frame", sum_buffers(plan.grid)), ("plane",), ("frame",)))
    if plan.sensor_model is not None:
        passes.append(sensor_pass(plan.sensor_model, plan.grid, "frame" if plan.averages else "plane"))
    if not set(plan.truth) <= {*SENSOR_NAMES}:
        passes.append(_truth_pass(plan))
    return tuple(passes)


def _moving_passes(plan: Plan) -> Iterator[Pass]:
    """The passes of a forward warp, if there is one: "reproject", and "fill" or "count missing"."""
    scene, grid, frame_parameters = plan.scene, plan.grid, describe_frame(plan.choices, plan.colors, plan.alpha)
    if not plan.forward:
        return
    moved = f"every pixel of the {shapes_of(scene)} to its nearest pixel, with a depth test"
    sizes = prefix_names("warp", warp_buffers(scene, grid, plan.device))
    yield Pass("reproject", (("pixels", moved), *frame_parameters), sizes | plan.scene_buffers, gives=("moved",))
    kind: Kind = "fill" if plan.choices.fill.value else "count missing"
    rule = f"{scene.fill.method}, domain {scene.fill.domain}" if kind == "fill" else "pixels are counted"
    gives = (light_of(plan.spec), "counts", *(("missing",) if "missing" in plan.truth else ()))
    yield Pass(kind, (("missing", rule),), prefix_names("fill", fill_sizes(scene, grid)), ("moved",), gives)


def _image_passes(plan: Plan) -> Iterator[Pass]:
    """The passes up to the blurred plane of a time sample; those of a forward warp run before."""
    spec, grid, light, choices = plan.spec, plan.grid, light_of(plan.spec), plan.choices
    context = plan.scene, choices, plan.colors, plan.alpha
    if plan.static_map:
        yield Pass("static image", describe_pixels(*context), map_buffers(grid), gives=(light, "counts"))
    elif not plan.forward and spec.layered:
        sizes = map_buffers(grid, plan.scene) | plan.scene_buffers
        yield Pass("pinhole", describe_rays(*context), sizes, gives=(light,))
    if plan.forward or plan.static_map or spec.layered:
        yield from blur_passes(spec, grid, plan.device, describe_blur(spec, choices, len(plan.groups)))
    else:
        for number, group in enumerate(plan.groups):
            yield from _group_passes(plan, group, number == 0)


def _truth_pass(plan: Plan) -> Pass:
    sizes: Sizes = {}
    if plan.scene.is_analytic:
        sizes = prefix_names("truth", truth_buffers(plan.device_truth, plan.grid)) | plan.scene_buffers
    if plan.forward:
        sizes |= prefix_names("warp", warp_buffers(plan.scene, plan.grid, plan.device))
        sizes |= prefix_names("fill", fill_sizes(plan.scene, plan.grid))
    outputs = ", ".join(name for name in plan.truth if name not in SENSOR_NAMES)
    return Pass("ground truth", (("outputs", outputs),), sizes)


def _group_passes(plan: Plan, group: OcclusionGroup, first: bool) -> Iterator[Pass]:
    """The passes of one occlusion group; first: True for the group that begins the plane, to which the others add."""
    spec, grid, rays = plan.spec, plan.grid, describe_rays(plan.scene, plan.choices, plan.colors, plan.alpha)
    light = ("plane",) if plan.blur == "none" else ("sources",)
    sizes = trace_buffers(spec, grid, plan.mapped > 0, plan.scene) | plan.scene_buffers
    yield Pass("trace", rays, sizes, gives=light, group=group)
    if plan.silhouettes:
        text = f"{plan.silhouettes} x {plan.silhouettes} per pixel within 2 px of a silhouette"
        text += ", and where textures are finer than the blur" if plan.mapped else ""
        sizes = silhouette_buffers(spec, grid, plan.slots, plan.mapped > 0)
        yield Pass("silhouettes", (("sub-pixel sources", text),), sizes, light, light, group)
    if plan.blur != "none":
        sizes = prefix_names("blur", blur_buffers(spec, grid, plan.device))
        inputs, blur = light if first else (*light, "plane"), describe_blur(spec, plan.choices, len(plan.groups))
        yield Pass("blur", blur, sizes, inputs, ("plane",), group)
