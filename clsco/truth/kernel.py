"""Rays through the lens, one after another, in float64.

The detector's place x' sees through the lens point l, in radii of the lens, the point of a surface whose slope X / Z is
x, with x' = x + R(Z) l + 2 Q grad W(l), R = (D / 2) (K - 1 / Z) as a slope. So the ray is the straight line X(Z) =
(x' - 2 Q grad W - (D / 2) K l) Z + (D / 2) l, whose parameter is the depth Z itself. K and W that differ over the field
are those of x: the ray is cast anew from the place that it met.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from clsco.truth.images import shade
from clsco.truth.pupils import bend, lens_point

STEP = np.uint64(0x9E3779B97F4A7C15)
REPEATS = 16  # independent estimates of a job, whose differences are its noise


@njit(cache=True, inline="always")
def uniform(state):  # type: ignore[no-untyped-def]
    """A uniform number in [0, 1) of a 64-bit state (the finalizer of splitmix64)."""
    z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 2.0**-53


@njit(cache=True, inline="always")
def _inside(box, x, y, z):  # type: ignore[no-untyped-def]
    """True if a point of the object's frame lies in its bounds."""
    within = (box[0] <= x) & (x <= box[1]) & (box[2] <= y) & (y <= box[3]) & (box[4] <= z) & (z <= box[5])
    return within & (x * x + y * y <= box[6])


@njit(cache=True, inline="always")
def mirror(index, count):  # type: ignore[no-untyped-def]
    """Half-sample mirror reflection of a whole number: -1 -> 0, count -> count - 1. All floating point."""
    # The half keeps the product off whole numbers, where rounding would decide.
    index = index - 2 * count * np.floor((index + 0.5) * (0.5 / count))
    index = index if index < count else 2 * count - 1 - index
    # Infinite, or so large that whole numbers have gaps: any texel.
    index = index if index > 0.0 else 0.0
    return index if index < count else count - 1


@njit(cache=True, inline="always")
def rotated(m, x, y, z):  # type: ignore[no-untyped-def]
    """The vector (x, y, z) times the 3x3 matrix in the first nine elements of `m`."""
    return m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z


@njit(cache=True, inline="always")
def meet(lens_x, lens_y, slope_x, slope_y, m, k, box):  # type: ignore[no-untyped-def]
    """First hit of the ray (lens + slope Z, Z) with a surface: depth, 0 for none, and the point in the object's frame.

    `m`: inverse rotation and center (12); `k`: coefficients (10); `box`: bounds (7). All about the center.
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
    # a Z^2 + 2 b Z + c = 0. The form with q keeps both roots, and the only one where a = 0. Where there
    # is none it is no number or infinite: comparisons refuse both.
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
    """Unit normal (3,) of a quadric at a point."""
    normal[0] = 2 * k[0] * x + k[3] * y + k[5] * z + k[6]
    normal[1] = 2 * k[1] * y + k[3] * x + k[4] * z + k[7]
    normal[2] = 2 * k[2] * z + k[4] * y + k[5] * x + k[8]
    normal /= math.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])


@njit(cache=True)
def lambert(light, normal, m, lens_x, lens_y, x, y, z):  # type: ignore[no-untyped-def]
    """Share of the texture that a point of the object's frame shows to a point of the lens: the cosine between the
    light and that of both normals which the ray comes from. `light` (5): place or direction in the camera's frame,
    whether the former, and the share without it; `m`: as in `meet`."""
    if light[3] > 0.0:
        to_x, to_y, to_z = rotated(m, light[0] - m[9], light[1] - m[10], light[2] - m[11])
        to_x, to_y, to_z = to_x - x, to_y - y, to_z - z
    else:
        to_x, to_y, to_z = rotated(m, light[0], light[1], light[2])
    eye_x, eye_y, eye_z = rotated(m, lens_x - m[9], lens_y - m[10], -m[11])
    seen = (eye_x - x) * normal[0] + (eye_y - y) * normal[1] + (eye_z - z) * normal[2]
    along = to_x * normal[0] + to_y * normal[1] + to_z * normal[2]
    cosine = math.copysign(1.0, seen) * along / math.sqrt(to_x * to_x + to_y * to_y + to_z * to_z)
    return light[4] + (1.0 - light[4]) * max(cosine, 0.0)


@njit(cache=True)
def distorted(x, y, n):  # type: ignore[no-untyped-def]
    """Slopes as the lens shows them, and the derivatives xx, xy, yy of these; n: `Optics.numbers`."""
    square, p1, p2 = x * x + y * y, n[9], n[10]
    q = 1.0 + square * (n[6] + square * (n[7] + square * n[8]))
    rise, along = n[6] + square * (2.0 * n[7] + square * 3.0 * n[8]), 2.0 * (p2 * x + p1 * y)
    xx, yy = q + 2.0 * x * x * rise + along + 4.0 * p2 * x, q + 2.0 * y * y * rise + along + 4.0 * p1 * y
    xy = 2.0 * (x * y * rise + p2 * y + p1 * x)
    return x * q + along * x + p2 * square, y * q + along * y + p1 * square, xx, xy, yy


@njit(cache=True)
def undistorted(x, y, n):  # type: ignore[no-untyped-def]
    """Slopes that the lens shows as x and y, by Newton's method."""
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


@njit(cache=True, inline="always")
def _row(a, i, j):  # type: ignore[no-untyped-def]
    """Twelve numbers as scalars: slices of arrays take longer than what is done with them."""
    return (
        a[i, j, 0], a[i, j, 1], a[i, j, 2], a[i, j, 3], a[i, j, 4], a[i, j, 5],
        a[i, j, 6], a[i, j, 7], a[i, j, 8], a[i, j, 9], a[i, j, 10], a[i, j, 11],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def nearest(left_out, ray, t, shapes, poses):  # type: ignore[no-untyped-def]
    """Depth, number and place of the first surface that a ray meets: infinity and -1 for none. left_out: one that it
    passes; shapes: `Surfaces.shapes`; t: number of the moment."""
    depth, number, x, y, z = np.inf, -1, 0.0, 0.0, 0.0
    for n in range(poses.shape[1]):
        k, box = _row(shapes, 0, n), _row(shapes, 1, n)
        at, px, py, pz = meet(ray[0], ray[1], ray[2], ray[3], _row(poses, t, n), k, box)
        if n != left_out and 0.0 < at < depth:
            depth, number, x, y, z = at, n, px, py, pz
    return depth, number, x, y, z


@njit(cache=True, error_model="numpy")
def _seen(total, normal, left_out, ray, t, n, shapes, mappings, images, light, background, poses, cameras):  # type: ignore[no-untyped-def]
    """Put the radiance (channels,) that a ray (lens x, y, slope x, y) meets in `total`; gives its depth."""
    for channel in range(len(total)):
        total[channel] = 0.0
    depth, shown, x, y, z = nearest(left_out, ray, t, shapes, poses)
    share = 1.0
    if shown >= 0:
        lies, k = mappings[shown, 0] > 0.0, _row(shapes, 0, shown)
        if lies or len(light) > 0:
            normal_at(normal, x, y, z, k)
        if len(light) > 0:
            at = (cameras[t, 9], cameras[t, 10], cameras[t, 11], light[3], light[4])
            share = lambert(at, normal, _row(poses, t, shown), ray[0], ray[1], x, y, z)
        if lies:
            shade(total, x, y, z, normal, mappings[shown], images)
            for channel in range(len(total)):
                total[channel] *= share
            return depth
        rest = _row(shapes, 2, shown)
        x, y, z = rotated(rest, x, y, z)
        x, y, z = x + rest[9], y + rest[10], z + rest[11]
    elif background >= 0 and left_out != background:
        shown = background
        camera = (
            cameras[t, 0], cameras[t, 1], cameras[t, 2], cameras[t, 3], cameras[t, 4], cameras[t, 5], cameras[t, 6],
            cameras[t, 7], cameras[t, 8],
        )  # fmt: skip
        x, y, z = rotated(camera, ray[2], ray[3], 1.0)
    # A projected texture is what the camera sees in the reference pose: squares of one radiance.
    if shown >= 0 and z > 0.0:
        first, rows, columns = mappings[shown, 1], mappings[shown, 2], mappings[shown, 3]
        x, y, _, _, _ = distorted(x / z, y / z, n)
        j = mirror(np.floor(x / n[2] + 0.5 * columns), columns)
        i = mirror(np.floor(0.5 * rows - y / n[2]), rows)
        texel = int(first + i * columns + j)
        for channel in range(len(total)):
            total[channel] = share * images[texel, channel]
    return depth


@njit(cache=True)
def _passes(rims, depth, ray, radius, l, seen, detector):  # type: ignore[no-untyped-def]
    """True if all rims let a ray pass."""
    for k in range(len(rims)):
        d, size = rims[k, 0], rims[k, 1]
        if d > 0.0:
            x, y = ray[0] + d * ray[2], ray[1] + d * ray[3]
            if d >= depth:
                continue
        else:
            way = radius * (1.0 + d * detector)
            x, y = way * l[0] + d * seen[0], way * l[1] + d * seen[1]
        if x * x + y * y > size * size:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _ray(left_out, l, slopes, band, step, lens, n, across, up, field, t, shapes, poses):  # type: ignore[no-untyped-def]
    """The ray through the lens point l to the detector's slopes. Where the lens differs over the field, it is that of
    the place that the ray comes from."""
    at_x, at_y, radius = slopes[0], slopes[1], lens[1]
    corner, sag = 0.5 * math.hypot(n[0] - 1.0, n[1] - 1.0), 0.5 * n[4] * (n[3] / step) ** 2
    wide, high = 0.5 * (n[0] - 1.0) / corner, 0.5 * (n[1] - 1.0) / corner
    ray = (radius * l[0], radius * l[1], 0.0, 0.0)
    for k in range(int(n[17])):
        power, bent_x, bent_y = lens[2] + band, 0.0, 0.0
        if n[17] > 1.0:
            square = at_x * at_x + at_y * at_y
            behind = -sag * square * lens[3]  # by how much the image of a plane lies before the detector, by its way
            power += n[16] * n[5] * (math.sqrt(1.0 + square) - 1.0) + lens[3] * behind / (1.0 + behind)
        if n[18] > 0.0:
            seen_x, seen_y, _, _, _ = distorted(at_x, at_y, n)
            right, above = seen_x / (step * corner), seen_y / (step * corner)
            right, above = max(min(right, wide), -wide), max(min(above, high), -high)
            bent_x, bent_y = bend(l[0], l[1], right, above, across, up, field)
        slope_x = slopes[0] - bent_x / radius - radius * power * l[0]
        slope_y = slopes[1] - bent_y / radius - radius * power * l[1]
        ray = (ray[0], ray[1], slope_x, slope_y)
        if k + 1 < n[17]:
            depth = nearest(left_out, ray, t, shapes, poses)[0]
            at_x, at_y = slope_x + ray[0] / depth, slope_y + ray[1] / depth
    return ray


@njit(cache=True, inline="always")
def _moment(u, column, row, n, quantiles, clock, count):  # type: ignore[no-untyped-def]
    """Number of the moment of a uniform number at a place of the detector."""
    time = u * (len(quantiles) - 1.0)
    i = min(int(time), len(quantiles) - 2)
    time = quantiles[i] + (time - i) * (quantiles[i + 1] - quantiles[i])
    size, line = (n[0], column) if clock[2] > 0.0 else (n[1], row)
    line = min(max(math.floor(line), 0.0), size - 1.0) / max(size - 1.0, 1.0)
    line = 1.0 - line if clock[3] > 0.0 else line
    return min(int((time * clock[0] + line * clock[1]) * count), count - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(sums, jobs, places, numbers, points, span, seed, surfaces, moments, optics):  # type: ignore[no-untyped-def]
    """Add samples span[0]..span[1] of some jobs to `sums` (jobs, REPEATS, channels).

    numbers: those of the jobs that are to go on; `jobs` (jobs, 2): the object that is left out, -1 for none, and one
    that rays are aimed at, -1 for none; `places` (jobs, 5): left, top, width and height of the pixels in px, or half a
    width and a height in mm around a point (3,) of the object's frame, at whose depth rays end; `points` (n, 5): a
    Sobol set over pixel, lens and time.
    """
    n, channels, bands, rims = optics.numbers, sums.shape[2], optics.bands, optics.rims
    opening, rows_of, columns_of = optics.pupil
    across, up, field = optics.wavefront
    shapes, mappings, images, background, light = surfaces
    poses, cameras, lenses, quantiles, clock = moments
    total, without, normal, u = np.empty(channels), np.empty(channels), np.empty(3), np.empty(5)
    for which in range(len(numbers) * REPEATS):
        job, repeat = numbers[which // REPEATS], which % REPEATS
        left_out, aim = jobs[job, 0], jobs[job, 1]
        p0, p1, p2, p3, p4 = places[job, 0], places[job, 1], places[job, 2], places[job, 3], places[job, 4]
        state = np.uint64(seed) + np.uint64(5 * (job * REPEATS + repeat) + 1) * STEP
        shifts = (
            uniform(state), uniform(state + STEP), uniform(state + STEP + STEP), uniform(state + np.uint64(3) * STEP),
            uniform(state + np.uint64(4) * STEP),
        )  # fmt: skip
        for s in range(span[0], span[1]):
            for axis in range(5):
                value = points[s, axis] + shifts[axis]
                u[axis] = value - 1.0 if value >= 1.0 else value
            column, row = p0 + u[0] * p2, p1 + u[1] * p3
            t = _moment(u[4], column, row, n, quantiles, clock, len(poses))
            lens = (lenses[t, 0], lenses[t, 1], lenses[t, 2], lenses[t, 3])
            x, y, weight = lens_point(u[2], u[3], opening, rows_of, columns_of)
            l, radius, weight = (x, y), lens[1], weight * n[15]
            for b in range(len(bands)):
                share, step = weight, lens[0] / bands[b, 0]
                if aim < 0:
                    slopes = undistorted((column - 0.5 * n[0]) * step, (0.5 * n[1] - row) * step, n)
                    ray = _ray(left_out, l, slopes, bands[b, 1], step, lens, n, across, up, field, t, shapes, poses)
                else:
                    m = _row(poses, t, aim)
                    x, y = m[0] * p2 + m[3] * p3 + m[6] * p4 + m[9], m[1] * p2 + m[4] * p3 + m[7] * p4 + m[10]
                    x, y, z = (
                        x + (2 * u[0] - 1) * p0,
                        y + (2 * u[1] - 1) * p1,
                        m[2] * p2 + m[5] * p3 + m[8] * p4 + m[11],
                    )
                    ray = (radius * l[0], radius * l[1], (x - radius * l[0]) / z, (y - radius * l[1]) / z)
                    far = radius * (lens[2] + bands[b, 1] - 1.0 / z)
                    slopes = (x / z + far * l[0], y / z + far * l[1])
                    _, _, xx, xy, yy = distorted(slopes[0], slopes[1], n)
                    share *= 4.0 * p0 * p1 / (z * step) ** 2 * (xx * yy - xy * xy)
                depth = _seen(
                    total, normal, left_out, ray, t, n, shapes, mappings, images, light, background, poses, cameras
                )
                kept = share if _passes(rims, depth, ray, radius, l, slopes, lens[3]) else 0.0
                lost = 0.0
                if aim >= 0:
                    depth = _seen(
                        without, normal, aim, ray, t, n, shapes, mappings, images, light, background, poses, cameras
                    )
                    lost = share if _passes(rims, depth, ray, radius, l, slopes, lens[3]) else 0.0
                dark = 1.0
                if n[11] == 1.0:
                    dark = 1.0 / (1.0 + slopes[0] * slopes[0] + slopes[1] * slopes[1]) ** 2
                elif n[11] == 2.0 and aim < 0:
                    square = ((column - 0.5 * n[0]) ** 2 + (0.5 * n[1] - row) ** 2) / (0.25 * (n[0] ** 2 + n[1] ** 2))
                    dark = 1.0 + square * (n[12] + square * (n[13] + square * n[14]))
                for channel in range(channels):
                    if len(bands) == 1 or channel == b:
                        value = kept * total[channel] - (lost * without[channel] if aim >= 0 else 0.0)
                        sums[job, repeat, channel] += dark * value


@njit(cache=True, nogil=True, error_model="numpy")
def pinhole(depth, label, rows, step, t, surfaces, poses, numbers):  # type: ignore[no-untyped-def]
    """Put depth and number of the surface in the middle of each pixel (rows, columns) of some rows of a frame in
    `depth` and `label`, infinity and -1 for none; t: number of the moment."""
    size, shapes = depth.shape, surfaces.shapes
    for row in range(rows[0], rows[1]):
        for column in range(size[1]):
            x, y = (column - 0.5 * (size[1] - 1)) * step, (0.5 * (size[0] - 1) - row) * step
            x, y = undistorted(x, y, numbers)
            found = nearest(-1, (0.0, 0.0, x, y), t, shapes, poses)
            depth[row, column], label[row, column] = found[0], found[1]
