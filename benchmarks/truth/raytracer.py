"""A thin-lens ray tracer in float64: the judge that every picture of the package is measured against.

It shares code with `clsco.truth` alone, whose rays judge single pixels of any scene, and none with what renders.
`benchmarks.truth.problem` reads a scene; a ray meets each surface by the textbook formula.

The ray. The detector position x' (mm, in the plane of the normalization distance s0) receives through the lens point l
(unit disc) the radiance of the surface point whose pinhole projection is x = x' - R(Z) l, with the blur radius R(Z) =
(s0 D/2) (K - 1/Z), K = 1/f - 1/s (2.33). Hence X(Z) = x Z / s0 = (x'/s0 - (D/2) K l) Z + (D/2) l: a straight line from
the point (D/2) l of the lens through the point in focus, Z = 1/K, X = x' / (s0 K). The ray's parameter is the depth Z
itself.

The samples. Two independent Owen-scrambled Sobol sets (pixel x, pixel y, lens, lens, time) give two images: their
mean is the result, the root mean square of half their difference its noise. Each pixel shifts the set over its own
box (modulo one) and turns it about the lens axis by random amounts. Both keep the distribution uniform, so the
estimate is unbiased.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.stats import qmc

from benchmarks.truth.problem import Array, Problem, Textures, inverse_poses, lenses, prepare
from clsco.truth.images import shade
from clsco.truth.kernel import STEP, lambert, meet, mirror, normal_at, rotated, uniform

CACHE_FORMAT = 2  # part of the key of cached images; a change of what is computed must change it
LEAST_SAMPLES = 64
MOST_SAMPLES = 1 << 17  # per pixel
BLOCK = 128  # samples that stay in the fastest cache while all pixels of a row use them


def _disc(square: Array) -> Array:
    """The concentric map (Shirley and Chiu 1997) of points (n, 2) of the unit square to the unit disc."""
    a, b = 2 * square.T - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    ratio = np.divide(np.where(wide, b, a), radius, out=np.zeros_like(a), where=radius != 0)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _cast(hits, rays, count, turn, corner, optics, surface, texture):  # type: ignore[no-untyped-def]
    """Keep the hits of one pixel's rays with one surface where they are nearer than those before.

    `hits` (5 x BLOCK): depth in mm; index of the texel, -1 for none, or -2 - n for object n where an image lies on it;
    and the point in the frame of the object. `rays` (18 x BLOCK): sample set (4), poses (12), and of the lens the ratio
    of pitch and s0, and K. One loop without branches over flat arrays: the compiler computes eight rays at once.
    """
    cosine, sine = turn
    left, top, shift_x, shift_y = corner
    pitch_ratio, _ = optics
    coefficients, bounds, center, rotation = surface
    # Scalars, so that the compiler need not fear that a store changes them.
    k0, k1, k2, k3, k4, k5, k6, k7, k8, k9 = coefficients
    x0, x1, y0, y1, z0, z1, across = bounds
    k, box = (k0, k1, k2, k3, k4, k5, k6, k7, k8, k9), (x0, x1, y0, y1, z0, z1, across)
    center_x, center_y, center_z = center
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = rotation
    r = (r0, r1, r2, r3, r4, r5, r6, r7, r8)
    base, rows, columns, other = texture
    for s in range(count):
        sub_x, sub_y = rays[s] + shift_x, rays[s + BLOCK] + shift_y
        sub_x = sub_x - 1.0 if sub_x >= 1.0 else sub_x
        sub_y = sub_y - 1.0 if sub_y >= 1.0 else sub_y
        u, v = rays[s + 2 * BLOCK], rays[s + 3 * BLOCK]
        lens_x, lens_y = cosine * u - sine * v, sine * u + cosine * v
        step, focus_term = rays[s + 16 * BLOCK], rays[s + 17 * BLOCK]
        slope_x = (left + sub_x) * step - focus_term * lens_x
        slope_y = (top - sub_y) * step - focus_term * lens_y
        m = (
            rays[s + 4 * BLOCK], rays[s + 5 * BLOCK], rays[s + 6 * BLOCK], rays[s + 7 * BLOCK],
            rays[s + 8 * BLOCK], rays[s + 9 * BLOCK], rays[s + 10 * BLOCK], rays[s + 11 * BLOCK],
            rays[s + 12 * BLOCK], rays[s + 13 * BLOCK], rays[s + 14 * BLOCK], rays[s + 15 * BLOCK],
        )  # fmt: skip
        depth, x, y, z = meet(lens_x, lens_y, slope_x, slope_y, m, k, box)
        nearest, texel = hits[s], hits[s + BLOCK]
        nearer = (depth > 0.0) & (depth < nearest)
        hits[s] = depth if nearer else nearest
        at_x, at_y, at_z = hits[s + 2 * BLOCK], hits[s + 3 * BLOCK], hits[s + 4 * BLOCK]
        hits[s + 2 * BLOCK] = x if nearer else at_x
        hits[s + 3 * BLOCK] = y if nearer else at_y
        hits[s + 4 * BLOCK] = z if nearer else at_z
        x, y, z = rotated(r, x, y, z)
        # A point behind the lens in the reference pose has no projection: the focused image has no value for it.
        rest = z + center_z
        scale = 1.0 / (pitch_ratio * rest)
        j = mirror(np.floor((x + center_x) * scale + 0.5 * columns), columns)
        i = mirror(np.floor(0.5 * rows - (y + center_y) * scale), rows)
        found = base + i * columns + j if rest > 0.0 else -1.0
        found = other if other < 0.0 else found
        hits[s + BLOCK] = found if nearer else texel


@njit(cache=True, parallel=True, fastmath={"contract"})
def _accumulate(  # type: ignore[no-untyped-def]
    sums,
    squares,
    order,
    first,
    last,
    points,
    poses,
    coefficients,
    bounds,
    centers,
    rotations,
    textures,
    mappings,
    images,
    light,
    optics,
    seed,
):
    """Add samples first..last (rows, columns) of every pixel to `sums` and, over all channels, `squares`.

    `points` (6, n): position in the pixel, [0, 1), on the disc of the lens in radii of `optics`, ratio of pitch and s0,
    and K; `poses` (objects, 12, n or 1); `light` (5,), or empty.
    """
    rows, columns, channels = sums.shape
    _, lens_radius = optics
    flat = textures.reshape(-1, channels)
    for position in prange(rows):
        row = order[position]
        rays = np.empty((len(poses), 18 * BLOCK))
        hits = np.zeros(5 * BLOCK)
        total, normal = np.empty(channels), np.empty(3)
        for block in range(first[row].min(), last[row].max(), BLOCK):
            stop = min(block + BLOCK, points.shape[1])
            for n in range(len(poses)):  # loops instead of slices: the compiler takes a quarter of the time
                for s in range(block, stop):
                    for k in range(6):
                        rays[n, s - block + (k if k < 4 else 12 + k) * BLOCK] = points[k, s]
                    for k in range(12):
                        rays[n, s - block + (4 + k) * BLOCK] = poses[n, k, s if poses.shape[2] > 1 else 0]
            for column in range(columns):
                begin, end = max(first[row, column], block), min(last[row, column], stop)
                if begin >= end:
                    continue
                state = np.uint64(seed) + np.uint64(3 * (row * columns + column) + 1) * STEP
                angle = 2 * math.pi * uniform(state + STEP + STEP)
                turn = lens_radius * math.cos(angle), lens_radius * math.sin(angle)
                corner = column - 0.5 * columns, 0.5 * rows - row, uniform(state), uniform(state + STEP)
                for s in range(BLOCK):
                    hits[s], hits[s + BLOCK] = np.inf, -1.0
                for n in range(len(poses)):
                    surface = coefficients[n], bounds[n], centers[n], rotations[n]
                    other = -2.0 - n if mappings[n, 0] > 0.0 else 0.0
                    texture = float(n * rows * columns), float(rows), float(columns), other
                    _cast(hits, rays[n], end - block, turn, corner, optics, surface, texture)
                square = 0.0
                for s in range(begin - block, end - block):
                    texel, share = int(hits[s + BLOCK]), 1.0
                    n = -2 - texel if texel < -1 else texel // (rows * columns)
                    x, y, z = hits[s + 2 * BLOCK], hits[s + 3 * BLOCK], hits[s + 4 * BLOCK]
                    if texel < -1 or (texel >= 0 and len(light) > 0):
                        normal_at(normal, x, y, z, coefficients[n])
                    if texel != -1 and len(light) > 0:
                        u, v, m = rays[n, s + 2 * BLOCK], rays[n, s + 3 * BLOCK], rays[n, s + 4 * BLOCK :: BLOCK]
                        lens_x, lens_y = turn[0] * u - turn[1] * v, turn[1] * u + turn[0] * v
                        share = lambert(light, normal, m, lens_x, lens_y, x, y, z)
                    if texel < -1:
                        shade(total, x, y, z, normal, mappings[n], images)
                        for channel in range(channels):
                            value = share * total[channel]
                            sums[row, column, channel] += value
                            square += value * value
                    if texel >= 0:
                        for channel in range(channels):
                            value = share * flat[texel, channel]
                            sums[row, column, channel] += value
                            square += value * value
                squares[row, column] += square


@dataclass(frozen=True)
class Halves:
    """Two independent running sums: `sums` (2, rows, columns, channels) and `squares` (2, rows, columns).

    `counts` (rows, columns): samples in each half so far; `points`: their Sobol points, (n, 5) per half."""

    problem: Problem
    engines: tuple[Any, ...]
    seeds: tuple[int, ...]
    points: tuple[Array, ...]
    sums: Array
    squares: Array
    counts: NDArray[np.int64]


def start(problem: Problem, seed: int) -> Halves:
    """Two empty halves with scramblings of their own."""
    streams = np.random.SeedSequence(seed).spawn(2)
    size = problem.textures.shape[1:]
    return Halves(
        problem,
        tuple(qmc.Sobol(5, scramble=True, rng=np.random.default_rng(stream)) for stream in streams),
        tuple(int(stream.generate_state(1, np.uint64)[0] >> 1) for stream in streams),
        (np.empty((0, 5)), np.empty((0, 5))),
        np.zeros((2, *size)),
        np.zeros((2, *size[:2])),
        np.zeros(size[:2], np.int64),
    )


def extend(halves: Halves, counts: NDArray[np.int64]) -> Halves:
    """Add samples until every pixel has `counts` (rows, columns) in each half."""
    problem, more = halves.problem, int(counts.max()) - len(halves.points[0])
    pairs = zip(halves.engines, halves.points, strict=True)
    points = tuple(np.concatenate([old, new.random(more)]) if more > 0 else old for new, old in pairs)
    sums, squares = halves.sums.copy(), halves.squares.copy()
    own = "velocities", "angular_velocities", "accelerations", "angular_accelerations", "shake"
    group = "group_velocities", "group_angular_velocities"
    moving = problem.zoom is not None or any(np.any(getattr(problem, name)) for name in (*own, *group))
    # Rows in random order, so that threads with a block of rows each have the same work.
    order = np.random.default_rng(0).permutation(len(counts))
    for half in range(2):
        times = problem.start + problem.shutter * (points[half][:, 4] if moving else np.zeros(1))
        ratio, radius, focus = lenses(problem, np.broadcast_to(times, len(points[half])))
        disc = _disc(points[half][:, 2:4]) * (radius / problem.lens_radius)[:, None]
        lens = np.ascontiguousarray(np.column_stack([points[half][:, :2], disc, ratio, focus]).T)
        rotations = problem.rotations.reshape(-1, 9)
        shape = problem.coefficients, problem.bounds, problem.centers, rotations
        light = np.zeros(0) if problem.light is None else problem.light
        looks = problem.textures, problem.mappings, problem.images, light
        optics = problem.pitch_ratio, problem.lens_radius
        span, poses = (
            (halves.counts, counts),
            np.ascontiguousarray(np.moveaxis(inverse_poses(problem, times), 0, -1)),
        )
        _accumulate(sums[half], squares[half], order, *span, lens, poses, *shape, *looks, optics, halves.seeds[half])
    return replace(halves, points=points, sums=sums, squares=squares, counts=counts)


def estimate(halves: Halves) -> tuple[Array, float]:
    """Mean image (rows, columns, channels) and its noise: the RMS of half the difference of the halves."""
    first, second = halves.sums / halves.counts[:, :, None]
    return (first + second) / 2, float(np.sqrt(np.mean((first - second) ** 2)) / 2)


def sample_shares(halves: Halves) -> Array:
    """Share of the full number of samples for each pixel, (rows, columns), a power of two, from a pilot.

    Where the error falls as n^-q, a given mean square error takes the fewest samples for n ~ deviation^(1 /
    (q + 1/2)); q = 0.64 was measured on a textured sphere. The largest deviation of the 3x3 neighborhood
    counts, so that an edge which the pilot missed in one pixel is found from its neighbors.
    """
    count = 2 * halves.counts
    mean = halves.sums.sum(0) / count[:, :, None]
    variance = np.maximum(halves.squares.sum(0) / count - np.sum(mean**2, axis=-1), 0.0)
    padded = np.pad(np.sqrt(variance), 1, mode="edge")
    largest = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
    # Rounding of the sums leaves 1e-8 where nothing varies.
    varied = largest > 1e-6
    if not varied.any():
        return np.zeros(count.shape)
    relative = np.maximum(largest / np.quantile(largest[varied], 0.95), 1e-9) ** (1 / 1.14)
    return np.where(varied, np.exp2(np.minimum(np.round(np.log2(relative)), 0.0)), 0.0)


def _shaped(image: Array, textures: Textures) -> Array:
    """Drop the channel axis where no texture has one."""
    images = [textures] if isinstance(textures, np.ndarray) else textures
    return image if any(item.ndim == 3 for item in images) else image[:, :, 0]


def trace(
    scene: Any, texture: Textures, rows: int, columns: int, samples: int = 256, seed: int = 0, frame: int = 0
) -> tuple[Array, float]:
    """Trace a frame with the same number of samples in every pixel.

    `texture`: linear radiance (rows, columns[, channels]), or a sequence of one per object; `samples`: rays
    per pixel, at least 2, best a power of two. Returns the linear image (rows, columns[, channels]) and its
    noise (RMS, same unit). Raises ValueError as `prepare` does. Validated against closed forms
    (tests/benchmarks/test_raytracer.py) and against Mitsuba 3 (benchmarks/truth/mitsuba_check.py).
    """
    if samples < 2:
        raise ValueError(f"trace: samples must be at least 2, one for each half; got {samples}")
    halves = start(prepare(scene, texture, rows, columns, frame), seed)
    image, noise = estimate(extend(halves, np.full((rows, columns), samples // 2)))
    return _shaped(image, texture), noise


def _cache_file(folder: Path, problem: Problem, noise: float, seed: int) -> Path:
    digest = hashlib.sha256(f"{CACHE_FORMAT} {noise!r} {seed} {MOST_SAMPLES}".encode())
    for field in fields(problem):
        if getattr(problem, field.name) is None:
            continue
        value = np.asarray(getattr(problem, field.name))
        digest.update(f"{field.name} {value.dtype} {value.shape}".encode() + value.tobytes())
    return folder / f"traced_{digest.hexdigest()[:32]}.npz"


def _write_cache(path: Path, image: Array, noise: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
        np.savez_compressed(file, image=image, noise=noise)
    Path(file.name).replace(path)


def trace_converged(
    scene: Any,
    texture: Textures,
    rows: int,
    columns: int,
    noise: float = 2e-4,
    seed: int = 0,
    cache: Path | None = None,
    report: Callable[[str], object] = print,
    frame: int = 0,
) -> tuple[Array, float]:
    """Trace a frame with ever more samples until the RMS noise over it is below `noise`, and report what it took.

    A pilot with samples of its own, which are then thrown away, fixes each pixel's share of the samples: flat
    and empty pixels get few. The shares do not depend on the samples that are averaged, so the estimate stays
    unbiased (Kirk and Arvo 1991). Ends at MOST_SAMPLES per pixel at the latest. `cache`: folder of earlier
    results, keyed by what the scene contains, textures, size, noise and seed. Arguments and result otherwise
    as `trace`.
    """
    problem = prepare(scene, texture, rows, columns, frame)
    path = None if cache is None else _cache_file(cache, problem, noise, seed)
    if path is not None and path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return _shaped(stored["image"], texture), float(stored["noise"])
    began = time.perf_counter()
    pilot_seed, final_seed = (int(word) for word in np.random.SeedSequence(seed).generate_state(2))
    shares = sample_shares(extend(start(problem, pilot_seed), np.full((rows, columns), LEAST_SAMPLES)))
    halves, full, reached = start(problem, final_seed), LEAST_SAMPLES // 2, math.inf
    while reached >= noise and 4 * full <= MOST_SAMPLES:
        full *= 2
        halves = extend(halves, np.maximum(full * shares, LEAST_SAMPLES).astype(np.int64))
        image, reached = estimate(halves)
    mean, seconds = 2 * halves.counts.mean(), time.perf_counter() - began
    report(f"traced {rows} x {columns}: {2 * full} samples, mean {mean:.0f}, {reached:.2e} RMS, {seconds:.1f} s")
    if path is not None:
        _write_cache(path, image, reached)
    return _shaped(image, texture), reached


def pinhole_depth(scene: Any, rows: int, columns: int, times: Sequence[float]) -> Array:
    """Depth (mm) at the pixel centers at `times` (s): (times, rows, columns), inf where nothing is."""
    problem = prepare(scene, np.zeros((rows, columns)), rows, columns)
    x, y = np.arange(columns) - 0.5 * (columns - 1), 0.5 * (rows - 1) - np.arange(rows)
    poses, (ratios, _, _) = inverse_poses(problem, np.asarray(times, float)), lenses(problem, np.asarray(times, float))
    return _pinhole(x, y, ratios, poses, problem.coefficients, problem.bounds)


@njit(cache=True, error_model="numpy")
def _pinhole(x, y, ratios, poses, coefficients, bounds):  # type: ignore[no-untyped-def]
    """Depth of the nearest hit along (x ratio, y ratio, 1) for x (columns,), y (rows,), ratios (times,) and poses
    (times, objects, 12)."""
    depth = np.full((len(poses), len(y), len(x)), np.inf)
    for sample in range(len(poses)):
        for row in range(len(y)):
            for column in range(len(x)):
                for n in range(len(coefficients)):
                    slope_x, slope_y = x[column] * ratios[sample], y[row] * ratios[sample]
                    hit = meet(0.0, 0.0, slope_x, slope_y, poses[sample, n], coefficients[n], bounds[n])
                    if 0.0 < hit[0] < depth[sample, row, column]:
                        depth[sample, row, column] = hit[0]
    return depth
