"""Apertures of lenses, and wavefront errors, as numbers for drawing rays (float64).

A lens point is computed from two uniform numbers: for circles, rings and Gaussians by the inverse distribution
function, for polygons at a uniform angle with the squared edge distance as weight, for images by sums over cells.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import convolve2d

from clsco.files.transfer import decode
from clsco.inputs.resampling import resample
from clsco.inputs.textures import picture_of

Array = NDArray[np.float64]
ROUND, BLADES, CELLS, GAUSSIAN = range(4)
MOST_CELLS, ORDER = 512, 6  # largest side of an aperture image, cells; highest order of a wavefront's polynomials


class Pupil(NamedTuple):
    """The aperture of a lens, as numbers for `lens_point`.

    numbers: kind, squeeze, and data of this kind; rows, columns: running sums over the cells of an image; light: light
    that passes, relative to an open circle.
    """

    numbers: Array
    rows: Array
    columns: Array
    light: float


def pupil_of(scene: Any) -> Pupil:
    """The aperture of a scene's lens."""
    aperture, psf, none = scene.aperture, scene.psf, np.zeros(1)
    squeeze, turn = aperture.squeeze, math.radians(aperture.rotation)
    if psf.model == "gaussian":
        cut = 1.0 - math.exp(-(psf.truncation**2) / 2)
        return Pupil(np.array([GAUSSIAN, squeeze, psf.sigma_ratio, cut]), none, none[None], 1.0)
    if aperture.shape == "image":
        cells = _cells(scene)
        light = float(cells.mean() * 4 / (math.pi * squeeze))
        rows = np.concatenate([[0.0], np.cumsum(cells.sum(axis=1))])
        columns = np.concatenate([np.zeros((len(cells), 1)), np.cumsum(cells, axis=1)], axis=1)
        return Pupil(np.array([CELLS, squeeze, turn, len(cells)]), rows, columns, light)
    if aperture.shape == "polygon":
        half = math.pi / aperture.blades
        middle = math.cos(half)
        rise = aperture.blade_curvature * (1 - middle)
        radius = math.inf if rise == 0 else (math.sin(half) ** 2 + rise**2) / (2 * abs(rise))
        center = middle + rise - math.copysign(radius, rise) if rise else 0.0
        numbers = np.array([BLADES, squeeze, turn, half, middle, center, radius, math.copysign(1.0, rise), 1.0])
        nodes, weights = np.polynomial.legendre.leggauss(64)
        numbers[8] = float(weights @ np.array([_rim(half * node, numbers) ** 2 for node in nodes])) / 2
        return Pupil(numbers, none, none[None], numbers[8] / squeeze)
    inner = {"circle": 0.0, "ring": aperture.obstruction**2}[aperture.shape]  # any other shape is an error
    return Pupil(np.array([ROUND, squeeze, inner]), none, none[None], (1 - inner) / squeeze)


def _cells(scene: Any) -> Array:
    """Transmission (n, n) of the aperture image, 0 outside its inscribed circle, its maximum 1; row 0 on top."""
    picture = picture_of(scene.aperture.inputs()["image"])
    linear = decode(picture.data, picture.color.transfer(scene.image.transfer))
    linear = linear[..., 0] if linear.ndim == 3 else linear
    count = min(len(linear), MOST_CELLS)
    at = ((np.arange(8 * count) + 0.5) / (8 * count) * 2 - 1) ** 2
    inside = (at[:, None] + at <= 1.0).reshape(count, 8, count, 8).mean(axis=(1, 3))
    cells = resample(np.asarray(linear, float), (count, count)) * inside
    return np.asarray(cells / cells.max())


@njit(cache=True)
def _rim(angle, p):  # type: ignore[no-untyped-def]
    """Distance of a blade from the lens center, at an angle relative to the blade's middle."""
    if math.isinf(p[6]):
        return p[4] / math.cos(angle)
    across = p[5] * math.sin(angle)
    return p[5] * math.cos(angle) + p[7] * math.sqrt(max(p[6] * p[6] - across * across, 0.0))


@njit(cache=True)
def lens_point(u, v, p, rows, columns):  # type: ignore[no-untyped-def]
    """Lens point (right, up) in radii, as in the image of a far light, for two uniform numbers; its weight, mean 1."""
    weight, kind, angle = 1.0, int(p[0]), 2.0 * math.pi * v
    if kind == CELLS:
        count, target = len(columns), u * rows[-1]
        i = min(np.searchsorted(rows, target, side="right") - 1, count - 1)
        down = (target - rows[i]) / (rows[i + 1] - rows[i])
        target = v * columns[i, -1]
        j = min(np.searchsorted(columns[i], target, side="right") - 1, count - 1)
        x = 2.0 * (j + (target - columns[i, j]) / (columns[i, j + 1] - columns[i, j])) / count - 1.0
        y = 1.0 - 2.0 * (i + down) / count
        x, y = math.cos(p[2]) * x - math.sin(p[2]) * y, math.sin(p[2]) * x + math.cos(p[2]) * y
        return x / p[1], y, weight
    if kind == ROUND:
        radius = math.sqrt(p[2] + u * (1.0 - p[2]))
    elif kind == GAUSSIAN:
        radius = p[2] * math.sqrt(-2.0 * math.log1p(-u * p[3]))
    else:
        blade = math.floor((angle - p[2]) / (2.0 * p[3]) + 0.5)
        rim = _rim(angle - p[2] - 2.0 * p[3] * blade, p)
        radius, weight = math.sqrt(u) * rim, rim * rim / p[8]
    return radius * math.cos(angle) / p[1], radius * math.sin(angle), weight


@njit(cache=True)
def is_open(x, y, p, columns):  # type: ignore[no-untyped-def]
    """Transmission at the lens point (x, y), not for Gaussians; p, columns: as for `lens_point`."""
    x, kind = p[1] * x, int(p[0])
    away, angle = math.hypot(x, y), math.atan2(y, x)
    if kind == CELLS:
        x, y = away * math.cos(angle - p[2]), away * math.sin(angle - p[2])
        i, j = math.floor(0.5 * (1.0 - y) * len(columns)), math.floor(0.5 * (x + 1.0) * len(columns))
        inside = 0 <= i < len(columns) and 0 <= j < len(columns)
        return columns[i, j + 1] - columns[i, j] if inside else 0.0
    if kind == ROUND:
        return 1.0 if p[2] <= away * away <= 1.0 else 0.0
    blade = math.floor((angle - p[2]) / (2.0 * p[3]) + 0.5)
    return 1.0 if away <= _rim(angle - p[2] - 2.0 * p[3] * blade, p) else 0.0


class Wavefront(NamedTuple):
    """Wavefront errors that bend rays.

    `across` and `up` (7, 7): coefficients, by powers of x and y, of the change of a ray's slope for a lens radius of 1
    mm; `field` (3,): coefficients of W131, W222 and W220, which vary over the frame.
    """

    across: Array
    up: Array
    field: Array


def path_of(psf: Any) -> Array:
    """Wavefront errors (7, 7) that are constant over the frame, in waves of green light by powers of x and y."""
    total, square = np.zeros((ORDER + 1, ORDER + 1)), np.zeros((3, 3))
    square[2, 0] = square[0, 2] = 1.0
    table = psf.zernike.model_dump(exclude_unset=True)
    terms = [(*map(int, name.split(",")), waves) for name, waves in table.items()]
    for n, m, waves in terms:
        size = waves * math.sqrt((1 if m == 0 else 2) * (n + 1))
        around = np.zeros((abs(m) + 1, abs(m) + 1))
        for k in range(abs(m) + 1):  # (x + i y)^m
            part = math.comb(abs(m), k) * 1j**k
            around[abs(m) - k, k] = part.imag if m < 0 else part.real
        for k in range((n - abs(m)) // 2 + 1):
            a, b = (n + abs(m)) // 2 - k, (n - abs(m)) // 2 - k
            part = (-1) ** k * math.factorial(n - k) / math.prod(map(math.factorial, (k, a, b)))
            _add(total, size * part, around, square, b)
    _add(total, psf.seidel.W040, np.ones((1, 1)), square, 2)
    return total


def wavefront_of(scene: Any) -> Wavefront:
    """Wavefront errors of a lens. Rays through l are displaced by 2 Q grad W px, Q = wavelength s0 / (D p): slopes
    change by wavelength / (D / 2) grad W, W in waves of green light.
    """
    total, seidel = path_of(scene.psf), scene.psf.seidel
    powers, scale = np.arange(1.0, ORDER + 1), scene.psf.wavelengths[1] * 1e-6
    across, up = np.zeros_like(total), np.zeros_like(total)
    across[:-1], up[:, :-1] = total[1:] * powers[:, None], total[:, 1:] * powers
    return Wavefront(scale * across, scale * up, scale * np.array([seidel.W131, seidel.W222, seidel.W220]))


def _add(total: Array, size: float, polynomial: Array, square: Array, times: int) -> None:
    """Add a polynomial multiplied by a power of the squared distance."""
    for _ in range(times):
        polynomial = convolve2d(polynomial, square)
    total[: len(polynomial), : len(polynomial)] += size * polynomial


@njit(cache=True)
def bend(x, y, right, up, across_of, up_of, field):  # type: ignore[no-untyped-def]
    """Change (right, up) of the slope of a ray through the lens point (x, y), multiplied by the lens radius in mm.

    x, y: in lens radii; right, up: position in the frame relative to its middle, as a fraction of the distance to a
    corner; other arguments: fields of `Wavefront`.
    """
    bent_x, bent_y, power = 0.0, 0.0, 1.0
    for i in range(len(across_of)):
        sum_x, sum_y = 0.0, 0.0
        for j in range(len(across_of) - 1, -1, -1):
            sum_x, sum_y = sum_x * y + across_of[i, j], sum_y * y + up_of[i, j]
        bent_x, bent_y, power = bent_x + power * sum_x, bent_y + power * sum_y, power * x
    # W131 (h l) l^2 + W222 (h l)^2 + W220 h^2 l^2
    along, square = right * x + up * y, x * x + y * y
    first = field[0] * square + 2.0 * field[1] * along
    second = 2.0 * (field[0] * along + field[2] * (right * right + up * up))
    return bent_x + first * right + second * x, bent_y + first * up + second * y
