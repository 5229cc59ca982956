"""From a scene to the passes that it needs, with their sizes and cost; pure Python, without OpenCL.

The engine runs `Plan.passes`, `clsco plan` prints them, and the memory of a frame is that of their buffers. A pass that
a scene has no use for is neither compiled nor run nor stored: `clsco.plan.left_out` says which and why.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.constants import TAP_LANES
from clsco.errors import SceneError
from clsco.frame.frame import MAPPING_NAMES, MOTION_NAMES, STEREO_NAMES, TRUTH_NAMES
from clsco.frame.strips import Grid, Strip, cut
from clsco.inputs.pupils import scene_point_spread
from clsco.optics.depth_layers import margin_of_layers
from clsco.optics.exposure import sequence_times
from clsco.optics.lens import LARGEST_BLUR, blur_radius
from clsco.optics.motion import Eye, Pose, poses_at
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_reach
from clsco.optics.psf_tables import check_tables, psf_features
from clsco.optics.texture_mapping import needs_detail
from clsco.optics.visibility import OcclusionGroup, extent, is_hollow, occlusion_groups
from clsco.plan.buffers import (
    STATISTICS,
    TRUTH_BUFFERS,
    DeviceFacts,
    Sizes,
    ThisMachine,
    blur_buffers,
    fill_sizes,
    layered_buffers,
    map_buffers,
    silhouette_buffers,
    source_buffers,
    texture_buffers,
    trace_buffers,
    truth_buffers,
    warp_buffers,
)
from clsco.plan.features import shape_features
from clsco.plan.methods import (
    MANY_RADII,
    Blur,
    BlurSpec,
    can_convolve,
    check_shape,
    choose_blur,
    occluder_room,
)
from clsco.plan.passes import HOW, Kind, Parameters, Pass
from clsco.plan.predict import (
    Maps,
    _blur_range,
    _constant_blur,
    _fills_view,
    _samples,
    displaced,
    guard_band,
    is_forward,
    is_static_map,
)
from clsco.scene.model import Scene

Array = NDArray[np.float64]
Occlusion = Literal["visibility", "layered", "none"]
FILTERS = {"nearest": 0, "bilinear": 1, "bicubic": 2}
SILHOUETTE_SLOTS = 12  # pixels near silhouettes per row and column of the frame, to begin with


@dataclass(frozen=True)
class Plan:
    """Plan of rendering a scene: passes, buffers and costs.

    Attributes
    ----------
    scene : Scene
        With its resolution.
    psf : PointSpread
        Point spread of its lens.
    device : DeviceFacts
        Device that it is to run on.
    eye : {"left", "right"}
        View of a stereo pair.
    channels, rows, columns : int
        Size of the frame: channels 1 or 3, and one more for `alpha`; px, px.
    samples : int
        Time samples per frame.
    guard_px : int
        Width of the apron around the frame whose surface lights it.
    smallest_blur, largest_blur : float
        Predicted range of |R| in px over the whole sequence, with a margin.
    blur : Blur
        Method that spreads radiance.
    silhouettes : int
        Sub-pixel sources per axis, 0 for none.
    tilt : bool
        Weights depend on the gradient of R.
    forward, static_map, moves : bool
        Pixels of the reference pose are moved; they are taken as they are; anything moves.
    occlusion : Occlusion
        As it is done.
    groups : tuple of OcclusionGroup
        Occlusion groups, which are spread one after the other.
    truth : tuple of str
        Outputs besides color and alpha.
    color : bool
        True where the image is made, and not ground truth alone.
    alpha : bool
        The last channel is coverage.
    taps : float
        Predicted weights per frame.
    strip_rows : int
        Rows of the frame that are worked on at a time, 0 for all.
    least_slots : int
        Pixels near silhouettes that there must be room for.
    """

    scene: Scene
    psf: PointSpread
    device: DeviceFacts
    eye: Eye
    channels: int
    rows: int
    columns: int
    samples: int
    guard_px: int
    smallest_blur: float
    largest_blur: float
    blur: Blur
    silhouettes: int
    tilt: bool
    forward: bool
    static_map: bool
    moves: bool
    occlusion: Occlusion
    groups: tuple[OcclusionGroup, ...]
    truth: tuple[str, ...]
    taps: float
    strip_rows: int = 0
    least_slots: int = 0
    alpha: bool = False
    color: bool = True

    @property
    def colors(self) -> int:
        """Channels of color."""
        return self.channels - self.alpha

    @property
    def width(self) -> int:
        """Columns of frame and apron."""
        return self.columns + 2 * self.guard_px

    @property
    def height(self) -> int:
        """Rows of frame and apron."""
        return self.rows + 2 * self.guard_px

    @property
    def reach_px(self) -> int:
        """Distance in px at which a source may matter to a pixel: the reach of the PSF, and 2 px to find silhouettes
        in."""
        each = (table_reach(self.psf, self.largest_blur, subpixel) for subpixel in (False, True))
        return max(each) + 2

    @cached_property
    def strips(self) -> tuple[Strip, ...]:
        """The strips that the frame is made in, one after the other; the first one is the tallest."""
        layered = self.occlusion == "layered"
        reach, step = margin_of_layers(self.psf, self.largest_blur) if layered else (self.reach_px, 1)
        return cut(self.rows, self.strip_rows or self.rows, self.guard_px, reach, step)

    @property
    def grid(self) -> Grid:
        """Sizes of the frame, or of the tallest of its strips."""
        return Grid.of(self.strips, self.columns, self.guard_px, self.channels)

    @cached_property
    def spec(self) -> BlurSpec:
        """Specification of the blur."""
        room = occluder_room(max(group.occluders.bit_count() for group in self.groups))
        return BlurSpec(
            self.psf, self.blur, self.smallest_blur, self.largest_blur, self.silhouettes, self.tilt,
            occluders=room, limited=room > 0 and self._shapes["NAPPE"] > 0, border=self.scene.psf.border,
            layered=self.occlusion == "layered",
        )  # fmt: skip

    @property
    def slots(self) -> int:
        """Pixels near silhouettes that there is room for."""
        predicted = SILHOUETTE_SLOTS * (self.width + self.grid.height) if self.silhouettes else 0
        return max(predicted, self.least_slots)

    @property
    def eye_moved(self) -> bool:
        """True if the frame is seen from elsewhere than the textures."""
        return displaced(self.scene, self.eye)

    @property
    def device_truth(self) -> tuple[str, ...]:
        """Outputs of ground truth that rays give; a forward warp makes its own focused image."""
        if not self.scene.is_analytic:
            return ()
        wanted = {*self.truth, *(["object_id"] if self.truth and self.background is not None else [])}
        return tuple(n for n in TRUTH_BUFFERS if n in wanted and not (n == "sharp" and self.forward))

    @property
    def mapped(self) -> int:
        """Textures that lie on surfaces: 0 none, 1 with coordinates that are linear in a point, 2 with any."""
        kinds = {item.mapped for item in self.scene.objects} - {None}
        return int(bool(kinds)) + int(not kinds <= {"card", "plane", "triplanar"})

    @property
    def background(self) -> int | None:
        """Number of the object that is the background, None where there is none."""
        return next((k for k, item in enumerate(self.scene.objects) if item.is_background), None)

    @cached_property
    def passes(self) -> tuple[Pass, ...]:
        """Passes to run: each time sample runs them in this order, and "ground truth" runs once for a frame."""
        return _passes(self)

    def features(self) -> dict[str, int]:
        """Structure that the kernels that cast rays are compiled for."""
        scene, spec = self.scene, self.spec
        moved = (self.moves or self.eye_moved) and not self.forward
        psf = psf_features(self.psf)
        return self._shapes | {
            "CHANNELS": self.channels,
            "OCCLUDED": int(spec.occluders > 0),
            "LIMITED": int(spec.limited),
            "GATHER": int(spec.occluders > 0 and self.blur == "gather"),
            "MOVED": int(moved),
            "FILTER": FILTERS[scene.motion.texture_filter] if moved or self.mapped else 0,
            "TEXTURED": self.mapped,
            "LIT": 0 if scene.light is None else self.channels - self.alpha,
            "TILT": int(self.tilt),
            "SUBPIXELS": self.silhouettes,
            "SAMPLED": psf["SAMPLED"],
            "GENERAL": psf["GENERAL"],
            "EDGES": psf["EDGES"],
        }

    @cached_property
    def _shapes(self) -> dict[str, int]:
        return shape_features(self.scene.objects)


def widened(plan: Plan, smallest: float, largest: float) -> Plan:
    """The plan for a wider range of |R| in px than it predicted. Raises SceneError beyond LARGEST_BLUR."""
    if largest > LARGEST_BLUR:
        raise SceneError(f"camera: the blur radius must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
    guard = max(plan.guard_px, guard_band(plan.psf, plan.scene.psf.border, largest))
    return replace(plan, smallest_blur=smallest, largest_blur=largest, guard_px=guard)


def _hides_nothing(scene: Scene) -> bool:
    """True if the lens sees all that the pinhole sees: a single surface, without an inside and not of a map."""
    return len(scene.objects) == 1 and scene.is_analytic and not is_hollow(scene.objects[0])


def _occlusion(
    scene: Scene, psf: PointSpread, rays: bool, sharp: bool, poses_at_times: list[tuple[Pose, ...]], w: Array
) -> tuple[Occlusion, tuple[OcclusionGroup, ...]]:
    """Choose how occlusion is computed, and the occlusion groups that follow."""
    together = (OcclusionGroup((1 << len(scene.objects)) - 1, 0),)
    wanted = scene.psf.occlusion
    if wanted == "none" or sharp or _hides_nothing(scene):
        return "none", together
    if wanted == "layered" or not rays:
        return "layered", together
    extents = [extent(item, [poses[k] for poses in poses_at_times], w[k]) for k, item in enumerate(scene.objects)]
    found = occlusion_groups(scene.objects, extents, scene.camera, psf)
    return ("visibility", found) if any(group.occluders for group in found) else ("none", together)


def make_plan(
    scene: Scene,
    channels: int,
    truth: tuple[str, ...] = TRUTH_NAMES,
    method: str = "auto",
    eye: Eye = "left",
    maps: Maps | None = None,
    device: DeviceFacts | None = None,
    color: bool = True,
    psf: PointSpread | None = None,
) -> Plan:
    """The passes that a scene needs.

    Parameters
    ----------
    scene : Scene
        With a resolution (`clsco.inputs.textures.load_scene_textures`).
    channels : int
        Channels of its textures.
    truth : tuple of str
        Names of the outputs that are wanted besides color.
    method : str
        "auto", or one of "gather", "scatter", "tiles", "convolve" where it can do the scene.
    eye : {"left", "right"}
        View of a stereo pair.
    maps : sequence of ndarray of float64 (rows, columns) or None, optional
        Inverse depth in 1/mm of every object that is a depth map, 0 where nothing is; None for others
        (`clsco.inputs.depth_maps.load_scene_depths`).
    device : DeviceFacts, optional
        Device that it is to run on; by default this machine's processor.
    color : bool
        False for ground truth alone.

    Returns
    -------
    Plan

    Raises
    ------
    SceneError
        The blur radius passes LARGEST_BLUR, or the method cannot do the scene.
    """
    others = ("alpha", *(STEREO_NAMES if scene.stereo is None else ()), *(() if scene.moves else MOTION_NAMES))
    others += () if scene.has_mapped_textures else MAPPING_NAMES
    alpha, truth = "alpha" in truth, tuple(name for name in truth if name not in others)
    if scene.camera.resolution is None:
        raise SceneError("camera.resolution: must be known before a scene is planned; got None")
    columns, rows = scene.camera.resolution
    device = device or ThisMachine()
    gpu, asked, psf = device.kind == "gpu", scene.psf, psf or scene_point_spread(scene)
    forward, static = is_forward(scene, eye), is_static_map(scene)
    maps = maps or (None,) * len(scene.objects)
    samples = _samples(scene, maps)
    poses_at_times = [poses_at(scene, time, eye) for time in sequence_times(scene)]
    smallest, largest, each, guard = _blur_range(scene, psf, eye, poses_at_times, maps)
    w = each.max(axis=0)
    layered = asked.occlusion == "layered" and not _hides_nothing(scene)
    rays = not (forward or static)
    silhouettes = asked.silhouette_samples if asked.silhouette_samples > 1 and rays and not layered else 0
    if silhouettes and _fills_view(scene, w) and not needs_detail(scene, psf, largest):
        silhouettes = 0
    constant = _constant_blur(scene) and not silhouettes and can_convolve(psf, asked.border)
    sharp = psf.is_sharp(largest) and not silhouettes
    check_shape(psf, method)
    occlusion, found = _occlusion(scene, psf, rays, sharp, poses_at_times, each)
    occluded = any(group.occluders for group in found)
    blur = choose_blur(method, sharp, constant, gpu, occluded)
    seen = np.abs(blur_radius(scene.camera, w[w > 0]))
    if blur == "convolve":
        guard += 2 * TAP_LANES
    tilt = asked.tilt and not _constant_blur(scene) and blur not in ("convolve", "none")
    if blur in MANY_RADII:
        check_tables(psf, smallest, largest, silhouettes)
    area = (rows + 2 * guard) * (columns + 2 * guard)
    lit = np.pi * (seen * psf.extent + 0.7) ** 2
    times = samples * (2 if "subframes" in truth else 1)
    taps = float((w > 0).mean() * area * times * (lit.mean() if lit.size else 0.0)) if blur != "none" and color else 0.0
    return Plan(
        scene, psf, device, eye, channels + alpha, rows, columns, samples, guard, smallest, largest, blur, silhouettes,
        tilt, forward, static, scene.moves, occlusion, found, truth, taps, alpha=alpha, color=color,
    )  # fmt: skip


def _passes(plan: Plan) -> tuple[Pass, ...]:
    """See `Plan.passes`."""
    found = list(_moving_passes(plan)) if plan.color or "missing" in plan.truth else []
    found += _image_passes(plan) if plan.color else ()
    if plan.truth:
        found.append(_truth_pass(plan))
    return tuple(found)


def _moving_passes(plan: Plan) -> Iterator[Pass]:
    """The passes of a forward warp, where there is one; its filling counts the missing pixels of each time sample."""
    scene, grid = plan.scene, plan.grid
    if not plan.forward:
        return
    moved = f"every pixel of the {_shapes(scene)} to its nearest pixel, with a depth test"
    sizes = _named("warp", warp_buffers(scene, grid, plan.device))
    yield Pass("reproject", (("pixels", moved), *_of_frame(plan)), sizes | _of_scene(plan))
    kind: Kind = "fill" if scene.fill.method != "none" else "count missing"
    rule = f"{scene.fill.method}, domain {scene.fill.domain}" if kind == "fill" else "pixels are counted"
    yield Pass(kind, (("missing", rule),), _named("fill", fill_sizes(scene, grid)))


def _image_passes(plan: Plan) -> Iterator[Pass]:
    """The passes of the image of a time sample, after those of a forward warp."""
    spec, grid = plan.spec, plan.grid
    layered, rays = plan.occlusion == "layered", not (plan.forward or plan.static_map)
    if plan.static_map:
        yield Pass("static image", (("pixels", "as the depth map and its image have them"),), map_buffers(grid))
    if rays and layered:
        yield Pass("pinhole", _of_rays(plan), map_buffers(grid) | _of_scene(plan))
    if rays and not layered:
        for group in plan.groups:
            yield from _group_passes(plan, group)
    elif layered:
        sizes = _named("depth layer", layered_buffers(spec, grid, plan.device))
        yield Pass("depth layers", _of_blur(plan), sizes | _blur_sizes(plan))
    else:
        if plan.blur in MANY_RADII:
            slope = (("gradient", "from differences of R"),) if plan.tilt else ()
            source = source_buffers(spec, grid)
            yield Pass("sources", (("R", "from the inverse depth of every pixel"), *slope), source)
        yield _blur_pass(plan)


def _truth_pass(plan: Plan) -> Pass:
    sizes: Sizes = {}
    if plan.scene.is_analytic:
        sizes = _named("truth", truth_buffers(plan.device_truth, plan.grid)) | _of_scene(plan)
    if plan.forward:
        sizes |= _named("warp", warp_buffers(plan.scene, plan.grid, plan.device))
        sizes |= _named("fill", fill_sizes(plan.scene, plan.grid))
    return Pass("ground truth", (("outputs", ", ".join(plan.truth)),), sizes)


def _group_passes(plan: Plan, group: OcclusionGroup) -> Iterator[Pass]:
    """The passes of one occlusion group."""
    spec, grid = plan.spec, plan.grid
    yield Pass("trace", _of_rays(plan), trace_buffers(spec, grid) | _of_scene(plan), group)
    if plan.silhouettes:
        what = f"{plan.silhouettes} x {plan.silhouettes} per pixel within 2 px of a silhouette"
        what += ", and where textures are finer than the blur" if plan.mapped else ""
        sizes = silhouette_buffers(spec, grid, plan.slots, plan.mapped > 0)
        yield Pass("silhouettes", (("sub-pixel sources", what),), sizes, group)
    yield _blur_pass(plan, group)


def _blur_pass(plan: Plan, group: OcclusionGroup | None = None) -> Pass:
    return Pass("accumulate" if plan.blur == "none" else "blur", _of_blur(plan), _blur_sizes(plan), group)


def _named(owner: str, sizes: Sizes) -> Sizes:
    return {f"{owner} {name}": size for name, size in sizes.items()}


def _of_scene(plan: Plan) -> Sizes:
    return texture_buffers(plan.scene, plan.channels, plan.alpha) | {"statistics": 4 * STATISTICS}


def _blur_sizes(plan: Plan) -> Sizes:
    return _named("blur", blur_buffers(plan.spec, plan.grid, plan.device))


def _shapes(scene: Scene) -> str:
    return ", ".join(dict.fromkeys(item.shape for item in scene.objects))


def _of_rays(plan: Plan) -> Parameters:
    scene = plan.scene
    sampled = plan.features()["MOVED"] or plan.mapped
    moved: Parameters = (("texture sampling", scene.motion.texture_filter),) if sampled else ()
    moved += (("surface textures", "means over the pixel's footprint, from mipmaps"),) if plan.mapped else ()
    return (("rays", f"against the {_shapes(scene)}, one per pixel"), *moved, *_of_frame(plan))


def _of_frame(plan: Plan) -> Parameters:
    apron = (("guard band", "surface outside the frame lights it"),) if plan.scene.psf.border == "lose" else ()
    color = (("color", f"{plan.colors} channels"),) if plan.colors > 1 else ()
    alpha = (("alpha", "a channel of what surfaces cover"),) if plan.alpha else ()
    return (*apron, *color, *alpha)


def _of_blur(plan: Plan) -> Parameters:
    groups = len(plan.groups)
    if plan.blur == "none":
        return (("radiance", "every pixel keeps its own"),)
    how = HOW[plan.blur]
    if plan.device.kind == "gpu" and plan.occlusion == "visibility" and plan.blur == "scatter":
        how += ", as tiles do not test what is in the way"
    found = [("PSF", f"{plan.psf.name}, R up to {plan.largest_blur:.3g} px"), ("method", f"{plan.blur}: {how}")]
    if plan.tilt:
        found.append(("tilt", "weights by the gradient of the blur radius"))
    if plan.scene.psf.border == "renormalize":
        found.append(("renormalize", "light over the border is given back"))
    if plan.occlusion == "visibility":
        plural = "s" if groups > 1 else ""
        found.append(("occlusion", f"{groups} occlusion group{plural}, visibility tests where something is in the way"))
    if plan.occlusion == "layered":
        found.append(("occlusion", "depth layers of what the pinhole sees, front to back"))
    return tuple(found)
