"""From a scene to the passes that it needs, with their sizes and cost; pure Python, without OpenCL.

A pass that a scene has no use for is neither compiled nor run nor stored: `Plan.left_out` says which and why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.coarsening import METHODS, candidates, check_border, checked_tolerance
from clsco.errors import SceneError
from clsco.frame import STEREO_NAMES, TRUTH_NAMES
from clsco.motion import Eye, Pose, poses_at, rest_center, sample_times
from clsco.occlusion import Layer, extent, is_hollow, layers
from clsco.optics import LARGEST_BLUR, blur_radius, ray_step
from clsco.psf import LANES, MINIMUM_BLUR, check_tables, psf_extent, psf_features, reach, table_reach
from clsco.scene import Object, Plane, Psf, Scene
from clsco.slabs import margin_of_slabs
from clsco.strips import Strip, cut
from clsco.surfaces import canonical, place, predict_inverse_depth

Array = NDArray[np.float64]
Blur = Literal["gather", "scatter", "tiles", "convolve", "none"]
Maps = Sequence[Array | None]
Occlusion = Literal["visibility", "layered", "none"]

MANY_RADII: tuple[Blur, ...] = ("gather", "scatter", "tiles")  # methods for sources of any radius each
GRID = 65  # rays per axis that predict the range of the blur radius
PREDICTED_MOMENTS = 33  # of the whole sequence at most
PIXELS_PER_SAMPLE = 1.0  # of the largest motion, with samples = "auto": 2 lose 5 to 9 dB, fewer gain little
MOST_SAMPLES = 4095
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
    (`clsco.coarsening.METHODS`), in this order until the error is within the tolerance.
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
            "OCCLUDED": max(layer.blockers.bit_count() for layer in self.layers),
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


def guard_band(psf: Psf, largest: float) -> int:
    """Width in px of the band around the frame whose surface can light it, and 2 px to see silhouettes in.

    A multiple of LANES, so that vectors of sources begin in the same columns of the frame with every lens: lenses that
    share a band have the bits that each has by itself.
    """
    if psf.border == "renormalize":
        return 0
    needed = max(reach(psf, largest), reach(psf, largest, True)) + 2
    return -(-needed // LANES) * LANES


def widened(plan: Plan, largest: float) -> Plan:
    """The plan for a larger |R| in px than it predicted. Raises SceneError beyond LARGEST_BLUR."""
    if largest > LARGEST_BLUR:
        raise SceneError(f"camera: the blur radius must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
    return replace(plan, largest_blur=largest, guard_px=max(plan.guard_px, guard_band(plan.scene.psf, largest)))


def _grid(scene: Scene, guard: int) -> tuple[Array, Array]:
    """Slopes (GRID, GRID) of rays over frame and guard band, the outermost pixels included."""
    assert scene.camera.resolution is not None
    columns, rows = scene.camera.resolution
    x = np.linspace(-0.5 * (columns - 1) - guard, 0.5 * (columns - 1) + guard, GRID)
    y = np.linspace(-0.5 * (rows - 1) - guard, 0.5 * (rows - 1) + guard, GRID)
    across, up = np.meshgrid(x * ray_step(scene.camera), y * ray_step(scene.camera))
    return across, up


def displaced(scene: Scene, eye: Eye) -> bool:
    """Whether one of a stereo pair sees the scene from elsewhere than the textures."""
    return scene.stereo is not None and (eye == "right" or scene.stereo.toe_in > 0.0)


def _moments(scene: Scene, eye: Eye) -> list[tuple[Pose, ...]]:
    """Poses of the objects over the whole sequence, few enough to be looked at before every rendering."""
    sequence = scene.sequence
    if not scene.moves:
        return [poses_at(scene, 0.0, eye)]
    assert sequence.shutter is not None
    end = (sequence.frames - 1) * sequence.interval + sequence.shutter
    count = min(4 * sequence.frames + 1, PREDICTED_MOMENTS)
    return [poses_at(scene, t, eye) for t in np.linspace(0.0, end, count).tolist()]


def _inverse_depths(scene: Scene, moments: list[tuple[Pose, ...]], maps: Maps, guard: int) -> Array:
    """Predicted inverse depths (objects, moments, GRID, GRID) in 1/mm, 0 where nothing is hit."""
    grid, found = _grid(scene, guard), []
    for k, (item, depth) in enumerate(zip(scene.objects, maps, strict=True)):
        if depth is None:
            found.append([predict_inverse_depth(item, place(item, poses[k]), *grid) for poses in moments])
        else:
            found.append([_moved_map(scene, item, depth, poses[k]) for poses in moments])
    return np.array(found)


def _moved_map(scene: Scene, item: Object, depth: Array, pose: Pose) -> Array:
    """Inverse depths (GRID, GRID) of some points of a depth map after a move, its nearest and farthest among them."""
    rows, columns = (np.linspace(0, n - 1, GRID).round().astype(np.intp) for n in depth.shape)
    i, j = (n.copy() for n in np.meshgrid(rows, columns, indexing="ij"))
    seen = np.where(depth > 0, depth, np.inf)
    for place_at, extreme in enumerate((seen.argmin(), depth.argmax())):
        i[0, place_at], j[0, place_at] = np.unravel_index(extreme, depth.shape)
    w, step, center = depth[i, j], ray_step(scene.camera), rest_center(item)
    middle = (np.array(depth.shape) - 1) / 2
    rays = np.stack([(j - middle[1]) * step, (middle[0] - i) * step, np.ones(i.shape)], axis=-1)
    point = rays / np.where(w > 0, w, 1.0)[..., None]
    z = (center + pose.shift + (point - center) @ pose.rotation.T)[..., 2]
    return np.where((w > 0) & (z > 0), 1.0 / np.where(z > 0, z, 1.0), 0.0)


def image_displacement(scene: Scene, maps: Maps | None = None) -> float:
    """Largest way in px that a visible point of a surface goes over the image while the shutter is open.

    maps: as for `make_plan`.
    """
    frames = sorted({0, scene.sequence.frames // 2, scene.sequence.frames - 1})
    known = enumerate(maps or (None,) * len(scene.objects))
    return max(_frame_displacement(scene, k, depth, frame) for k, depth in known for frame in frames)


def _frame_displacement(scene: Scene, number: int, depth: Array | None, frame: int) -> float:
    assert scene.sequence.shutter is not None
    item, opens = scene.objects[number], frame * scene.sequence.interval
    x, y = _grid(scene, 0)
    opening, center = poses_at(scene, opens)[number], rest_center(item)[:, None]
    if depth is None:
        w = predict_inverse_depth(item, place(item, opening), x, y)
    else:
        w = np.full(x.shape, float(np.quantile(depth[depth > 0], 0.99)))  # as if all of it were near
    hit = w > 0
    if not hit.any():
        return 0.0
    rays = np.stack([x[hit], y[hit], np.ones(int(hit.sum()))])
    body = opening.rotation.T @ (rays / w[hit] - center - opening.shift[:, None])
    steps = []
    for time in np.linspace(opens, opens + scene.sequence.shutter, 9).tolist():
        pose = poses_at(scene, time)[number]
        point = center + pose.shift[:, None] + pose.rotation @ body
        ahead = np.maximum(point[2], 1e-3)
        steps.append(point[:2] / ahead / ray_step(scene.camera))
    ways = np.linalg.norm(np.diff(np.stack(steps), axis=0), axis=1).sum(axis=0)
    return float(ways.max())


def _samples(scene: Scene, maps: Maps) -> int:
    if not scene.moves:
        return 1
    if scene.sequence.samples != "auto":
        return scene.sequence.samples
    wanted = ceil(image_displacement(scene, maps) / PIXELS_PER_SAMPLE)
    return min(wanted | 1, MOST_SAMPLES)  # odd, so that the middle of the shutter is one of them


def _fills_view(scene: Scene, w: Array) -> bool:
    """Whether no silhouette is in sight: the surface is hit everywhere, and cannot have a hole between rays."""
    item = scene.objects[0]
    simple = len(scene.objects) == 1 and item.bounds is None and item.shape != "quadric"
    return simple and bool((w > 0).all())


def _constant_blur(scene: Scene) -> bool:
    """Whether every pixel has the same radius at any moment: a plane that stays parallel to the detector."""
    item, camera = scene.objects[0], scene.camera.motion
    turns = any((*item.motion.angular_velocity[:2], *camera.angular_velocity[:2]))
    turned = scene.stereo is not None and scene.stereo.toe_in > 0.0
    flat = isinstance(item, Plane) and item.slope_x == item.slope_y == 0.0 and not turns and not turned
    return len(scene.objects) == 1 and flat


def is_sharp(psf: Psf, largest: float) -> bool:
    """Whether the PSF of the |blur radius| `largest` px keeps all light in its pixel."""
    if psf.edge == "sampled":
        return largest < MINIMUM_BLUR or float(psf_extent(psf, largest)) < 1.0
    return largest == 0.0 or (psf.edge == "area" and float(psf_extent(psf, largest)) <= 0.5)


def _blur_range(scene: Scene, moments: list[tuple[Pose, ...]], maps: Maps) -> tuple[float, float, Array, int]:
    """Smallest and largest |R| with a margin, the inverse depths of the objects, and the guard band that follows."""
    psf, guard = scene.psf, 0
    for _ in range(2):  # the second time with the guard band that the first asked for
        w = _inverse_depths(scene, moments, maps, guard)
        radii = np.abs(blur_radius(scene.camera, w[w > 0]))
        largest, smallest = (float(radii.max()), float(radii.min())) if radii.size else (0.0, 0.0)
        if largest > LARGEST_BLUR:
            nearest = 1.0 / float(w.max())
            raise SceneError(
                f"camera: the blur radius must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px (the surface comes "
                f"as near as {nearest:.4g} mm; is it in mm, and the focus on it?)"
            )
        if not _constant_blur(scene):  # rays between those of the grid
            smallest, largest = max(0.0, 0.9 * smallest - 1.0), 1.1 * largest + 1.0
        guard = guard_band(psf, largest)
    return smallest, largest, w, guard


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
    return ("visibility", found) if any(layer.blockers for layer in found) else ("none", together)


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

    scene: with a resolution (`clsco.textures.load_scene_textures`); channels: of its textures; truth: names of the
    outputs that are wanted besides color; method: "auto", or one of "gather", "scatter", "tiles", "convolve" where it
    can do the scene, or an approximation (`clsco.coarsening.METHODS`); eye: of a stereo pair; maps: inverse depth
    (rows, columns) in 1/mm of every object that is a depth map, 0 where nothing is, None for others
    (`clsco.depthmaps.load_scene_depths`); tolerance: RMS error of white up to which an approximation is taken, None for
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
    constant = _constant_blur(scene) and not silhouettes and psf.border == "lose"
    sharp = is_sharp(psf, largest) and not silhouettes
    check_border(psf, method)
    occlusion, found = _occlusion(scene, rays, sharp, moments, each)
    occluded = any(layer.blockers for layer in found)
    blur = _choose_blur(method, sharp, constant, gpu, occluded)
    approximations: tuple[str, ...] = (method,) if method in METHODS and blur != "none" else ()
    seen = np.abs(blur_radius(scene.camera, w[w > 0]))
    if tolerance is not None and checked_tolerance(tolerance, method) and blur != "none":
        approximations = candidates(psf, seen)
        blur = many_radii(gpu, occluded, approximate=True) if approximations else blur
    if blur == "convolve":
        guard += 2 * LANES
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


def many_radii(gpu: bool, occluded: bool = False, approximate: bool = False) -> Blur:
    """The method for many radii that suits a device.

    gpu: the device is a GPU; occluded: something may stand in the way of a source, which `tiles` does not test;
    approximate: on coarser grids, which take no frame in fixed point.
    """
    if gpu and not occluded:
        return "tiles"
    return "scatter" if gpu and not approximate else "gather"


def _choose_blur(method: str, sharp: bool, constant: bool, gpu: bool, occluded: bool) -> Blur:
    if method in METHODS:
        return "none" if sharp else many_radii(gpu, occluded, approximate=True)
    if method == "convolve" and not constant:
        raise SceneError("method: convolve needs one blur radius for the whole frame; got a scene with many")
    if method == "tiles" and occluded:
        raise SceneError("method: tiles needs sources with nothing in their way; got objects that hide each other")
    for known in MANY_RADII:
        if method == known:
            return known
    if method not in ("auto", "convolve"):
        known_names = ", ".join(("auto", *MANY_RADII, "convolve", *METHODS))
        raise SceneError(f"method: must be one of {known_names}; got {method}")
    if sharp:
        return "none"
    return "convolve" if constant else many_radii(gpu, occluded)


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
        blur != "none", "blur", f"{psf.model}, {psf.edge}, R up to {largest:.3g} px, {blur}: {how.get(blur, '')}",
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
