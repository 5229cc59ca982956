"""A second tracer of the lens, which reads scene files by the words of the documentation alone.

    python -m benchmarks.truth.independent [--only NAME] [--samples 4096] [--set KEY=VALUE] [--pictures DIR]

Scenes of 192 x 192 px of surfaces that touch (in focus, blurred, moving), that cross the focal surface, and others in
which a fault of the visibility test or of the documentation shows. Each is content of a scene file: clsco parses it,
and this file reads it as docs/scene_files.md says, shares no code with the package, and meets every surface by the
textbook formula in float64. The figures are the PSNR in dB (white = 1) of the whole frame and of what is within 3 px of
an outline (the bands), the largest error, and the tracer's own noise. Figures go to the terminal and, of all scenes, to
benchmarks/results/independent.md.

The samples are a Sobol set over pixel, lens and exposure, which each pixel shifts modulo one by numbers that follow
from its index: the same bits on every run. A pilot of its own tells where few samples do.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import CubicSpline
from scipy.stats import qmc

import clsco
from benchmarks.truth.independent_lens import (
    FOCAL,
    PITCH,
    VARIES,
    Lens,
    bend,
    diffracted,
    distort,
    focus_at,
    lens_of,
    lens_point,
    passes_rims,
    straighten,
    vignetting,
)
from benchmarks.truth.independent_lens_scenes import scenes as lens_scenes
from benchmarks.truth.independent_scenes import SCENES
from benchmarks.truth.traced import decibels, rms

ROOT = Path(__file__).resolve().parents[1]
PILOT = 64
BAND_PX = 3

Array = NDArray[np.float64]

# Numbers of a surface: ten coefficients of x^2 y^2 z^2 xy yz xz x y z 1, then bounds (6), the square of the largest
# distance from its z axis, and how its image lies: kind, width and height in mm or copies, 1 where it is repeated.
COEFFICIENTS, BOUNDS, ACROSS, IMAGE, NUMBERS = 0, 10, 16, 17, 21
PROJECTED, FLAT, GLOBE, AROUND = range(4)


@dataclass(frozen=True)
class Surface:
    """One surface: its numbers, image (rows, columns, 3), and its pose: P(t) = C + s(t) + M(t) R0 (P0 - C)."""

    numbers: Array
    image: Array
    center: Array
    start: Array
    motion: Mapping[str, Any]

    def way(self, times: Array) -> tuple[Array, Array]:
        """Shifts in mm and Euler angles in deg at some times, both (times, 3), by the words of docs/motion.md."""
        keys = self.motion.get("keyframe")
        if keys is None:
            names = (("velocity", "acceleration"), ("angular_velocity", "angular_acceleration"))
            rates = [[np.asarray(self.motion.get(name, (0.0, 0.0, 0.0)), float) for name in pair] for pair in names]
            one, other = (np.outer(times, rate) + np.outer(times**2 / 2, gain) for rate, gain in rates)
            return one, other
        knots = np.array([key["time"] for key in keys])
        at = np.clip(times, knots[0], knots[-1])  # held before the first and after the last
        found = []
        for name in ("position", "rotation"):
            values = np.array([key.get(name, (0.0, 0.0, 0.0)) for key in keys], float)
            if name == "rotation" and np.any(values, axis=0).sum() > 1:
                raise ValueError("independent: keyframes must turn about one axis alone")
            match self.motion.get("interpolation", "cubic"):
                case "cubic":
                    found.append(CubicSpline(knots, values, bc_type="natural")(at))
                case "linear":
                    found.append(np.stack([np.interp(at, knots, axis) for axis in values.T], axis=-1))
                case "step":
                    found.append(values[np.searchsorted(knots, at, side="right") - 1])
                case other_way:
                    raise ValueError(f"independent: interpolation must be one that it knows; got {other_way!r}")
        return found[0], found[1]


def rotation(angles: Any) -> Array:
    """Euler angles in deg about x, y, z in turn: x turns the top away, y brings the right side nearer, z clockwise."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(np.radians(angles)), np.sin(np.radians(angles))
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, sc, 0], [-sc, cc, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def decode(color: str) -> Array:
    """Linear radiance (3,) of "#rrggbb" (IEC 61966-2-1)."""
    codes = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)


def image_of(texture: Any) -> Array:
    """Linear radiance (rows, columns, 3) of a color, or of an array, which is that already."""
    if isinstance(texture, str):
        return decode(texture).reshape(1, 1, 3)
    array = np.asarray(texture, float)
    return np.array(np.broadcast_to(array.reshape(*array.shape[:2], -1), (*array.shape[:2], 3)))


def surfaces_of(item: Mapping[str, Any]) -> list[Surface]:
    """The surfaces of one object of a scene file."""
    shape, number = item["shape"], np.zeros(NUMBERS)
    number[BOUNDS:ACROSS:2], number[BOUNDS + 1 : ACROSS : 2], number[ACROSS] = -np.inf, np.inf, np.inf
    start = rotation(item.get("rotation", (0.0, 0.0, 0.0)))
    center = np.asarray(item.get("center", item.get("apex", (0.0, 0.0, item.get("distance", 0.0)))), float)
    if "bounds" in item:
        number[BOUNDS:ACROSS] = np.ravel(item["bounds"])
    image = image_of(item.get("texture", "#ffffff"))

    def one(turned: Array) -> Surface:
        return Surface(number.copy(), image, center, start @ turned, item.get("motion", {}))

    def card(width: float, height: float, offset: float, turned: Array) -> Surface:
        number[8], number[9] = 1.0, -offset
        number[BOUNDS : BOUNDS + 4] = -width / 2, width / 2, -height / 2, height / 2
        number[IMAGE:] = (FLAT if mapped else PROJECTED), width, height, 0.0
        return one(turned)

    mapped = item.get("texture_mapping", "projected") == "surface"
    match shape:
        case "plane":
            number[6:9] = item.get("slope_x", 0.0), item.get("slope_y", 0.0), -1.0
        case "rectangle":
            width, height = item["size"]
            return [card(width, height, item.get("offset", 0.0), np.eye(3))]
        case "disc":
            number[8], number[9], number[ACROSS] = 1.0, -item.get("offset", 0.0), item["radius"] ** 2
        case "box":  # six rectangles: plain ones need not tell which way their images stand
            assert not mapped
            x, y, z = item["size"]
            aside, above = rotation((0.0, 90.0, 0.0)), rotation((90.0, 0.0, 0.0))
            faces = ((x, y, z, np.eye(3)), (z, y, x, aside), (x, z, y, above))
            return [card(a, b, side * depth / 2, way) for a, b, depth, way in faces for side in (-1.0, 1.0)]
        case "cylinder":
            axis = np.asarray(item.get("axis", (0.0, 1.0, 0.0)), float)
            x, y, z = axis / np.linalg.norm(axis)
            number[:6] = 1 - x * x, 1 - y * y, 1 - z * z, -2 * x * y, -2 * y * z, -2 * x * z
            number[9] = -(item["radius"] ** 2)
        case "sphere":
            number[:3], number[9] = 1.0, -(item["radius"] ** 2)
            repeats = np.broadcast_to(item.get("texture_repeats", (1.0, 1.0)), 2)
            number[IMAGE:] = (GLOBE if mapped else PROJECTED), *(np.array([2.0, 1.0]) * np.pi / repeats), 1.0
        case "cone":
            number[:3] = 1.0, 1.0, -(math.tan(math.radians(item["half_angle"])) ** 2)
            side = number[BOUNDS + 4 : BOUNDS + 6]
            if item.get("nappe", "away") == "away":
                side[0] = max(side[0], 0.0)
            else:
                side[1] = min(side[1], 0.0)
        case "ellipsoid":
            number[:3], number[9] = 1.0 / np.asarray(item["semi_axes"], float) ** 2, -1.0
        case _:
            raise ValueError(f"independent: shape must be one that this tracer knows; got {shape!r}")
    return [one(np.eye(3))]


@njit(cache=True)
def _inside(k, x, y, z):  # type: ignore[no-untyped-def]
    """True if a point of the object's frame is within all that cuts the surface."""
    return (
        k[10] <= x <= k[11] and k[12] <= y <= k[13] and k[14] <= z <= k[15] and x * x + y * y <= k[16]
    )  # fmt: skip


@njit(cache=True)
def _hit(k, o, d):  # type: ignore[no-untyped-def]
    """Least Z > 0 at which o + d Z, in the object's frame, meets a surface within its bounds; infinite for none."""
    a = k[0] * d[0] * d[0] + k[1] * d[1] * d[1] + k[2] * d[2] * d[2]
    a += k[3] * d[0] * d[1] + k[4] * d[1] * d[2] + k[5] * d[0] * d[2]
    b = 2 * (k[0] * o[0] * d[0] + k[1] * o[1] * d[1] + k[2] * o[2] * d[2])
    b += k[3] * (o[0] * d[1] + o[1] * d[0]) + k[4] * (o[1] * d[2] + o[2] * d[1]) + k[5] * (o[0] * d[2] + o[2] * d[0])
    b += k[6] * d[0] + k[7] * d[1] + k[8] * d[2]
    c = k[0] * o[0] * o[0] + k[1] * o[1] * o[1] + k[2] * o[2] * o[2]
    c += k[3] * o[0] * o[1] + k[4] * o[1] * o[2] + k[5] * o[0] * o[2] + k[6] * o[0] + k[7] * o[1] + k[8] * o[2] + k[9]
    if abs(a) < 1e-14 * (abs(b) + abs(c)):
        if b == 0.0:
            return np.inf
        first = second = -c / b
    else:
        under = b * b - 4 * a * c
        if under < 0.0:
            return np.inf
        q = -0.5 * (b + math.copysign(math.sqrt(under), b))
        if q == 0.0:
            return np.inf
        first, second = min(q / a, c / q), max(q / a, c / q)
    for depth in (first, second):
        if depth > 0.0 and _inside(k, o[0] + depth * d[0], o[1] + depth * d[1], o[2] + depth * d[2]):
            return depth
    return np.inf


@njit(cache=True)
def _keys(t):  # type: ignore[no-untyped-def]
    """The cubic of Keys (a = -1/2) at a distance."""
    t = abs(t)
    if t < 1.0:
        return (1.5 * t - 2.5) * t * t + 1.0
    return ((2.5 - 0.5 * t) * t - 4.0) * t + 2.0 if t < 2.0 else 0.0


@njit(cache=True)
def _fold(index, count):  # type: ignore[no-untyped-def]
    """Index of an image that is mirrored at its borders."""
    index %= 2 * count
    return index if index < count else 2 * count - 1 - index


@njit(cache=True)
def _add(sums, k, image, x, y, z):  # type: ignore[no-untyped-def]
    """Add what an image on a surface shows at a point of the object's frame, interpolated by cubics."""
    rows, columns = image.shape[:2]
    if k[IMAGE] == FLAT:
        across, up = x / k[IMAGE + 1], y / k[IMAGE + 2]
    else:  # longitude from the side of the camera, latitude
        across = math.atan2(x, -z) / k[IMAGE + 1]
        up = math.asin(min(max(y / math.sqrt(x * x + y * y + z * z), -1.0), 1.0)) / k[IMAGE + 2]
    column, row = columns * (across + 0.5) - 0.5, rows * (0.5 - up) - 0.5
    for i in range(math.floor(row) - 1, math.floor(row) + 3):
        for j in range(math.floor(column) - 1, math.floor(column) + 3):
            weight = _keys(row - i) * _keys(column - j)
            if k[IMAGE + 3] > 0.0:
                value = image[i % rows, j % columns]
            else:
                value = image[min(max(i, 0), rows - 1), min(max(j, 0), columns - 1)]
            sums += weight * value


@njit(cache=True, inline="always")
def _shift(index, axis):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that follows from two (the finalizer of splitmix64)."""
    z = np.uint64(index * 8 + axis + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@njit(cache=True)
def _first_hit(numbers, poses, lens_x, lens_y, slope_x, slope_y, point, only=-1):  # type: ignore[no-untyped-def]
    """Depth and number of the nearest surface on a ray, -1 for none; `point` (3,) gets the place in its frame. only: of
    all surfaces, if it is not -1.
    """
    nearest, which = np.inf, -1
    o, d = np.empty(3), np.empty(3)
    for n in range(len(numbers)):
        if only >= 0 and n != only:
            continue
        m = poses[n]
        x, y, z = lens_x - m[9], lens_y - m[10], -m[11]
        for i in range(3):
            o[i] = m[3 * i] * x + m[3 * i + 1] * y + m[3 * i + 2] * z
            d[i] = m[3 * i] * slope_x + m[3 * i + 1] * slope_y + m[3 * i + 2]
        depth = _hit(numbers[n], o, d)
        if depth < nearest:
            nearest, which = depth, n
            point[0], point[1], point[2] = o[0] + depth * d[0], o[1] + depth * d[1], o[2] + depth * d[2]
    return nearest, which


@njit(cache=True, parallel=True)
def _trace(points, counts, salt, window, poses, optics, offsets, numbers, images, sizes, background, lens):  # type: ignore[no-untyped-def]
    """Means (2, rows, columns, 3) over the first `counts` (rows, columns) of each of two sets, `points` (2, n, 4).

    window: first and last row; poses (n or 1, surfaces, 24): inverse rotation and center per sample, and the rotation
    and center before any motion; optics (n or 1, 3): pitch / s0, D / 2, K; images (texels, 3) one after the other, of
    `offsets` and `sizes` (surfaces, 2); background: number of its image, -1 for none; lens: as in `Lens`.
    """
    rows, columns = counts.shape
    properties, wave, rims, opening_rows, opening_cells, sigma, most = lens
    at_rest = properties[PITCH] / properties[FOCAL]  # textures are what the camera of the scene shows
    found = np.zeros((2, rows, columns, 3))
    for pixel in prange(window[0] * columns, window[1] * columns):
        row, column = pixel // columns, pixel % columns
        shifts = np.empty(8)
        for axis in range(8):
            shifts[axis] = _shift(pixel + salt, axis)
        point, at_hit, at = np.empty(3), np.empty(3), np.empty(4)
        sums = np.zeros((2, 3))
        for sample in range(2 * counts[row, column]):
            half, s = sample % 2, sample // 2
            for axis in range(4):
                at[axis] = (points[half, s, axis] + shifts[4 * half + axis]) % 1.0
            ratio, radius, on_axis = optics[s % len(optics)]
            u, v = lens_point(properties, opening_rows, opening_cells, sigma, most, at[2], at[3])
            lens_x, lens_y = radius * u, radius * v
            seen_x, seen_y = column - 0.5 * columns + at[0], 0.5 * rows - row - at[1]
            x, y = straighten(properties, ratio, seen_x, seen_y)
            pose = poses[s % len(poses)]
            focus, slope_x, slope_y, nearest, which = 0.0, 0.0, 0.0, np.inf, -1
            # The ray to a source bends by the errors at the place of that source: each surface has a ray of its own,
            # and so has what is infinitely far away.
            for own in range(len(numbers), -1, -1) if properties[VARIES] > 0.0 else range(1):
                depth = pose[own, 11] if own < len(numbers) else np.inf
                chief_x, chief_y, found_x, found_y, k, hit, number = x, y, 0.0, 0.0, 0.0, np.inf, -1
                for _ in range(4 if properties[VARIES] > 0.0 else 1):
                    # The point in focus is where the line through the middle of the lens meets the focal distance.
                    k = focus_at(properties, ratio, on_axis, chief_x, chief_y)
                    right, up = bend(properties, wave, u, v, chief_x, chief_y)
                    found_x, found_y = ratio * (x - right) - k * lens_x, ratio * (y - up) - k * lens_y
                    if own < len(numbers):
                        only = own if properties[VARIES] > 0.0 else -1
                        hit, number = _first_hit(numbers, pose, lens_x, lens_y, found_x, found_y, at_hit, only)
                    depth = hit if number >= 0 else depth
                    chief_x, chief_y = (lens_x / depth + found_x) / ratio, (lens_y / depth + found_y) / ratio
                if hit < nearest or own == len(numbers) or properties[VARIES] == 0.0:
                    focus, slope_x, slope_y, nearest, which, point[:] = k, found_x, found_y, hit, number, at_hit
            total = sums[half]
            if which < 0 and background < 0:
                continue
            if not passes_rims(
                rims, properties, focus, nearest, lens_x, lens_y, slope_x, slope_y, ratio * seen_x, ratio * seen_y
            ):
                continue
            shown = which if which >= 0 else background
            start, high, wide = offsets[shown], sizes[shown, 0], sizes[shown, 1]
            if which >= 0 and numbers[which, IMAGE] != PROJECTED:
                image = images[start : start + high * wide].reshape((high, wide, 3))
                _add(total, numbers[which], image, point[0], point[1], point[2])
                continue
            i = j = 0
            if high * wide > 1:
                px, py = slope_x, slope_y
                if which >= 0:  # where it was in the reference pose
                    m = poses[0, which, 12:]
                    z = m[6] * point[0] + m[7] * point[1] + m[8] * point[2] + m[11]
                    px = (m[0] * point[0] + m[1] * point[1] + m[2] * point[2] + m[9]) / z
                    py = (m[3] * point[0] + m[4] * point[1] + m[5] * point[2] + m[10]) / z
                px, py = distort(properties, px, py)
                j = _fold(math.floor(px / at_rest + 0.5 * columns), wide)
                i = _fold(math.floor(0.5 * rows - py / at_rest), high)
            total += images[start + i * wide + j]
        for half in range(2):
            found[half, row, column] = sums[half] / counts[row, column]
    return found


def optics_of(content: Mapping[str, Any], lens: Lens, times: Array) -> Array:
    """Pitch / s0, half the diameter and K of a lens at some times, (times, 3)."""
    camera, keys = content["camera"], content.get("lens", {}).get("keyframe", ())
    focal = camera.get("focal_length", 20.0)
    values = {"focal_length": focal, "focus_distance": camera.get("focus_distance", 250.0)}
    values["f_number"] = focal / camera["aperture_diameter"] if "aperture_diameter" in camera else camera["f_number"]
    at = {name: np.full(len(times), float(value)) for name, value in values.items()}
    for name, path in at.items():
        own = [(key["time"], key[name]) for key in keys if name in key]
        if own:  # inverses of distance and f-number, and the focal length itself, are linear between keys
            power = 1.0 if name == "focal_length" else -1.0
            knots, given = np.transpose(own)
            path[:] = np.interp(times, knots, given**power) ** power
    ratio = camera.get("pixel_pitch", 0.01) / (at["focal_length"] * lens.magnification)
    return np.stack([ratio, at["focal_length"] / at["f_number"] / 2, 1 / at["focus_distance"] + lens.power], axis=-1)


def opening_times(shutter: float, curve: Any, uniform: Array) -> Array:
    """Times after the opening of a shutter, of uniform numbers, with the density of its curve."""
    named = {"box": [1, 1], "triangle": [0, 1, 0], "trapezoid": [0, 1, 1, 1, 0]}
    weights = np.asarray(named[curve] if isinstance(curve, str) else curve, float)
    at = np.linspace(0.0, 1.0, 2049)
    density = np.interp(at, np.linspace(0.0, 1.0, len(weights)), weights)
    sums = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    return np.interp(uniform * sums[-1], sums, at) * shutter


def trace(content: Mapping[str, Any], samples: int) -> tuple[Array, Array]:
    """The first frame of a scene: two independent images (rows, columns, 3), linear."""
    if content.get("psf", {}).get("model") == "wave":
        return (diffracted(content),) * 2
    columns, rows = content["camera"]["resolution"]
    sequence = content.get("sequence", {})
    shutter = sequence.get("shutter", sequence.get("interval", 1.0))
    items = [item for item in content["object"] if item["shape"] != "background"]
    surfaces = [surface for item in items for surface in surfaces_of(item)]
    images = [surface.image for surface in surfaces]
    behind = [image_of(item["texture"]) for item in content["object"] if item["shape"] == "background"]
    # Four dimensions for each of the images, and one of times that all pixels of a row share, so that poses are found
    # once. Dimensions of two sets may not be joined: the first ones of any two go up and down together.
    samples_of = qmc.Sobol(9, scramble=True, rng=np.random.default_rng(0)).random(samples)
    points, uniform = np.stack([samples_of[:, :4], samples_of[:, 4:8]]), samples_of[:, 8]
    moves = any(surface.motion for surface in surfaces) or "keyframe" in content.get("lens", {})
    times = opening_times(shutter, sequence.get("shutter_curve", "box"), uniform) if moves else np.zeros(1)
    sizes = np.array([image.shape[:2] for image in images + behind])
    offsets = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))])
    texels = np.concatenate([image.reshape(-1, 3) for image in images + behind])
    numbers = np.array([surface.numbers for surface in surfaces])
    readout = sequence.get("readout", 0.0)
    opened = np.arange(rows) * readout / max(rows - 1, 1)  # s, of each row
    colors = [lens_of(content, color) for color in range(3)]
    alike = all(lens.magnification == 1 and lens.power == 0 for lens in colors)

    def image(counts: NDArray[np.int64], salt: int) -> Array:
        found = np.zeros((2, rows, columns, 3))
        for window in [(row, row + 1) for row in range(rows)] if readout else [(0, rows)]:
            poses = poses_at(surfaces, times + opened[window[0]])
            for color, lens in enumerate(colors[:1] if alike else colors):
                optics = optics_of(content, lens, times + opened[window[0]])
                packed = lens.numbers, lens.wave, lens.rims, lens.rows, lens.cells, lens.sigma, lens.most
                scene = poses, optics, offsets, numbers, texels, sizes, len(images) if behind else -1, packed
                channels = slice(None) if alike else slice(color, color + 1)
                found[..., channels] += _trace(points, counts, salt, window, *scene)[..., channels]
        return found

    pilot = image(np.full((rows, columns), PILOT), rows * columns)
    flat = ndimage.maximum_filter(np.ptp(pilot, axis=0).max(axis=-1), 5) < 1e-9
    flat &= not moves  # the halves share their times, and agree where these alone decide
    return tuple(image(np.where(flat, PILOT, samples // 2), 0) * vignetting(content)[..., None])


def poses_at(surfaces: Sequence[Surface], times: Array) -> Array:
    """Poses (times, surfaces, 24) as `_trace` takes them."""
    poses = np.zeros((len(times), len(surfaces), 24))
    for n, one in enumerate(surfaces):
        for s, (shift, angles) in enumerate(zip(*one.way(times), strict=True)):
            turn = rotation(angles) @ one.start
            poses[s, n, :9], poses[s, n, 9:12] = turn.T.ravel(), one.center + shift
            poses[s, n, 12:21], poses[s, n, 21:] = one.start.ravel(), one.center
    return poses


def bands(frame: Any) -> NDArray[np.bool_]:
    """Pixels (rows, columns) within BAND_PX px of an outline in the object numbers of a frame."""
    number = np.asarray(frame.object_id)
    size = 2 * BAND_PX + 1
    return np.asarray(ndimage.maximum_filter(number, size) != ndimage.minimum_filter(number, size))


def measure(content: Mapping[str, Any], samples: int, settings: Sequence[str]) -> tuple[Array, Array, dict[str, float]]:
    """Both images (rows, columns, 3), clsco's and the tracer's, and figures."""
    scene = clsco.parse_scene(content)
    for setting in settings:
        key, _, value = setting.partition("=")
        scene = scene.replace(key, int(value) if value.isdigit() else value)
    frame = clsco.render_frame(scene, 0, truth=["object_id"])
    halves = trace(content, samples)
    truth = (halves[0] + halves[1]) / 2
    color = np.asarray(frame.color, float)
    color = np.broadcast_to(color.reshape(*color.shape[:2], -1), truth.shape)
    near, error = bands(frame), color - truth
    figures = {
        "psnr": decibels(rms(error)),
        "bands": decibels(rms(error[near])) if near.any() else math.inf,
        "largest": float(abs(error).max()),
        "noise": decibels(rms((halves[0] - halves[1]) / 2)),
    }
    return color, truth, figures


def main() -> None:
    """Read the command line, trace, render and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="NAME", help="scenes whose name contains this")
    parser.add_argument("--samples", type=int, default=4096, metavar="N", help="of a pixel where it matters")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as of `clsco render`")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="also write images, NPZ")
    options = parser.parse_args()
    lines = ["| scene | whole | bands | largest | tracer |", "|---|---|---|---|---|"]
    contents = {name: make() for name, make in SCENES.items()} | lens_scenes()
    for name in (name for name in contents if options.only in name):
        color, truth, figures = measure(contents[name], options.samples, options.set)
        values = f"{figures['psnr']:.1f} | {figures['bands']:.1f} | {figures['largest']:.3f} | {figures['noise']:.1f}"
        lines.append(f"| {name} | {values} |")
        print(lines[-1], flush=True)
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
            np.savez(options.pictures / f"{name}.npz", color=color, truth=truth)
    if not options.only and not options.set:
        command = f"`python -m benchmarks.truth.independent --samples {options.samples}`"
        head = ["# Scenes by a tracer that reads only the documentation", "", f"PSNR in dB: {command}.", ""]
        (ROOT / "results" / "independent.md").write_text("\n".join([*head, *lines, ""]))


if __name__ == "__main__":
    main()
