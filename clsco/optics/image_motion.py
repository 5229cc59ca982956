"""Motion of objects in the image while a shutter is open, and the time samples that it needs (float64, pure).

Consider an edge of contrast 1 that passes a pixel. The moving object and the surface behind it are both blurred with
the object's blur radius R at the edge. For a speed of v px per exposure, the light of the pixel changes at a rate of at
most v c / R, where c is the fraction of the lens's light that an edge crosses per radius, 2 / pi for a disc. By Euler
and Maclaurin, the error of the midpoint rule with n samples is then at most

    c v / (24 R n^2)

of white. For a motion that is not uniform, v is half of the total variation of the velocity, which counts as 0 before
and after the exposure. If R is small, n is instead chosen so that steps are at most PIXELS_PER_SAMPLE long, and the
pixel smooths them. The smaller n of the two rules is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from math import ceil, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from clsco.optics.exposure import jump_times, lines_overlap, shutter_span, subframes_of
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at, lens_at, lenses_at, reference_camera
from clsco.optics.motion import Pose, poses_at, rest_center
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.rays import image_slopes, slopes_at
from clsco.optics.resolved_view import Maps, cast_grid
from clsco.scene.model import Camera, Object, Scene

Array = NDArray[np.float64]
PIXELS_PER_SAMPLE = 1.0  # fastest motion of an object in focus: 2 px lose 5 to 9 dB, less than 1 gains little
EDGE_ERROR = 5e-4  # error of a pixel that an edge of contrast 1 passes, 1 = white
MOST_SAMPLES = 4095
LENS_TIMES = 65  # times of an exposure at which the lens is evaluated
LINE_SAMPLES = 11  # number of time samples that is enough if lines share them
MOST_SUBFRAMES = 8192  # time samples of a frame
RAYS = 17  # rays along each axis of the visible part of an object
LOOKS = 5  # times of an exposure at which rays are cast at an object
FIRST_STEPS, MOST_STEPS = 32, 512  # steps of an exposure; a path is evaluated at the ends of steps
# Steps are short enough if, when they are halved, a path gets at most this factor times as long, plus this many px.
SETTLED = 1.05, 0.25
# Irregularity of times, in steps: an object that rotates in phase with regular times would seem to stand still.
UNEVEN = 0.5
NEAREST = 1e-3  # mm: points nearer to the lens are not visible
BETWEEN = 0.95  # ratio of a lower bound of |R| between rays to the smallest |R| at rays


@dataclass(frozen=True, eq=False)
class ImagePath:
    """Path of an object's points in the image while the shutter of a frame is open."""

    times: Array  # (n,), from 0, when the shutter opens, to 1, when it closes
    places: Array  # (n, 3, points): x and y in px from the middle of the image, and inverse depth in 1/mm
    visible: NDArray[np.bool_]  # (n - 1, points), True for steps that touch the frame or its guard band

    @cached_property
    def steps(self) -> Array:
        """Displacements (n - 1, 2, points) of points in each step along x and y, px; 0 in invisible steps."""
        return np.asarray(np.diff(self.places[:, :2], axis=0) * self.visible[:, None])

    @property
    def longest(self) -> float:
        """Length of the longest path of any point, px."""
        return float(np.linalg.norm(self.steps, axis=1).sum(axis=0).max(initial=0.0))

    @property
    def speed(self) -> float:
        """Largest speed of any point, px per exposure."""
        return float((np.linalg.norm(self.steps, axis=1) / np.diff(self.times)[:, None]).max(initial=0.0))

    @property
    def variation(self) -> float:
        """Half of the total variation of a point's velocity, px per exposure, for the point with the largest one. The
        velocity counts as 0 before and after the exposure, so that the result of a uniform motion is its speed.
        """
        velocity = self.steps / np.diff(self.times)[:, None, None]
        changes = np.diff(velocity, axis=0, prepend=0.0, append=0.0)
        return 0.5 * float(np.linalg.norm(changes, axis=1).sum(axis=0).max(initial=0.0))

    def radius(self, scene: Scene) -> float:
        """Smallest |R| of the visible points in px, times BETWEEN because of points between rays. 0 if the path crosses
        the focus of a color, or no point is visible.
        """
        ends = np.zeros((len(self.times), self.places.shape[2]), dtype=np.bool_)
        ends[1:] |= self.visible
        ends[:-1] |= self.visible
        x, y, w = (self.places[:, k][ends] for k in range(3))
        slopes = slopes_at(reference_camera(scene), x, y)
        radii = [lens.image_radius(w, *slopes) for lens in lenses_at(scene, 0.0)]
        if not w.size or any(signed.min() * signed.max() <= 0.0 for signed in radii):
            return 0.0
        return BETWEEN * min(float(np.abs(signed).min()) for signed in radii)


@dataclass(frozen=True)
class Need:
    """Number of time samples that the motion of an object needs."""

    number: int  # of the object, from 0
    speed: float  # largest speed in the image, px per exposure of a line
    radius: float  # smallest |R| of the object's visible points, px; 0 if it does not matter
    samples: float  # time samples per exposure of a line

    def __str__(self) -> str:
        by_radius = self.samples < self.speed / PIXELS_PER_SAMPLE
        return f"{ceil(self.samples)} ({self.speed:.3g} px{f', R from {self.radius:.3g} px' if by_radius else ''})"


def motion_needs(
    scene: Scene, psf: PointSpread, maps: Maps | None = None, guard: int = 0, gradual: bool = True
) -> list[Need]:
    """Numbers of time samples that the motions of objects need, most demanding first; only objects with visible motion.

    guard: width of the guard band, px; gradual: True if the outline of an object is blurred like the object, so that
    points behind it appear gradually.
    """
    gradual = gradual and scene.sequence.sampling == "midpoint" and not scene.lens_moves
    if maps is not None and any(depth is not None for depth in maps):
        return _needs(scene, psf, maps, guard, gradual)
    return list(_cached_needs(scene, psf, (None,) * len(scene.objects), guard, gradual))


def _needs(scene: Scene, psf: PointSpread, maps: Maps, guard: int, gradual: bool) -> list[Need]:
    line = scene.sequence.shutter / (scene.sequence.shutter + scene.sequence.readout)  # fraction of a frame
    needs = dict[int, Need]()
    for frame in sampled_frames(scene):
        for number, path in enumerate(image_paths(scene, maps, frame, guard)):
            speed = line * path.speed
            radius = path.radius(scene) if gradual and maps[number] is None else 0.0
            samples = speed / PIXELS_PER_SAMPLE
            if radius > 0.0:
                samples = min(samples, sqrt(_chord(psf) * line * path.variation / (24.0 * radius * EDGE_ERROR)))
            if samples > (needs[number].samples if number in needs else 0.0):
                needs[number] = Need(number, speed, radius, samples)
    return sorted(needs.values(), key=lambda need: -need.samples)


_cached_needs = lru_cache(maxsize=32)(_needs)  # without depth maps: frames are often requested one by one


@lru_cache(maxsize=16)
def _chord(psf: PointSpread) -> float:
    """Largest fraction of a lens's light that an edge along x or y crosses per radius."""
    cells = psf.lens_cells()
    shares = max(float(cells.sum(axis=axis).max()) for axis in (0, 1)) / float(cells.sum())
    return shares * 0.5 * len(cells) / psf.extent


def motion_samples(scene: Scene, needs: Sequence[Need]) -> int:
    """Time samples per exposure of a line that are enough for all objects; odd, so that one is in the middle.

    With a rolling shutter, lines share time samples. If a line opens or closes within the interval of a time sample,
    the line gets only a part of the sample's light, although the sample is at the middle of the whole interval. The
    error is small with LINE_SAMPLES samples, or if objects move by at most a tenth of a px per interval.
    """
    samples = ceil(max((need.samples for need in needs), default=1.0))
    if scene.rolls and lines_overlap(scene):
        speed = max((need.speed for need in needs), default=0.0)
        samples = max(samples, min(ceil(LINE_SAMPLES * speed) + 1, LINE_SAMPLES))
    most = max(MOST_SUBFRAMES // subframes_of(scene, 1), 1)
    return min(samples | 1, MOST_SAMPLES, most - 1 | 1)


def lens_samples(scene: Scene, maps: Maps) -> int:
    """Time samples per exposure of a line that a changing lens needs: one per px of change of the blur radius."""
    if not scene.lens_moves:
        return 1
    (w, slopes), change = cast_grid(scene, maps), 0.0
    x, y = (np.broadcast_to(slope, w.shape)[w > 0] for slope in slopes)
    for frame in sampled_frames(scene):
        times = np.linspace(*shutter_span(scene.sequence, frame), LENS_TIMES)
        radii = np.array([lens_at(scene, time).image_radius(w[w > 0], x, y) for time in times.tolist()])
        changes = np.abs(np.diff(radii, axis=0))
        changes[np.searchsorted(times, jump_times(scene, frame)) - 1] = 0.0  # jumps have time samples of their own
        change = max(change, float(changes.sum(axis=0).max(initial=0.0)))
    line = scene.sequence.shutter / (scene.sequence.shutter + scene.sequence.readout)
    return min(ceil(change * line / PIXELS_PER_SAMPLE) | 1, MOST_SAMPLES)


def sampled_frames(scene: Scene) -> list[int]:
    """Numbers of the first, the middle and the last frame."""
    return sorted({0, scene.sequence.frames // 2, scene.sequence.frames - 1})


def image_paths(scene: Scene, maps: Maps, frame: int, guard: int = 0) -> list[ImagePath]:
    """Paths of all objects in the image while the shutter of a frame is open; those of still objects have no points.

    Poses are evaluated at FIRST_STEPS + 1 times, and steps are halved as long as this makes a path longer. 8 steps per
    rotation or oscillation give 0.97 of its path length, so up to MOST_STEPS / 8 rotations are detected. An object that
    appears and disappears within a step may be missed; its light is at most 1 / FIRST_STEPS of the exposure's.
    """
    opens, closes = shutter_span(scene.sequence, frame)
    jumps = (jump_times(scene, frame) - opens) / (closes - opens)

    @cache
    def views(steps: int) -> list[tuple[Camera, tuple[Pose, ...]]]:
        times = [opens + share * (closes - opens) for share in _times(steps).tolist()]
        return [(camera_at(scene, time), poses_at(scene, time)) for time in times]

    def find_path(number: int, item: Object) -> ImagePath:
        first = [(camera, poses[number]) for camera, poses in views(FIRST_STEPS)]
        sampled = [first[k] for k in np.linspace(0, FIRST_STEPS, LOOKS).astype(np.intp).tolist()]
        rest = first[0][1]
        still = (np.array_equal(p.rotation, rest.rotation) and np.array_equal(p.shift, rest.shift) for _, p in first)
        if not scene.zooms and all(still):
            body = np.empty((3, 0))
        else:
            body = np.concatenate([_body_points(camera, item, pose, maps[number]) for camera, pose in sampled], axis=1)
        steps = FIRST_STEPS
        while True:
            path = _follow(item, body, [(camera, poses[number]) for camera, poses in views(steps)], guard)
            path.visible[np.searchsorted(path.times, jumps) - 1] = False  # a jump is no motion: a sample ends there
            longest = path.longest
            coarse = ImagePath(path.times[::2], path.places[::2], path.visible[::2] | path.visible[1::2]).longest
            if longest <= SETTLED[0] * coarse + SETTLED[1] or steps >= MOST_STEPS:
                return path
            steps *= 2

    return [find_path(number, item) for number, item in enumerate(scene.objects)]


def _times(steps: int) -> Array:
    """Ends (steps + 1,) of `steps` uneven steps from 0 to 1."""
    k = np.arange(steps + 1, dtype=np.float64)
    inner = (k > 0) & (k < steps)
    return (k + inner * UNEVEN * (np.mod(k * 0.5 * (sqrt(5.0) - 1.0), 1.0) - 0.5)) / steps


def _body_points(camera: Camera, item: Object, pose: Pose, depth: Array | None) -> Array:
    """Visible points (3, n) of an object in a pose, in mm from the object's center, turned back to the reference pose.

    If no ray hits the object, the only point is the center of the ball around it. depth: inverse depths of a depth map,
    None for other objects.
    """
    columns, rows = camera.frame_size
    x, y = slopes_at(camera, *np.meshgrid(*(np.linspace(-0.5, 0.5, RAYS) * (size - 1) for size in (columns, rows))))
    half = float(x.max()), float(y.max())
    if depth is not None:
        x, y = _slopes(((-half[0], half[0]), (-half[1], half[1])))
        w = np.full(x.shape, float(np.quantile(depth[depth > 0], 0.99)))  # all points count as near
        middle = np.empty((3, 0))
    else:
        surface = place(item, pose)
        ends = (surface.extent.x, surface.extent.y)
        x, y = _slopes([(max(-size, low), min(size, high)) for size, (low, high) in zip(half, ends, strict=True)])
        w = predict_inverse_depth(item, surface, x, y)
        middle = surface.ball[:3, None] if isfinite(surface.ball[3]) else np.empty((3, 0))
    hit = w > 0.0
    rays = np.stack([x[hit], y[hit], np.ones(int(hit.sum()))]) / w[hit]
    points = rays if hit.any() else middle
    return np.asarray(pose.rotation.T @ (points - (rest_center(item) + pose.shift)[:, None]))


def _slopes(ends: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """Slopes along x and y (RAYS, RAYS) of rays between the `ends` of each axis; empty if an axis has reversed ends."""
    counts = [RAYS if low <= high else 0 for low, high in ends]
    x, y = np.meshgrid(*(np.linspace(*bounds, count) for bounds, count in zip(ends, counts, strict=True)))
    return x, y


def _follow(item: Object, body: Array, views: Sequence[tuple[Camera, Pose]], guard: int) -> ImagePath:
    """Path of the points `body` (3, points) of an object; views: camera and pose of the object at each time."""
    turns, shifts = (np.stack([getattr(pose, name) for _, pose in views]) for name in ("rotation", "shift"))
    camera, steps = views[0][0], np.array([ray_step(camera) for camera, _ in views])[:, None, None]
    points = turns @ body + (rest_center(item) + shifts)[:, :, None]
    ahead = np.maximum(points[:, 2:], NEAREST)
    xy = np.stack(image_slopes(camera, points[:, 0] / ahead[:, 0], points[:, 1] / ahead[:, 0]), axis=1) / steps
    size = 0.5 * (np.array(camera.frame_size)[:, None] - 1.0) + guard
    near, far = np.minimum(xy[1:], xy[:-1]), np.maximum(xy[1:], xy[:-1])
    ahead_of_lens = points[:, 2] > NEAREST
    visible = ((near <= size) & (far >= -size)).all(axis=1) & ahead_of_lens[1:] & ahead_of_lens[:-1]
    return ImagePath(_times(len(views) - 1), np.concatenate([xy, 1.0 / ahead], axis=1), visible)
