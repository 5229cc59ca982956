"""A view of a scene, resolved once for its plan by a coarse grid of rays: poses, hits, range of R (float64, pure)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from clsco.cache import Cache
from clsco.constants import NARROW_IMAGE, TAP_LANES
from clsco.errors import SceneError
from clsco.optics.distortion import DistortedCamera, distortion_of
from clsco.optics.exposure import middle_time, sequence_times, shutter_span
from clsco.optics.lens import LARGEST_BLUR, ray_step
from clsco.optics.lens import Lens as LensOptics
from clsco.optics.lens_path import camera_at, colored, lens_at, lenses_at, reference_camera, widest_camera
from clsco.optics.motion import Eye, Pose, poses_at, rest_center, static_rotation
from clsco.optics.point_spread import PointSpread, spreads_of_colors
from clsco.optics.pupils.circle import Circle
from clsco.optics.quadrics import Extent, PlacedSurface, cutting_bounds, outline_lines, place, predict_inverse_depth
from clsco.optics.rays import ray_slopes, slopes_at
from clsco.optics.texture_mapping import needs_detail
from clsco.optics.visibility import OcclusionGroup, extent, is_hollow, occlusion_groups
from clsco.scene.model import Camera, Disc, Lens, Object, ObjectMotion, Plane, Rectangle, Scene

Array = NDArray[np.float64]
Maps = Sequence[Array | None]
"""For each object that is a depth map, its inverse depth (rows, columns) in 1/mm, 0 without a surface; else None."""
Slopes = tuple[Array, Array]
Sample = tuple[Camera, tuple[Pose, ...]]
"""The camera and all objects at a time."""
UNEVEN = 0.25  # fraction of the range of sampled poses by which an object may leave this range
LEAST_DISTANCE = 0.1  # least distance of a curved image from the lens, in sensor distances
GRID = 65  # rays per axis that predict the range of the blur radius
PLACES = 33  # positions along each axis of the frame at which ellipses are examined
ROUND = 0.01  # fraction of R: a disc replaces an ellipse if their edges are at most this far apart
BEYOND = 1.1  # safety factor for positions between the examined ones and in the guard band
# Keys of the camera that change the blur but not the rays.
LENS_KEYS = ("f_number", "aperture_diameter", "focus_distance", "sensor_distance")
_DEPTHS = Cache(32 << 20)  # limit in bytes


def guard_band(psf: PointSpread, border: str, largest: float) -> int:
    """Width in px of the band around the frame whose surfaces can light the frame, plus 2 px to detect silhouettes.

    0 with border = "renormalize". largest: largest |R|, px. The width is rounded up to a multiple of TAP_LANES, so that
    vectors of sources begin in the same columns of the frame for every lens: lenses that share a band then give the
    same bits as each one alone.
    """
    if border == "renormalize":
        return 0
    needed = max(psf.reach(largest), psf.reach(largest, True)) + 2
    return -(-needed // TAP_LANES) * TAP_LANES


def check_keyframes(scene: Scene) -> None:
    """Raise SceneError if keyframes with outside = "error" do not cover all exposures."""
    keyed: list[tuple[str, ObjectMotion | Lens]] = [("camera.motion", scene.camera.motion)]
    keyed += [(f"group[{k}].motion", group.motion) for k, group in enumerate(scene.groups)]
    keyed += [(f"object[{k}].motion", item.motion) for k, item in enumerate(scene.objects)]
    keyed += [("lens", scene.lens)] if scene.lens is not None else []
    opens, closes = shutter_span(scene.sequence, 0)[0], shutter_span(scene.sequence, scene.sequence.frames - 1)[1]
    faults = []
    for name, motion in keyed:
        keys = motion.keyframe if motion.outside == "error" else None
        if keys is not None and not keys[0].time <= opens < closes <= keys[-1].time:
            rule = f"keyframes must cover all exposures, {opens:g} to {closes:g} s"
            faults.append(f"{name}.outside: {rule}; got {keys[0].time:g} to {keys[-1].time:g} s")
    if faults:
        raise SceneError(faults)


@lru_cache(maxsize=8)
def _grid(camera: Camera, guard: int) -> Slopes:
    """Slopes (GRID, GRID) of rays over frame and guard band, up to the outermost pixels."""
    columns, rows = camera.frame_size
    x = np.linspace(-0.5 * (columns - 1) - guard, 0.5 * (columns - 1) + guard, GRID)
    y = np.linspace(-0.5 * (rows - 1) - guard, 0.5 * (rows - 1) + guard, GRID)
    slopes = slopes_at(camera, *np.meshgrid(x, y))
    for slope in slopes:
        slope.flags.writeable = False
    return slopes


def _slopes(cameras: Sequence[Camera], guard: int) -> list[Slopes]:
    """Slopes (GRID, GRID) of the rays of each camera."""
    cameras_by_step = {ray_step(camera): camera for camera in cameras}  # cameras with the same step have the same rays
    grids = {step: _grid(camera, guard) for step, camera in cameras_by_step.items()}
    return [grids[ray_step(camera)] for camera in cameras]


def shifts_view(scene: Scene, eye: Eye) -> bool:
    """True if the viewpoint of a view of a stereo pair is not the one from which textures are projected."""
    return scene.stereo is not None and (eye == "right" or scene.stereo.toe_in > 0.0)


def is_static_map(scene: Scene) -> bool:
    """True if the scene is a single static depth map, so that each pixel shows its own pixel of the map."""
    alone = len(scene.objects) == 1 and not scene.is_analytic and scene.stereo is None
    return alone and not scene.moves and not scene.shifts_colors


def is_forward(scene: Scene, eye: Eye) -> bool:
    """True if a forward warp moves pixels of the reference pose. This is the case for scenes with depth maps unless
    they are static and, with motion.warp = "forward", for scenes that move or have a shifted view.
    """
    if not scene.is_analytic:
        return not is_static_map(scene)
    return scene.motion.warp == "forward" and (scene.is_displaced or shifts_view(scene, eye))


def hides_nothing(scene: Scene) -> bool:
    """True if the whole lens sees the same points as the pinhole. This is the case for a single surface that is not a
    depth map and has no visible inside.
    """
    return len(scene.objects) == 1 and scene.is_analytic and not is_hollow(scene.objects[0])


def elliptic_spread(scene: Scene, psf: PointSpread, by_rays: bool) -> PointSpread:
    """The PSF with `stretched`, the margin of its ellipses, if distortion makes its discs ellipses and the method
    supports them; by_rays: True if sources are traced by rays.
    """
    off = ellipticity_of(reference_camera(scene))
    plain = type(psf.pupil) is Circle and psf.edge == "integrated" and not psf.rims
    return replace(psf, stretched=BEYOND * off) if plain and by_rays and off > ROUND else psf


@lru_cache(maxsize=16)
def ellipticity_of(camera: Camera) -> float:
    """Largest distance in the frame between the edges of an ellipse and of a disc of the same area, as a fraction of R.
    0 without distortion.
    """
    if not isinstance(camera, DistortedCamera):
        return 0.0
    columns, rows = camera.frame_size
    x, y = ray_slopes(camera, np.linspace(0.0, rows - 1.0, PLACES)[:, None], np.linspace(0.0, columns - 1.0, PLACES))
    return float(camera.distortion.ellipticity(x, y).max())


def _inverse_depths(scene: Scene, samples: Sequence[Sample], maps: Maps, guard: int) -> Array:
    """Predicted inverse depths (objects, times, GRID, GRID) in 1/mm, 0 for rays that miss."""
    depths = np.empty((len(scene.objects), len(samples), GRID, GRID))
    rays = _slopes([camera for camera, _ in samples], guard)
    for k, (item, depth) in enumerate(zip(scene.objects, maps, strict=True)):
        for time, (_, poses) in enumerate(samples):
            if depth is None:
                surface = place(item, poses[k])
                depths[k, time] = predict_inverse_depth(item, surface, *rays[time])
                if not depths[k, time].any():
                    depths[k, time] = _between_rays(surface, *rays[time])
            else:
                depths[k, time] = _moved_map(scene, item, depth, poses[k])
    return depths


def _between_rays(surface: PlacedSurface, x: Array, y: Array) -> Array:
    """Inverse depths (GRID, GRID) of a surface that all rays miss, at the rays next to the surface; 0 at other rays."""
    inverse, (right, up, depth, radius) = np.zeros(x.shape), surface.ball.tolist()
    aside = np.maximum(*(np.abs(slope - place / depth) for slope, place in ((x, right), (y, up)))) if depth > 0 else x
    spacing = max(x[0, 1] - x[0, 0], abs(y[1, 0] - y[0, 0]))
    if depth > radius:
        inverse[aside <= spacing + radius / depth] = 1.0 / depth
    elif surface.width < 0.0 and surface.constant != 0.0:  # 0: the surface passes through the middle of the lens
        off, _ = outline_lines(surface, x, y)
        gradient = (surface.canonical.q * surface.offset + surface.canonical.l) @ surface.turn
        w = -(gradient[0] * x + gradient[1] * y + gradient[2]) / surface.constant
        inverse = np.where((off <= spacing) & (w > 0.0), w, 0.0)
    return inverse


def without_lens(scene: Scene) -> Scene:
    """The scene without the keys of its lens and sensor that do not affect rays."""
    camera = scene.camera.model_copy(update=dict.fromkeys(LENS_KEYS))
    return scene.model_copy(update={"camera": camera, "sensor": None})


def _moved_map(scene: Scene, item: Object, depth: Array, pose: Pose) -> Array:
    """Inverse depths (GRID, GRID) of points of a depth map in a pose. The points include the nearest and the farthest
    one of the map.
    """
    rows, columns = (np.linspace(0, n - 1, GRID).round().astype(np.intp) for n in depth.shape)
    i, j = (n.copy() for n in np.meshgrid(rows, columns, indexing="ij"))
    depths = np.where(depth > 0, depth, np.inf)
    for column, extreme in enumerate((depths.argmin(), depth.argmax())):
        i[0, column], j[0, column] = np.unravel_index(extreme, depth.shape)
    w, center = depth[i, j], rest_center(item)
    middle = (np.array(depth.shape) - 1) / 2
    rays = np.stack([*slopes_at(reference_camera(scene), j - middle[1], middle[0] - i), np.ones(i.shape)], axis=-1)
    point = rays / np.where(w > 0, w, 1.0)[..., None]
    z = (center + pose.shift + (point - center) @ pose.rotation.T)[..., 2]
    return np.where((w > 0) & (z > 0), 1.0 / np.where(z > 0, z, 1.0), 0.0)


def middle_of(scene: Scene) -> float:
    """Time of the middle of the sequence, s; 0 for static scenes."""
    return middle_time(scene.sequence, scene.sequence.frames // 2) if scene.moves else 0.0


def cast_grid(scene: Scene, maps: Maps, time: float | None = None) -> tuple[Array, Slopes]:
    """Predicted inverse depths (objects, GRID, GRID) in 1/mm, 0 for rays that miss, and slopes of the rays.

    time: s, by default the middle of the sequence.
    """
    time = middle_of(scene) if time is None else time
    camera = camera_at(scene, time)
    return _inverse_depths(scene, [(camera, poses_at(scene, time))], maps, 0)[:, 0], _grid(camera, 0)


def has_one_radius(scene: Scene) -> bool:
    """True if all pixels have the same radius at any time. The only object must be a background, or flat and always
    parallel to the detector.
    """
    item, camera = scene.objects[0], scene.camera
    if len(scene.objects) > 1 or scene.blurs_unevenly:
        return False
    if not isinstance(item, Plane | Rectangle | Disc):
        return item.is_background
    turns = any(any(motion.turns[:2]) for motion in (*scene.motions(item), camera.motion))
    shakes = camera.shake is not None and camera.shake.rotation_rms > 0.0
    slopes = (item.slope_x, item.slope_y) if isinstance(item, Plane) else (0.0, 0.0)
    normal = static_rotation(item) @ (-slopes[0], -slopes[1], 1.0)
    return not (turns or shakes or normal[:2].any() or (scene.stereo is not None and scene.stereo.toe_in > 0.0))


@dataclass(frozen=True, eq=False)
class ResolvedView:
    """A view of a scene, resolved once for all decisions of a plan."""

    scene: Scene
    eye: Eye
    maps: Maps
    psf: PointSpread  # the widest of `spreads`, if colors are blurred separately
    spreads: tuple[PointSpread, ...]  # PSFs of red, green and blue if the lens or waves separate them, else empty
    is_static_map: bool  # see `is_static_map`
    is_forward: bool  # see `is_forward`
    is_shifted: bool  # see `shifts_view`
    hides_nothing: bool  # see `hides_nothing`
    one_radius: bool  # see `has_one_radius`
    times: list[float]  # s
    poses: list[tuple[Pose, ...]]  # of the objects at each time
    w: Array  # inverse depths (objects, times, GRID, GRID) in 1/mm over frame and guard band, 0 for a miss
    slopes: Slopes  # slopes (GRID, GRID) of the rays along x and along y at the middle time
    smallest: float  # range of |R| with a margin, px
    largest: float
    guard: int  # width of the guard band for |R| up to `largest`, px
    lowest: float  # range of R with its sign, with a margin, px
    highest: float

    @property
    def casts_rays(self) -> bool:
        """True if rays make the focused image."""
        return not (self.is_static_map or self.is_forward)

    @cached_property
    def nearest(self) -> Array:
        """Inverse depth of the nearest object at each ray, (times, GRID, GRID)."""
        return np.asarray(self.w.max(axis=0))

    @cached_property
    def radii(self) -> Array:
        """|R| (n,) in px where rays hit the nearest object, by the lens of the middle time."""
        hit, lens = self.nearest > 0, lens_at(self.scene, self.times[len(self.times) // 2])
        return np.abs(lens.image_radius(self.nearest[hit], *_slopes_where(hit, self.scene, self.slopes)))

    @property
    def is_uniform(self) -> bool:
        """True if one surface without a hole fills the view, and its texture needs no sub-pixel sources."""
        item = self.scene.objects[0]
        simple = len(self.scene.objects) == 1 and cutting_bounds(item) is None and item.shape != "quadric"
        return simple and bool((self.nearest > 0).all()) and not needs_detail(self.scene, self.psf, self.largest)

    @cached_property
    def extents(self) -> tuple[Extent, ...]:
        """Extents of the objects over the whole sequence."""
        hits = zip(self.scene.objects, zip(*self.poses, strict=True), self.w, strict=True)
        slack = 0.0 if self.scene.moves_evenly else UNEVEN
        return tuple(extent(item, poses, w, slack) for item, poses, w in hits)

    @cached_property
    def occlusion_groups(self) -> tuple[OcclusionGroup, ...]:
        """Occlusion groups, which are valid while objects stay within `extents`."""
        return occlusion_groups(self.scene.objects, self.extents, widest_camera(self.scene), self.psf)

    @property
    def has_small_images(self) -> bool:
        """True if an object may at some time be so narrow in the image that rays through pixels can miss it."""
        for time, poses in zip(self.times, self.poses, strict=True):
            most = NARROW_IMAGE * ray_step(camera_at(self.scene, time))
            for item, pose in zip(self.scene.objects, poses, strict=True):
                surface = place(item, pose)
                width = surface.width
                if width < 0.0:
                    half = outline_lines(surface, *self.slopes)[1]
                    if not np.isfinite(half).all():
                        continue
                    change = max(float(np.abs(np.diff(half, axis=axis)).max()) for axis in (0, 1))
                    width = 2.0 * (float(half.min()) - change)
                if width < most:
                    return True
        return False


def _check_curvature(scene: Scene, lens: LensOptics, slopes: Slopes) -> None:
    """Raise SceneError if field curvature is so strong that the image of a plane would reach the lens."""
    squared = slopes[0] ** 2 + slopes[1] ** 2
    curvature = 0.0 if scene.lens is None else scene.lens.field_curvature
    if not (1.0 + lens.sag * squared > LEAST_DISTANCE).all():
        most = (1.0 - LEAST_DISTANCE) / float(abs(lens.sag) * squared.max()) * abs(curvature)
        rule = f"the image of a plane must stay behind the lens over frame and guard band, up to {most:.3g} 1/mm"
        raise SceneError(f"lens.field_curvature: {rule}; got {curvature:g}")


def _check_fold(scene: Scene, cameras: Sequence[Camera], guard: int) -> None:
    """Raise SceneError unless frame and guard band end before a distorted image would fold back."""
    distortion, lens = distortion_of(cameras[0]), scene.lens
    if distortion is None or lens is None:
        return
    step, corner = max(map(ray_step, cameras)), float(np.hypot(*(0.5 * np.array(cameras[0].frame_size) + guard)))
    if not corner * step < distortion.image_reach:
        terms = {"lens.distortion": any(lens.distortion), "lens.tangential": any(lens.tangential)}
        key = next((key for key, is_set in terms.items() if is_set), "psf.seidel.W311")
        rule = f"frame and guard band must end where the image folds back, {distortion.image_reach / step:.4g} px off"
        raise SceneError(f"{key}: {rule} the axis; got a corner {corner:.4g} px off")


def _widest(scene: Scene, time: float) -> Camera:
    """The camera at a time, for the color with the widest field of view."""
    camera = camera_at(scene, time)
    if scene.lens is None or not scene.shifts_colors:
        return camera
    return colored(camera, scene.lens, int(np.argmin(scene.lens.lateral)))


def _slopes_where(hit: NDArray[np.bool_], scene: Scene, slopes: Slopes) -> tuple[Array | float, Array | float]:
    """Slopes (n,) along x and y of the rays that hit a surface, or 0 if the blur does not depend on slopes.

    hit: mask (..., GRID, GRID) of rays.
    """
    if not scene.blurs_unevenly:
        return 0.0, 0.0
    x, y = (np.broadcast_to(slope, hit.shape)[hit] for slope in slopes)
    return x, y


def _radii(scene: Scene, lenses: Sequence[Sequence[LensOptics]], w: Array, rays: Sequence[Slopes]) -> Array:
    """Signed blur radii (n,) in px of all hits in `w` (`ResolvedScene.w`).

    lenses: for each time, the lenses of all colors; rays: slopes of the rays at each time. If the lens does not change,
    only the lenses and the slopes of the first time are used.
    """
    if scene.blurs_unevenly and is_static_map(scene):  # the nearest and farthest points may be anywhere in the map
        ends = np.array([w[w > 0].min(initial=np.inf), w.max(initial=0.0)])
        w = np.broadcast_to(ends[np.isfinite(ends), None, None, None], (*ends.shape, 1, GRID, GRID))
    times = [slice(k, k + 1) for k in range(w.shape[1])] if scene.lens_moves else [slice(None)]
    radii = [np.empty(0)]
    for time, color_lenses, slopes in zip(times, lenses, rays, strict=False):
        _check_curvature(scene, color_lenses[0], slopes)
        hit = w[:, time] > 0
        hit_slopes = _slopes_where(hit, scene, slopes)
        radii += [lens.image_radius(w[:, time][hit], *hit_slopes) for lens in color_lenses]
    return np.concatenate(radii)


def resolve(scene: Scene, psf: PointSpread, channels: int, eye: Eye, maps: Maps) -> ResolvedView:
    """Pose the objects of a view at sampled times, and cast rays of a coarse grid at them.

    psf: the scene's, from `clsco.inputs.pupils`; channels: color channels of its textures, 1 or 3. Surfaces in the
    guard band may be blurred more than those in the frame, and so need a wider band: rays are cast again until the band
    is wide enough for every |R| in it. Raises SceneError if |R| exceeds LARGEST_BLUR, keyframes do not cover the
    exposures, or the lens distorts or curves the image too much.
    """
    static, forward, unhidden = is_static_map(scene), is_forward(scene, eye), hides_nothing(scene)
    layered = scene.psf.occlusion == "layered" and not unhidden
    psf = elliptic_spread(scene, psf, scene.is_analytic and not layered and not forward)
    splits = scene.separates_colors or (channels > 1 and scene.psf.is_colored)  # by the lens, or by waves
    spreads = spreads_of_colors(psf, scene.psf, scene.camera) if splits else ()
    psf = max(spreads, key=lambda spread: spread.pupil.margin, default=psf)
    check_keyframes(scene)
    times, one_radius = sequence_times(scene), has_one_radius(scene)
    poses, cameras = [poses_at(scene, t, eye) for t in times], [_widest(scene, t) for t in times]
    lenses = [lenses_at(scene, t) for t in times]
    cacheable = scene.is_analytic and not (scene.moves and (scene.lens_moves or scene.shifts_colors))
    ray_scene = without_lens(scene) if cacheable else None

    def inverse_depths(guard: int) -> Array:
        if ray_scene is None:
            return _inverse_depths(scene, [*zip(cameras, poses, strict=True)], maps, guard)
        samples = [(reference_camera(ray_scene), each) for each in poses]
        key = ray_scene, eye, guard
        return _DEPTHS.get(key, lambda: _inverse_depths(ray_scene, samples, maps, guard), lambda depths: depths.nbytes)

    def cast(guard: int) -> tuple[float, ResolvedView]:
        """Largest |R| in frame and guard band, and the prediction for that band."""
        _check_fold(scene, cameras, guard)
        w, rays = inverse_depths(guard), _slopes(cameras, guard)
        signed = _radii(scene, lenses, w, rays)
        signed = signed if signed.size else np.zeros(1)
        lowest, highest = float(signed.min()), float(signed.max())
        smallest, largest = float(np.abs(signed).min()), max(-lowest, highest)
        if largest > LARGEST_BLUR:
            nearest, rule = 1.0 / float(w.max()), f"the blur radius must be at most {LARGEST_BLUR:g} px"
            why = f"the surface comes as near as {nearest:.4g} mm; is it in mm, and the focus on it?"
            if abs(float(lenses[0][0].blur_radius(1.0 / nearest))) <= LARGEST_BLUR:
                why = f"of what is {1.0 / float(w[w > 0].min()):.4g} mm away"
            raise SceneError(f"camera: {rule}; got {largest:.4g} px ({why})")
        largest_hit = largest
        if not one_radius:  # margin for rays between those of the grid
            smallest, largest = max(0.0, 0.9 * smallest - 1.0), 1.1 * largest + 1.0
            lowest, highest = lowest - 0.1 * abs(lowest) - 1.0, highest + 0.1 * abs(highest) + 1.0
        band = guard_band(psf, scene.psf.border, largest)
        return largest_hit, ResolvedView(
            scene, eye, maps, psf, spreads, static, forward, shifts_view(scene, eye), unhidden, one_radius, times,
             poses, w, rays[len(times) // 2], smallest, largest, band, lowest, highest,
        )  # fmt: skip

    guard = cast(0)[1].guard
    view = cast(guard)[1]
    while view.guard > guard:
        guard = view.guard
        largest_hit, wider = cast(guard)
        if largest_hit <= view.largest:
            break
        # Without the margin of |R|: if |R| grows about as fast as the band, the band would otherwise grow forever.
        view = replace(wider, guard=max(guard, guard_band(psf, scene.psf.border, largest_hit)))
    _check_fold(scene, cameras, view.guard)
    return _with_waves(view) if psf.diffracted else view


def _with_waves(view: ResolvedView) -> ResolvedView:
    """The view with PSFs for its range of R. Raises SceneError as `clsco.optics.waves.check_waves`."""
    from clsco.optics.waves import check_waves

    check_waves(view.psf, view.largest)
    ends = view.lowest, view.highest
    return replace(view, psf=view.psf.between(*ends), spreads=tuple(spread.between(*ends) for spread in view.spreads))
