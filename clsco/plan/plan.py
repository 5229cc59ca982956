"""From a scene to the passes that it needs, with their sizes and cost; pure Python, without OpenCL.

A pass that a scene has no use for is neither compiled nor run nor stored: `Plan.left_out` says which and why.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.frame.frame import STEREO_NAMES, TRUTH_NAMES
from clsco.frame.strips import Grid, Strip, cut
from clsco.optics.lens import LARGEST_BLUR, blur_radius
from clsco.optics.motion import Eye, Pose, sample_times
from clsco.optics.psf import psf_extent, shape_of
from clsco.optics.psf_tables import TAP_LANES, check_tables, psf_features, table_reach
from clsco.optics.quadrics import canonical
from clsco.optics.slabs import margin_of_slabs
from clsco.optics.visibility import Layer, extent, is_hollow, layers
from clsco.plan.approximation import METHODS, candidates, check_border, checked_tolerance
from clsco.plan.methods import MANY_RADII, Blur, BlurSpec, _choose_blur, is_sharp, many_radii
from clsco.plan.predict import Maps, _blur_range, _constant_blur, _fills_view, _moments, _samples, displaced, guard_band
from clsco.scene.model import Scene

Array = NDArray[np.float64]
Occlusion = Literal["visibility", "layered", "none"]
FILTERS = {"nearest": 0, "bilinear": 1, "bicubic": 2}
SILHOUETTE_SLOTS = 12  # pixels near silhouettes per row and column of the frame, to begin with


@dataclass(frozen=True)
class Plan:
    """What rendering a scene takes.

    scene: with its resolution; channels: 1 or 3; rows, columns px; samples: intermediate frames per frame;
    guard_px: width of the band around the frame whose surface lights it; smallest_blur, largest_blur: predicted
    range of |R| in px over the whole sequence, with a margin; blur: how light is spread; silhouettes: sub-pixel
    sources per axis, 0 none; tilt, forward, still_map, moves: whether these passes are taken; eye: of a stereo pair;
    occlusion: as it is done; layers: what is spread one after the other; truth: outputs besides color; passes,
    left_out: (name, what or why); taps: predicted weights per frame; strip_rows: of the frame that are worked on at a
    time, 0 for all; tolerance: that was asked for; approximations: what is taken instead of the exact blur
    (`clsco.plan.approximation.METHODS`), in this order until the error is within the tolerance.
    """

    scene: Scene
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
    still_map: bool
    moves: bool
    eye: Eye
    occlusion: Occlusion
    layers: tuple[Layer, ...]
    truth: tuple[str, ...]
    passes: tuple[tuple[str, str], ...]
    left_out: tuple[tuple[str, str], ...]
    taps: float
    strip_rows: int = 0
    tolerance: float | None = None
    approximations: tuple[str, ...] = ()

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
        """How far away in px a source may matter to a pixel: the reach of the PSF, and 2 px to see silhouettes in."""
        each = (table_reach(self.scene.psf, self.largest_blur, subpixel) for subpixel in (False, True))
        return max(each) + 2

    @property
    def strips(self) -> tuple[Strip, ...]:
        """The strips that the frame is made in, one after the other; the first one is the tallest."""
        layered = self.occlusion == "layered"
        reach, step = margin_of_slabs(self.scene.psf, self.largest_blur) if layered else (self.reach_px, 1)
        return cut(self.rows, self.strip_rows or self.rows, self.guard_px, reach, step)

    @property
    def tallest(self) -> int:
        """Rows of the largest grid of a strip."""
        return max(strip.height for strip in self.strips)

    @property
    def grid(self) -> Grid:
        """Sizes of the frame, or of the tallest of its strips."""
        return Grid.of(self.strips, self.columns, self.guard_px, self.channels)

    @property
    def spec(self) -> BlurSpec:
        """What the blur is made for; with approximations, for the first one."""
        occluded = any(layer.occluders for layer in self.layers)
        least = METHODS[self.approximations[0]] if self.approximations else None
        ends = self.smallest_blur, self.largest_blur
        return BlurSpec(self.scene.psf, self.blur, *ends, self.silhouettes, self.tilt, occluded, least=least)

    @property
    def slots(self) -> int:
        """Pixels near silhouettes that there is room for at first; the device asks for more where needed."""
        return SILHOUETTE_SLOTS * (self.width + self.tallest) if self.silhouettes else 0

    @property
    def eye_moved(self) -> bool:
        """Whether the frame is seen from elsewhere than the textures."""
        return displaced(self.scene, self.eye)

    def features(self) -> dict[str, int]:
        """Structure that the kernels are compiled for."""
        scene = self.scene
        analytic = [item for item in scene.objects if item.shape != "depth_map"]
        shapes = [canonical(item) for item in analytic]
        quadratic = any(shape.q.any() for shape in shapes)
        return {
            "CHANNELS": self.channels,
            "SEVERAL": int(len(scene.objects) > 1),
            "QUADRATIC": int(quadratic),
            "LINEAR": int(quadratic and any(shape.l.any() for shape in shapes)),
            "NAPPE": int(any(shape.nappe != 0 for shape in shapes)),
            "BOUNDED": int(any(item.bounds is not None for item in analytic)),
            "OCCLUDED": max(layer.occluders.bit_count() for layer in self.layers),
            "MOVED": int((self.moves or self.eye_moved) and not self.forward),
            "FILTER": FILTERS[scene.motion.texture_filter],
            "TILT": int(self.tilt),
            "SUBPIXELS": self.silhouettes,
        } | psf_features(scene.psf)


def is_still_map(scene: Scene) -> bool:
    """Whether every pixel shows what it does in a depth map and its image: nothing else is there, and nothing moves."""
    alone = len(scene.objects) == 1 and scene.objects[0].shape == "depth_map"
    return alone and not scene.moves and scene.stereo is None


def is_forward(scene: Scene, eye: Eye) -> bool:
    """Whether the pixels at rest are moved: with the forward warp what moves, and depth maps unless all is still."""
    if any(item.shape == "depth_map" for item in scene.objects):
        return not is_still_map(scene)
    return scene.motion.warp == "forward" and (scene.moves or displaced(scene, eye))


def exposure(plan: Plan, frame: int) -> tuple[Array, Array]:
    """Times in s and weights of the intermediate frames of a frame; one at rest where nothing moves."""
    if not plan.moves:
        return np.zeros(1), np.ones(1)
    return sample_times(plan.scene.sequence, frame, plan.samples)


def widened(plan: Plan, largest: float) -> Plan:
    """The plan for a larger |R| in px than it predicted. Raises SceneError beyond LARGEST_BLUR."""
    if largest > LARGEST_BLUR:
        raise SceneError(f"camera: the blur radius must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
    return replace(plan, largest_blur=largest, guard_px=max(plan.guard_px, guard_band(plan.scene.psf, largest)))


def _hides_nothing(scene: Scene) -> bool:
    """Whether the lens sees all that the pinhole sees: a single surface, without an inside and not of a map."""
    return len(scene.objects) == 1 and scene.objects[0].shape != "depth_map" and not is_hollow(scene.objects[0])


def _occlusion(
    scene: Scene, rays: bool, sharp: bool, moments: list[tuple[Pose, ...]], w: Array
) -> tuple[Occlusion, tuple[Layer, ...]]:
    """How what hides what is dealt with, and the layers of objects that follow."""
    together = (Layer((1 << len(scene.objects)) - 1, 0),)
    wanted = scene.psf.occlusion
    if wanted == "none" or sharp or _hides_nothing(scene):
        return "none", together
    if wanted == "layered" or not rays:
        return "layered", together
    extents = [extent(item, [poses[k] for poses in moments], w[k]) for k, item in enumerate(scene.objects)]
    found = layers(scene.objects, extents, scene.camera, scene.psf)
    return ("visibility", found) if any(layer.occluders for layer in found) else ("none", together)


def make_plan(
    scene: Scene,
    channels: int,
    truth: tuple[str, ...] = TRUTH_NAMES,
    method: str = "auto",
    eye: Eye = "left",
    maps: Maps | None = None,
    tolerance: float | None = None,
    gpu: bool = False,
) -> Plan:
    """The passes that a scene needs.

    scene: with a resolution (`textures.load_scene_textures`); channels: of its textures; truth: names of the
    outputs that are wanted besides color; method: "auto", or one of "gather", "scatter", "tiles", "convolve" where it
    can do the scene, or an approximation (`approximation.METHODS`); eye: of a stereo pair; maps: inverse depth
    (rows, columns) in 1/mm of every object that is a depth map, 0 where nothing is, None for others
    (`depth_maps.load_scene_depths`); tolerance: RMS error of white up to which an approximation is taken, None for
    none; gpu: it is to run on a GPU, see `many_radii`. Raises SceneError where the blur radius passes LARGEST_BLUR or
    the method cannot do it.
    """
    if scene.stereo is None:
        truth = tuple(name for name in truth if name not in STEREO_NAMES)
    if scene.camera.resolution is None:
        raise SceneError("camera.resolution: must be known before a scene is planned; got None")
    columns, rows = scene.camera.resolution
    psf, moves = scene.psf, scene.moves
    forward, still = is_forward(scene, eye), is_still_map(scene)
    maps = maps or (None,) * len(scene.objects)
    samples = _samples(scene, maps)
    moments = _moments(scene, eye)
    smallest, largest, each, guard = _blur_range(scene, moments, maps)
    w = each.max(axis=0)
    slabs = psf.occlusion == "layered" and not _hides_nothing(scene)
    rays = not (forward or still)
    silhouettes = psf.silhouette_samples if psf.silhouette_samples > 1 and rays and not slabs else 0
    if silhouettes and _fills_view(scene, w):
        silhouettes = 0
    constant = _constant_blur(scene) and not silhouettes and psf.border == "lose" and shape_of(psf).kind != "general"
    sharp = is_sharp(psf, largest) and not silhouettes
    check_border(psf, method)
    occlusion, found = _occlusion(scene, rays, sharp, moments, each)
    occluded = any(layer.occluders for layer in found)
    blur = _choose_blur(method, sharp, constant, gpu, occluded)
    approximations: tuple[str, ...] = (method,) if method in METHODS and blur != "none" else ()
    seen = np.abs(blur_radius(scene.camera, w[w > 0]))
    if tolerance is not None and checked_tolerance(tolerance, method) and blur != "none":
        approximations = candidates(psf, seen)
        blur = many_radii(gpu, occluded, approximate=True) if approximations else blur
    if blur == "convolve":
        guard += 2 * TAP_LANES
    tilt = psf.tilt and not _constant_blur(scene) and blur not in ("convolve", "none")
    moved = forward, still
    passes, left_out = _passes(
        scene, eye, moved, samples, largest, blur, silhouettes, tilt, truth, channels, occlusion, len(found), gpu
    )
    if blur in MANY_RADII:
        check_tables(psf, smallest, largest, silhouettes)
    area = (rows + 2 * guard) * (columns + 2 * guard)
    lit = np.pi * (psf_extent(psf, seen) + 0.7) ** 2
    taps = float((w > 0).mean() * area * samples * (lit.mean() if lit.size else 0.0)) if blur != "none" else 0.0
    return Plan(
        scene, channels, rows, columns, samples, guard, smallest, largest, blur, silhouettes, tilt, forward,
        still, moves, eye, occlusion, found, truth, passes, left_out, taps, 0, tolerance, approximations,
    )  # fmt: skip


def _passes(
    scene: Scene, eye: Eye, pixels: tuple[bool, bool], samples: int, largest: float, blur: Blur, silhouettes: int,
    tilt: bool, truth: tuple[str, ...], channels: int, occlusion: Occlusion, layers: int, gpu: bool,
) -> tuple[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...]]:  # fmt: skip
    """What is done, and what is left out with the reason; pixels: whether they are moved, or taken as they are."""
    forward, still = pixels
    psf, moves = scene.psf, scene.moves
    shapes = ", ".join(dict.fromkeys(item.shape for item in scene.objects))
    done: list[tuple[str, str]] = []
    out: list[tuple[str, str]] = []

    def either(wanted: bool, name: str, what: str, why_not: str) -> None:
        (done if wanted else out).append((name, what if wanted else why_not))

    plural = "s" if samples > 1 else ""
    either(moves, "motion", f"{samples} intermediate frame{plural} per exposure", "nothing moves: one sample, at rest")
    why = "a depth map at rest: its own pixels" if still else "replaced by the forward warp"
    either(not (forward or still), "trace", f"rays against the {shapes}, one per pixel", why)
    either(
        (moves or displaced(scene, eye)) and not forward, "texture sampling", scene.motion.texture_filter,
        "the forward warp moves whole pixels" if forward else "nothing moves: every pixel shows its own texel",
    )  # fmt: skip
    either(forward, "reproject", "every pixel at rest to its nearest pixel, with a depth test", "no forward warp")
    fills = forward and scene.fill.method != "none"
    either(
        fills, "fill", f"{scene.fill.method}, domain {scene.fill.domain}",
        "fill.method is none" if forward else "only a forward warp leaves pixels missing",
    )  # fmt: skip
    why = "silhouette_samples = 1" if psf.silhouette_samples == 1 else "no silhouette in sight"
    why = "a depth map has whole pixels" if still else "the forward warp moves whole pixels" if forward else why
    either(bool(silhouettes), "silhouettes", f"{silhouettes} x {silhouettes} sub-pixel sources within 2 px", why)
    why = "tilt = false" if not psf.tilt else "one radius for all pixels, or none"
    either(tilt, "tilt", "weights by the gradient of the blur radius", why)
    how = {"gather": "many radii", "scatter": "atomic, fixed point", "convolve": "one PSF for the whole frame"}
    how["tiles"] = "many radii, a work-item per pixel"
    if gpu and occlusion == "visibility":
        how["scatter"] += ", as tiles do not test what is in the way"
    either(
        blur != "none", "blur", f"{shape_of(psf).name}, R up to {largest:.3g} px, {blur}: {how.get(blur, '')}",
        f"in focus: R up to {largest:.3g} px stays within its pixel",
    )  # fmt: skip
    either(psf.border == "renormalize", "renormalize", "light over the border is given back", 'border = "lose"')
    either(psf.border == "lose", "guard band", "surface outside the frame lights it", "light stays inside the frame")
    either(channels > 1, "color", f"{channels} channels", "gray texture: one channel")
    how_hidden = {
        "visibility": f"{layers} layer{'s' if layers > 1 else ''}, taps tested where something is in the way",
        "layered": "slabs of what the pinhole sees, front to back",
        "none": "",
    }
    why = "one object" if len(scene.objects) == 1 else "no object hides another within its blur"
    why = 'occlusion = "none"' if psf.occlusion == "none" else "everything is in focus" if blur == "none" else why
    either(occlusion != "none", "occlusion", how_hidden[occlusion], why)
    either(bool(truth), "ground truth", ", ".join(truth), "nobody asked for it")
    missing = [name for name in TRUTH_NAMES if name not in truth]
    if truth and missing:
        out.append(("other outputs", f"nobody asked for {', '.join(missing)}"))
    return tuple(done), tuple(out)
