"""Rays through the lens, in float64, in blocks of BLOCK, which the compiler vectorizes.

The detector position x' sees, through the lens point l in lens radii, the surface point whose slope X / Z is x, with x'
= x + R(Z) l + 2 Q grad W(l), R = (D / 2) (K - 1 / Z) as a slope. So the ray is the straight line X(Z) = (x' - 2 Q grad
W - (D / 2) K l) Z + (D / 2) l, whose parameter is the depth Z. If K and W vary over the frame, their values at x are
used: the ray is cast again with the values at the point that it met.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from clsco.truth.images import MIRROR, shade, texel
from clsco.truth.pupils import bend, lens_point

STEP = np.uint64(0x9E3779B97F4A7C15)
BLOCK = 64  # number of rays that are cast together, in flat arrays, so that loops over them are vectorized
# Numbers of each ray: lens point in mm, slope, detector's slopes, lens point in radii, two uniform numbers, and weight.
LENS, SLOPE, SEEN, POINT, UNIFORM, WEIGHT, RAY = 0, 2, 4, 6, 8, 10, 11
DEPTH, NUMBER, PLACE, HIT = 0, 1, 2, 5  # numbers of each hit: depth, object or -1, and place in its frame


@njit(cache=True, inline="always")
def uniform(state):  # type: ignore[no-untyped-def]
    """A uniform number in [0, 1) from a 64-bit state (the finalizer of splitmix64)."""
    z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 2.0**-53


@njit(cache=True, inline="always")
def _inside(box, x, y, z):  # type: ignore[no-untyped-def]
    """True if a point in the object's frame is within its bounds."""
    within = (box[0] <= x) & (x <= box[1]) & (box[2] <= y) & (y <= box[3]) & (box[4] <= z) & (z <= box[5])
    return within & (x * x + y * y <= box[6])


@njit(cache=True, inline="always")
def rotated(m, x, y, z):  # type: ignore[no-untyped-def]
    """The vector (x, y, z) times the 3x3 matrix in the first nine elements of `m`."""
    return m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z


@njit(cache=True, inline="always")
def meet(lens_x, lens_y, slope_x, slope_y, m, k, box):  # type: ignore[no-untyped-def]
    """First hit of the ray (lens + slope Z, Z) with a surface: depth, 0 for none, and the point in the object's frame.

    `m`: inverse rotation and center (12); `k`: coefficients (10); `box`: bounds (7), both relative to the center.
    """
    # Back to the object's frame: the ray's parameter stays the depth in the camera at the sampled time.
    ox, oy, oz = rotated(m, lens_x - m[9], lens_y - m[10], -m[11])
    dx, dy, dz = rotated(m, slope_x, slope_y, 1.0)
    a = k[0] * dx * dx + k[1] * dy * dy + k[2] * dz * dz + k[3] * dx * dy + k[4] * dy * dz + k[5] * dx * dz
    cross = k[3] * (ox * dy + oy * dx) + k[4] * (oy * dz + oz * dy) + k[5] * (ox * dz + oz * dx)
    linear = k[6] * dx + k[7] * dy + k[8] * dz
    b = k[0] * ox * dx + k[1] * oy * dy + k[2] * oz * dz + 0.5 * (cross + linear)
    c = k[0] * ox * ox + k[1] * oy * oy + k[2] * oz * oz + k[3] * ox * oy + k[4] * oy * oz + k[5] * ox * oz
    c += k[6] * ox + k[7] * oy + k[8] * oz + k[9]
    # a Z^2 + 2 b Z + c = 0. The form with q gives both roots, and also the only one if a = 0. Missing roots
    # are NaN or infinite, for which the comparisons are False.
    q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
    first, second = c / q, q / a
    low, high = (first if first < second else second), (second if first < second else first)
    good = (low > 0.0) & _inside(box, ox + low * dx, oy + low * dy, oz + low * dz)
    depth = low if good else high
    x, y, z = ox + depth * dx, oy + depth * dy, oz + depth * dz
    good = (depth > 0.0) & (depth < np.inf) & _inside(box, x, y, z)
    return depth if good else 0.0, x, y, z


@njit(cache=True)
def normal_at(normal, x, y, z, k):  # type: ignore[no-untyped-def]
    """Write the unit normal of a quadric at a point to `normal` (3,)."""
    normal[0] = 2 * k[0] * x + k[3] * y + k[5] * z + k[6]
    normal[1] = 2 * k[1] * y + k[3] * x + k[4] * z + k[7]
    normal[2] = 2 * k[2] * z + k[4] * y + k[5] * x + k[8]
    normal /= math.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])


@njit(cache=True)
def lambert(light, normal, m, lens_x, lens_y, x, y, z):  # type: ignore[no-untyped-def]
    """Fraction of the texture's radiance visible from a lens point at a point of the object's frame: the cosine between
    the direction to the light and the normal on the ray's side, mixed with the ambient fraction. `light` (5): position
    or direction in the camera's frame, 1 for a position, and the ambient fraction; `m`: as for `meet`.
    """
    if light[3] > 0.0:
        to_x, to_y, to_z = rotated(m, light[0] - m[9], light[1] - m[10], light[2] - m[11])
        to_x, to_y, to_z = to_x - x, to_y - y, to_z - z
    else:
        to_x, to_y, to_z = rotated(m, light[0], light[1], light[2])
    eye_x, eye_y, eye_z = rotated(m, lens_x - m[9], lens_y - m[10], -m[11])
    facing = (eye_x - x) * normal[0] + (eye_y - y) * normal[1] + (eye_z - z) * normal[2]
    along = to_x * normal[0] + to_y * normal[1] + to_z * normal[2]
    cosine = math.copysign(1.0, facing) * along / math.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
    return light[4] + (1.0 - light[4]) * max(cosine, 0.0)


@njit(cache=True)
def distorted(x, y, n):  # type: ignore[no-untyped-def]
    """Slopes after distortion by the lens, and their derivatives xx, xy, yy; n: `Optics.numbers`."""
    square, p1, p2 = x * x + y * y, n[9], n[10]
    q = 1.0 + square * (n[6] + square * (n[7] + square * n[8]))
    rise, along = n[6] + square * (2.0 * n[7] + square * 3.0 * n[8]), 2.0 * (p2 * x + p1 * y)
    xx, yy = q + 2.0 * x * x * rise + along + 4.0 * p2 * x, q + 2.0 * y * y * rise + along + 4.0 * p1 * y
    xy = 2.0 * (x * y * rise + p2 * y + p1 * x)
    return x * q + along * x + p2 * square, y * q + along * y + p1 * square, xx, xy, yy


@njit(cache=True)
def undistorted(x, y, n):  # type: ignore[no-untyped-def]
    """Slopes that the lens distorts to x and y, by Newton's method."""
    at_x, at_y = x, y
    if n[6] != 0.0 or n[7] != 0.0 or n[8] != 0.0 or n[9] != 0.0 or n[10] != 0.0:
        for _ in range(30):
            seen_x, seen_y, xx, xy, yy = distorted(at_x, at_y, n)
            off_x, off_y, over = x - seen_x, y - seen_y, 1.0 / (xx * yy - xy * xy)
            step_x, step_y = (yy * off_x - xy * off_y) * over, (xx * off_y - xy * off_x) * over
            at_x, at_y = at_x + step_x, at_y + step_y
            if abs(step_x) + abs(step_y) < 1e-14:
                break
    return at_x, at_y


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _keep_nearer(hits, rays, count, number, m, k, box):  # type: ignore[no-untyped-def]
    """Replace each ray's hit by its hit with one surface if this is nearer; `m`: the surface's poses (12 x BLOCK)."""
    # Scalars, since the compiler must assume that stores may change elements of arrays.
    k0, k1, k2, k3, k4, k5, k6, k7, k8, k9 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9]
    x0, x1, y0, y1, z0, z1, across = box[0], box[1], box[2], box[3], box[4], box[5], box[6]
    for s in range(count):
        pose = (
            m[s], m[s + BLOCK], m[s + 2 * BLOCK], m[s + 3 * BLOCK], m[s + 4 * BLOCK], m[s + 5 * BLOCK],
            m[s + 6 * BLOCK], m[s + 7 * BLOCK], m[s + 8 * BLOCK], m[s + 9 * BLOCK], m[s + 10 * BLOCK],
            m[s + 11 * BLOCK],
        )  # fmt: skip
        ray = rays[s], rays[s + BLOCK], rays[s + 2 * BLOCK], rays[s + 3 * BLOCK]
        depth, x, y, z = meet(
            ray[0], ray[1], ray[2], ray[3], pose, (k0, k1, k2, k3, k4, k5, k6, k7, k8, k9),
            (x0, x1, y0, y1, z0, z1, across),
        )  # fmt: skip
        before, which = hits[s], hits[s + BLOCK]
        at_x, at_y, at_z = hits[s + 2 * BLOCK], hits[s + 3 * BLOCK], hits[s + 4 * BLOCK]
        nearer = (depth > 0.0) & (depth < before)
        hits[s] = depth if nearer else before
        hits[s + BLOCK] = number if nearer else which
        hits[s + 2 * BLOCK] = x if nearer else at_x
        hits[s + 3 * BLOCK] = y if nearer else at_y
        hits[s + 4 * BLOCK] = z if nearer else at_z


@njit(cache=True)
def _meet_all(hits, rays, count, left_out, poses, shapes):  # type: ignore[no-untyped-def]
    """Write the first surface that each ray meets to `hits`: depth infinity and number -1 for none. left_out: a surface
    that rays ignore.
    """
    hits[:BLOCK], hits[BLOCK : 2 * BLOCK] = np.inf, -1.0
    for n in range(len(poses)):
        if n != left_out:
            _keep_nearer(hits, rays, count, float(n), poses[n], shapes[0, n], shapes[1, n])


@njit(cache=True)
def _pose(posed, poses, moment, count):  # type: ignore[no-untyped-def]
    """Write the poses of all objects at the moment of each ray to `posed` (objects, 12 x BLOCK)."""
    for n in range(len(posed)):
        for s in range(count):
            t = moment[s]
            for k in range(12):
                posed[n, s + k * BLOCK] = poses[t, n, k]


@njit(cache=True, error_model="numpy")
def _texel(x, y, z, n, mapping):  # type: ignore[no-untyped-def]
    """Index of the texel, a square of constant radiance, that the reference pose's camera sees at a point (x, y, z)."""
    first, rows, columns = int(mapping[1]), int(mapping[2]), int(mapping[3])
    x, y, _, _, _ = distorted(x / z, y / z, n)
    j = texel(math.floor(x / n[2] + 0.5 * columns), columns, MIRROR)
    return first + texel(math.floor(0.5 * rows - y / n[2]), rows, MIRROR) * columns + j


@njit(cache=True)
def _passes(rims, depth, rays, s, radius, detector):  # type: ignore[no-untyped-def]
    """True if ray `s` passes all rims; depth: of its hit; detector: 1/s."""
    for k in range(len(rims)):
        d, size = rims[k, 0], rims[k, 1]
        if d > 0.0:
            x, y = rays[s] + d * rays[s + 2 * BLOCK], rays[s + BLOCK] + d * rays[s + 3 * BLOCK]
            if d >= depth:
                continue
        else:
            width = radius * (1.0 + d * detector)
            x = width * rays[s + POINT * BLOCK] + d * rays[s + SEEN * BLOCK]
            y = width * rays[s + (POINT + 1) * BLOCK] + d * rays[s + (SEEN + 1) * BLOCK]
        if x * x + y * y > size * size:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _add_light(sums, sign, hits, rays, moment, count, posed, left_out, channel, scratch, surfaces, moments, optics):  # type: ignore[no-untyped-def]
    """Add the radiance that rays meet, times `sign` and their weights, to `sums` (channels,); channel: the only one to
    add, or -1 for all.
    """
    shapes, mappings, images, background, light = surfaces
    cameras, lenses, n, rims = moments.cameras, moments.lenses, optics.numbers, optics.rims
    total, normal, m = scratch[0, : len(sums)], scratch[1, :3], scratch[2]
    for s in range(count):
        t, item, share = moment[s], int(hits[s + BLOCK]), sign * rays[s + WEIGHT * BLOCK]
        x, y, z = hits[s + 2 * BLOCK], hits[s + 3 * BLOCK], hits[s + 4 * BLOCK]
        if len(rims) > 0 and not _passes(rims, hits[s], rays, s, lenses[t, 1], lenses[t, 3]):
            continue
        if item < 0:
            if background < 0 or left_out == background:
                continue
            item, camera = background, cameras[t]
            x, y, z = rotated(camera, rays[s + SLOPE * BLOCK], rays[s + (SLOPE + 1) * BLOCK], 1.0)
        else:
            lies = mappings[item, 0] > 0.0
            if lies or len(light) > 0:
                normal_at(normal, x, y, z, shapes[0, item])
            if len(light) > 0:
                at = (cameras[t, 9], cameras[t, 10], cameras[t, 11], light[3], light[4])
                for k in range(12):
                    m[k] = posed[item, s + k * BLOCK]
                share *= lambert(at, normal, m, rays[s], rays[s + BLOCK], x, y, z)
            if lies:
                shade(total, x, y, z, normal, mappings[item], images)
                for c in range(len(sums)):
                    if channel < 0 or channel == c:
                        sums[c] += share * total[c]
                continue
            rest = shapes[2, item]
            x, y, z = rotated(rest, x, y, z)
            x, y, z = x + rest[9], y + rest[10], z + rest[11]
        if z > 0.0:
            texel = _texel(x, y, z, n, mappings[item])
            for c in range(len(sums)):
                if channel < 0 or channel == c:
                    sums[c] += share * images[texel, c]


@njit(cache=True)
def _bend_rays(rays, hits, moment, count, left_out, posed, band, shapes, moments, optics):  # type: ignore[no-untyped-def]
    """Set rays from their lens points to arrive at the detector's slopes, and cast them.

    If the lens varies over the frame, its values at the point from which the ray comes are used.
    """
    n, lenses, (across, up, field) = optics.numbers, moments.lenses, optics.wavefront
    for k in range(int(n[17])):
        for s in range(count):
            t, slopes = moment[s], (rays[s + SEEN * BLOCK], rays[s + (SEEN + 1) * BLOCK])
            step, radius, at_x, at_y = lenses[t, 0] / band[0], lenses[t, 1], slopes[0], slopes[1]
            l_x, l_y = rays[s + POINT * BLOCK], rays[s + (POINT + 1) * BLOCK]
            power, bent_x, bent_y = lenses[t, 2] + band[1], 0.0, 0.0
            if k > 0:
                at_x = rays[s + SLOPE * BLOCK] + rays[s] / hits[s]
                at_y = rays[s + (SLOPE + 1) * BLOCK] + rays[s + BLOCK] / hits[s]
            if n[17] > 1.0:
                square, sag = at_x * at_x + at_y * at_y, 0.5 * n[4] * (n[3] / step) ** 2
                behind = -sag * square * lenses[t, 3]  # a plane's image is this part of s in front of the detector
                power += n[16] * n[5] * (math.sqrt(1.0 + square) - 1.0) + lenses[t, 3] * behind / (1.0 + behind)
            if n[18] > 0.0:
                corner = 0.5 * math.hypot(n[0] - 1.0, n[1] - 1.0)
                wide, high = 0.5 * (n[0] - 1.0) / corner, 0.5 * (n[1] - 1.0) / corner
                slope_x, slope_y, _, _, _ = distorted(at_x, at_y, n)
                right, above = slope_x / (step * corner), slope_y / (step * corner)
                right, above = max(min(right, wide), -wide), max(min(above, high), -high)
                bent_x, bent_y = bend(l_x, l_y, right, above, across, up, field)
            rays[s], rays[s + BLOCK] = radius * l_x, radius * l_y
            rays[s + SLOPE * BLOCK] = slopes[0] - bent_x / radius - radius * power * l_x
            rays[s + (SLOPE + 1) * BLOCK] = slopes[1] - bent_y / radius - radius * power * l_y
        _meet_all(hits, rays, count, left_out, posed, shapes)


@njit(cache=True)
def _aim_rays(rays, count, moment, place, posed, band, moments, optics):  # type: ignore[no-untyped-def]
    """Set rays from their lens points to points in a rectangle around a point of an object, and their weights."""
    p0, p1, p2, p3, p4 = place
    for s in range(count):
        lens, m = moments.lenses[moment[s]], posed[s:]
        step, radius = lens[0] / band[0], lens[1]
        x = m[0] * p2 + m[3 * BLOCK] * p3 + m[6 * BLOCK] * p4 + m[9 * BLOCK]
        y = m[BLOCK] * p2 + m[4 * BLOCK] * p3 + m[7 * BLOCK] * p4 + m[10 * BLOCK]
        z = m[2 * BLOCK] * p2 + m[5 * BLOCK] * p3 + m[8 * BLOCK] * p4 + m[11 * BLOCK]
        x += (2.0 * rays[s + UNIFORM * BLOCK] - 1.0) * p0
        y += (2.0 * rays[s + (UNIFORM + 1) * BLOCK] - 1.0) * p1
        l_x, l_y = rays[s + POINT * BLOCK], rays[s + (POINT + 1) * BLOCK]
        rays[s], rays[s + BLOCK] = radius * l_x, radius * l_y
        rays[s + SLOPE * BLOCK], rays[s + (SLOPE + 1) * BLOCK] = (x - rays[s]) / z, (y - rays[s + BLOCK]) / z
        far = radius * (lens[2] + band[1] - 1.0 / z)
        rays[s + SEEN * BLOCK], rays[s + (SEEN + 1) * BLOCK] = x / z + far * l_x, y / z + far * l_y
        _, _, xx, xy, yy = distorted(rays[s + SEEN * BLOCK], rays[s + (SEEN + 1) * BLOCK], optics.numbers)
        rays[s + WEIGHT * BLOCK] *= 4.0 * p0 * p1 / (z * step) ** 2 * (xx * yy - xy * xy)


@njit(cache=True, inline="always")
def _moment(u, column, row, n, quantiles, clock, count):  # type: ignore[no-untyped-def]
    """Number of the moment that a uniform number u selects at a detector position."""
    time = u * (len(quantiles) - 1.0)
    i = min(int(time), len(quantiles) - 2)
    time = quantiles[i] + (time - i) * (quantiles[i + 1] - quantiles[i])
    size, line = (n[0], column) if clock[2] > 0.0 else (n[1], row)
    line = min(max(math.floor(line), 0.0), size - 1.0) / max(size - 1.0, 1.0)
    line = 1.0 - line if clock[3] > 0.0 else line
    return min(int((time * clock[0] + line * clock[1]) * count), count - 1)


@njit(cache=True)
def _draw(rays, moment, points, span, shifts, place, aimed, moments, optics):  # type: ignore[no-untyped-def]
    """Draw uniform numbers, lens points, moments and weights of rays, for samples span[0] to span[1] - 1."""
    n, (opening, rows_of, columns_of) = optics.numbers, optics.pupil
    times, quantiles, clock = len(moments.poses), moments.quantiles, moments.clock
    for s in range(span[1] - span[0]):
        for axis in range(2):
            value = points[span[0] + s, axis] + shifts[axis]
            rays[s + (UNIFORM + axis) * BLOCK] = value - 1.0 if value >= 1.0 else value
        u, v = points[span[0] + s, 2] + shifts[2], points[span[0] + s, 3] + shifts[3]
        u, v = (u - 1.0 if u >= 1.0 else u), (v - 1.0 if v >= 1.0 else v)
        x, y, weight = lens_point(u, v, opening, rows_of, columns_of)
        column = place[0] + rays[s + UNIFORM * BLOCK] * place[2]
        row = place[1] + rays[s + (UNIFORM + 1) * BLOCK] * place[3]
        moment[s] = 0
        if times > 1:
            w = points[span[0] + s, 4] + shifts[4]
            moment[s] = _moment(w - 1.0 if w >= 1.0 else w, column, row, n, quantiles, clock, times)
        if not aimed and n[11] == 2.0:
            square = ((column - 0.5 * n[0]) ** 2 + (0.5 * n[1] - row) ** 2) / (0.25 * (n[0] ** 2 + n[1] ** 2))
            weight *= 1.0 + square * (n[12] + square * (n[13] + square * n[14]))
        rays[s + POINT * BLOCK], rays[s + (POINT + 1) * BLOCK] = x, y
        rays[s + WEIGHT * BLOCK] = weight * n[15]


@njit(cache=True, nogil=True)
def accumulate(sums, jobs, places, numbers, points, span, seed, surfaces, moments, optics):  # type: ignore[no-untyped-def]
    """Add samples span[0] to span[1] - 1 of some jobs to `sums` (jobs, repeats, channels).

    numbers: indices of the jobs to continue; `jobs` (jobs, 2): object to leave out, and object to aim rays at, -1 for
    none; `places` (jobs, 5): left, top, width and height of the job's pixels in px; if rays are aimed at an object,
    half width and half height in mm of a rectangle, and the point (3,) of the object's frame in its middle; `points`
    (n, 5): a Sobol set over pixel, lens and time.
    """
    n, bands, shapes, poses = optics.numbers, optics.bands, surfaces.shapes, moments.poses
    rays, hits, moment = np.zeros(RAY * BLOCK), np.zeros(HIT * BLOCK), np.zeros(BLOCK, np.int64)
    posed, scratch = np.empty((poses.shape[1], 12 * BLOCK)), np.empty((3, 12))
    weights = np.empty(BLOCK)
    _pose(posed, poses, moment, BLOCK)
    repeats = sums.shape[1]
    for which in range(len(numbers) * repeats):
        job, repeat = numbers[which // repeats], which % repeats
        left_out, aim, place = jobs[job, 0], jobs[job, 1], places[job]
        state = np.uint64(seed) + np.uint64(5 * (job * repeats + repeat) + 1) * STEP
        shifts = (
            uniform(state), uniform(state + STEP), uniform(state + STEP + STEP), uniform(state + np.uint64(3) * STEP),
            uniform(state + np.uint64(4) * STEP),
        )  # fmt: skip
        for first in range(span[0], span[1], BLOCK):
            count = min(BLOCK, span[1] - first)
            _draw(rays, moment, points, (first, first + count), shifts, place, aim >= 0, moments, optics)
            if len(poses) > 1:
                _pose(posed, poses, moment, count)
            weights[:] = rays[WEIGHT * BLOCK : (WEIGHT + 1) * BLOCK]
            for b in range(len(bands)):
                band, channel = (bands[b, 0], bands[b, 1]), b if len(bands) > 1 else -1
                rays[WEIGHT * BLOCK : (WEIGHT + 1) * BLOCK] = weights
                if aim >= 0:
                    at = (place[0], place[1], place[2], place[3], place[4])
                    _aim_rays(rays, count, moment, at, posed[aim], band, moments, optics)
                else:
                    for s in range(count):
                        column = place[0] + rays[s + UNIFORM * BLOCK] * place[2]
                        row = place[1] + rays[s + (UNIFORM + 1) * BLOCK] * place[3]
                        step = moments.lenses[moment[s], 0] / band[0]
                        x, y = undistorted((column - 0.5 * n[0]) * step, (0.5 * n[1] - row) * step, n)
                        rays[s + SEEN * BLOCK], rays[s + (SEEN + 1) * BLOCK] = x, y
                if n[11] == 1.0:
                    for s in range(count):
                        x, y = rays[s + SEEN * BLOCK], rays[s + (SEEN + 1) * BLOCK]
                        rays[s + WEIGHT * BLOCK] /= (1.0 + x * x + y * y) ** 2
                if aim >= 0:
                    _meet_all(hits, rays, count, left_out, posed, shapes)
                else:
                    _bend_rays(rays, hits, moment, count, left_out, posed, band, shapes, moments, optics)
                light = sums[job, repeat]
                _add_light(
                    light, 1.0, hits, rays, moment, count, posed, left_out, channel, scratch, surfaces, moments, optics
                )
                if aim >= 0:  # subtract the light seen without the object
                    _meet_all(hits, rays, count, aim, posed, shapes)
                    _add_light(
                        light, -1.0, hits, rays, moment, count, posed, aim, channel, scratch, surfaces, moments, optics
                    )


@njit(cache=True, nogil=True)
def pinhole(depth, label, t, surfaces, moments, numbers):  # type: ignore[no-untyped-def]
    """Write depth and object at the middle of each pixel to `depth` and `label`, inf and -1 for none; t: the moment."""
    rows, columns = depth.shape
    rays, hits, moment = np.zeros(RAY * BLOCK), np.zeros(HIT * BLOCK), np.full(BLOCK, t)
    posed, step = np.empty((moments.poses.shape[1], 12 * BLOCK)), moments.lenses[t, 0]
    _pose(posed, moments.poses, moment, BLOCK)
    for row in range(rows):
        for first in range(0, columns, BLOCK):
            count = min(BLOCK, columns - first)
            for s in range(count):
                x, y = (first + s - 0.5 * (columns - 1)) * step, (0.5 * (rows - 1) - row) * step
                rays[s + SLOPE * BLOCK], rays[s + (SLOPE + 1) * BLOCK] = undistorted(x, y, numbers)
            _meet_all(hits, rays, count, -1, posed, surfaces.shapes)
            for s in range(count):
                depth[row, first + s], label[row, first + s] = hits[s], int(hits[s + BLOCK])
