"""Means and variances of lens points over the light that a pixel receives from a source (float64, pure).

Visibility tests need them if light through a lens point l does not arrive at R l only, or if the aperture's edge is
neither a circle nor straight. A ray through l arrives R l + 2 grad W px from its source
(`clsco.optics.pupils.wavefront`). Over all rays from a source to a pixel, the mean of l tells through which part of the
lens the pixel sees the source, and the variance how soft an occluder's edge is there. With wavefront errors, light from
several parts of the lens may meet in a pixel, and l does not determine its origin within the source: then there are
means for each of two sheets of rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np
from numpy.typing import NDArray

from clsco.constants import TAP_LANES
from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.pupil import Array, Pupil
from clsco.optics.pupils.wavefront import Wavefront

PLANES = 5  # numbers per pixel
SHEET_PLANES, SHEETS = 10, 2  # numbers per pixel and sheet if rays are bent, and number of sheets
STEPS = 4  # radii per px; between two radii, means are interpolated linearly
EVEN = 4.0  # |R|, px, beyond which there are fewer radii per px
PER_PX, FEWEST, MOST = 3, 24, 128  # rays per px of the blur's radius; least and largest number per radius of the lens
LEAST_LIGHT = 1e-6  # fraction of all light: with more, a pixel has a mean of its own
ROUNDING = 1e-3  # px: rounding errors of positions of sources in their pixels
SPREADINGS = 2  # px by which means are continued beyond the blur
IN_FOCUS = 0.577  # px per lens radius: least scale of a blur
TENT = 6.0  # 1 / variance of the convolution of two pixels, a tent, in px^-2
SPLIT = 3.0  # variances along x plus y, in variances of a tent, above which there are two sheets; 2 for a plain lens
LOPSIDED = (0.3, 0.1)  # asymmetry that decides which of two sheets counts as farther if both are equally far


@dataclass(frozen=True, eq=False)
class RayMeans:
    """Mean lens points by position of the field, blur radius and pixel.

    first: index, by `step_of`, of the first radius; negative radii come first. half_width: farthest pixel from the
    source along an axis, px. scales: (places, radii), px per lens radius of the blur, from its second moments,
    unsigned. means: (places, radii, planes, rows, pitch), rows and columns relative to the source, rows padded with 0.

    Planes: mean x and y of the lens point l (`Wavefront.crossings`), in lens radii; xx, xy and yy of I - s^2 cov(l, l)
    / v, with s the scale and v the variance of a tent. With bent rays, the first plane is the fraction of the light on
    the second sheet. Ten planes for each sheet follow, multiplied by the sheet's fraction of the light: the five planes
    above; mean x and y of o, twice the ray's origin in the source, px; xx, xy and yy of s (cov(o, l) + cov(l, o)) / v.
    """

    first: int
    half_width: int
    scales: Array
    means: Array

    def floats(self) -> NDArray[np.float32]:
        """Layout for kernels: TAP_LANES floats that begin with first, number of radii, half-width and pitch; then for
        each position and radius, its scale TAP_LANES times, and its means.
        """
        places, radii, _, _, pitch = self.means.shape
        head = np.zeros(TAP_LANES)
        head[:4] = self.first, radii, self.half_width, pitch
        scales = np.repeat(self.scales[..., None], TAP_LANES, axis=-1)
        records = np.concatenate([scales, self.means.reshape(places, radii, -1)], axis=-1)
        return np.concatenate([head, records.ravel(), np.zeros(2 * TAP_LANES)]).astype(np.float32)

    def around(self, radius: Array, places: NDArray[np.int64], shares: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """Indices, factors and scales for interpolating the means of n sources.

        Returns indices (n, 2 k) into a list of all means, their factors (n, 2 k), and signed scales (n,). radius:
        signed, px, (n,); places: indices (k, n) of positions of the field, with the blending factors `shares`.
        """
        at = np.clip(step_of(radius) - self.first, 0.0, self.means.shape[1] - 1.0)
        number = np.minimum(at.astype(np.int64), self.means.shape[1] - 2)
        first, above = places * self.means.shape[1] + number, at - number
        numbers = np.concatenate([first, first + 1]).T
        parts = np.concatenate([shares * (1.0 - above), shares * above]).T
        scale = (parts * self.scales.ravel()[numbers]).sum(axis=-1)
        return numbers, parts, np.where(radius < 0.0, -scale, scale)

    def lens_points(self, numbers: NDArray[np.int64], parts: Array, x: Array, y: Array) -> Array:
        """Planes (planes, n) of means at taps x, y (n,) px from sources, given the results of `around`."""
        far, means = self.half_width, self.means.reshape(-1, *self.means.shape[2:])
        left, top = (np.floor(at + ROUNDING) for at in (x, y))
        column, row = (np.clip(at, -far, far - 1).astype(np.int64)[:, None] + far for at in (left, top))
        planes = np.zeros((means.shape[1], len(x)))
        for i, below in enumerate((1.0 - (y - top), y - top)):
            for j, beside in enumerate((1.0 - (x - left), x - left)):
                for axis in range(len(planes)):
                    planes[axis] += below * beside * (parts * means[numbers, axis, row + i, column + j]).sum(axis=-1)
        return planes


def step_of(radius: Array) -> Array:
    """Fractional index of signed blur radii in px, 0 for R = 0; beyond EVEN px, steps grow as the root of |R|."""
    size = np.abs(radius)
    return np.copysign(STEPS * np.where(size > EVEN, 2.0 * np.sqrt(EVEN * size) - EVEN, size), radius)


def has_ray_means(psf: PointSpread) -> bool:
    """True if lens points do not follow from positions in the blur alone."""
    return psf.pupil.bends_rays or not (psf.diffracted or psf.pupil.has_plain_rim)


def _planes(psf: PointSpread) -> int:
    return 1 + SHEETS * SHEET_PLANES if psf.pupil.bends_rays else PLANES


def ray_floats(psf: PointSpread, largest: float) -> int:
    """Number of floats in `RayMeans.floats` for |blur radii| up to `largest` px."""
    half_width = _half_width(psf, largest)
    rows, radii = 2 * half_width + 1, len(_steps(psf, largest))
    return 3 * TAP_LANES + len(psf.places) * radii * (TAP_LANES + _planes(psf) * rows * _pitch(half_width))


@lru_cache(maxsize=8)
def ray_means(psf: PointSpread, largest: float) -> RayMeans:
    """Mean lens points for |blur radii| up to `largest` px."""
    from clsco.optics.pupils.traced import Traced

    half_width, steps = _half_width(psf, largest), np.array(_steps(psf, largest))
    radii, wide = steps / STEPS, np.abs(steps) / STEPS > EVEN
    radii[wide] *= (np.abs(radii[wide]) + EVEN) ** 2 / (4.0 * EVEN * np.abs(radii[wide]))
    shape = len(psf.places), len(radii)
    scales, means = np.zeros(shape), np.zeros((*shape, _planes(psf), 2 * half_width + 1, _pitch(half_width)))
    for k, place in enumerate(psf.places):
        opening, wavefront = place.pupil, Wavefront()
        if isinstance(opening, Traced):
            wavefront, opening = opening.wavefront, opening.opening
        for n, radius in enumerate(radii.tolist()):
            scales[k, n], planes = _means(opening, wavefront, radius, half_width, psf.pupil.bends_rays)
            means[k, n, :, :, : 2 * half_width + 1] = planes
    return RayMeans(int(steps[0]), half_width, scales, means)


def _steps(psf: PointSpread, largest: float) -> range:
    """Indices, by `step_of`, of blur radii up to `largest` px and `PointSpread.most`, and one more at each end."""
    before, last = (ceil(float(step_of(np.asarray(max(min(largest, most), 0.0))))) + 1 for most in psf.most)
    return range(-before, last + 1)


def _half_width(psf: PointSpread, largest: float) -> int:
    return psf.reach(largest) + SPREADINGS


def _pitch(half_width: int) -> int:
    return (-(-(2 * half_width + 1) // TAP_LANES) + 1) * TAP_LANES


def _means(opening: Pupil, wavefront: Wavefront, radius: float, half_width: int, bent: bool) -> tuple[float, Array]:
    """Scale of a blur, and planes (planes, rows, columns) of means for square sources: a ray lights four pixels."""
    from clsco.optics.pupils.traced import bends, lens_points

    reach = abs(radius) * opening.extent + 2.0 * wavefront.slope
    count = min(max(ceil(PER_PX * reach), FEWEST), MOST)
    (x, y, light), (right, down, *_) = lens_points(opening, count), bends(opening, wavefront, count)
    light = light * wavefront.grown(x, y)
    at_x, at_y, side = radius * x + right, radius * y + down, 2 * half_width + 1
    column, row = (np.clip(np.floor(at), -half_width, half_width - 1).astype(np.int64) for at in (at_x, at_y))
    below, beside = np.array([[0], [0], [1], [1]]), np.array([[0], [1], [0], [1]])
    cells = (row + half_width + below) * side + column + half_width + beside
    aside = [cell + step - at for at, cell, step in ((at_x, column, beside), (at_y, row, below))]
    pixel_light = light * np.maximum(1.0 - np.abs(aside[0]), 0.0) * np.maximum(1.0 - np.abs(aside[1]), 0.0)
    spread = [float((light * at * at).sum() - (light * at).sum() ** 2) for at in (at_x, at_y, x, y)]
    scale = max(((spread[0] + spread[1]) / (spread[2] + spread[3])) ** 0.5, IN_FOCUS)
    x, y = wavefront.crossings(x, y)
    values: list[Array] = [np.ones_like(x), x, y, x * x, x * y, y * y]
    sums = _sums(cells, pixel_light, values, side * side)
    if bent:
        beyond = _second_sheet(cells, pixel_light, values, sums, SPLIT / (TENT * scale * scale))
        values += [*aside, 2.0 * x * aside[0], x * aside[1] + y * aside[0], 2.0 * y * aside[1]]
        sums = _sums(cells + side * side * beyond, pixel_light, values, SHEETS * side * side)
    sums = sums.reshape(len(sums), -1, side, side).swapaxes(0, 1)
    light_sum = sums[:, 0].sum(axis=0)
    weight = np.where(light_sum > LEAST_LIGHT, light_sum, 0.0)
    sheets = []
    for part, *sheet in sums:
        means = np.stack(sheet) * (part > 0.0) / np.where(part > 0.0, part, 1.0)
        if bent:
            for k, (a, b) in enumerate(((0, 0), (0, 1), (1, 1)), 7):
                means[k] -= means[a] * means[5 + b] + means[b] * means[5 + a]
            means[7:] *= TENT * scale
        for k, (a, b) in enumerate(((0, 0), (0, 1), (1, 1)), 2):
            means[k] = (a == b) - TENT * scale * scale * (means[k] - means[a] * means[b])
        if bent:
            means *= part / np.where(weight > 0.0, weight, 1.0)
        sheets.append(means)
    seconds = [sums[1, :1] / np.where(weight > 0.0, weight, 1.0)] if bent else []
    planes = np.concatenate(seconds + sheets) * (weight > 0.0)
    for _ in range(SPREADINGS):
        around = [_neighbors(plane * (weight > 0.0)) for plane in (*planes, np.ones_like(weight))]
        planes = np.where(weight > 0.0, planes, np.stack(around[:-1]) / np.maximum(around[-1], 1.0))
        weight = np.maximum(weight, around[-1] > 0.0)
    return scale, planes


def _sums(cells: NDArray[np.int64], light: Array, values: list[Array], count: int) -> Array:
    """Sums (values, count) of values times light in each of `count` cells; cells: cell of each ray."""
    return np.stack([np.bincount(cells.ravel(), (light * value).ravel(), count) for value in values])


def _second_sheet(
    cells: NDArray[np.int64], light: Array, values: list[Array], sums: Array, most: float
) -> NDArray[np.bool_]:
    """Mask of rays on the second sheet of their cells.

    If the variance of lens points in a cell exceeds `most`, these are the rays beyond the mean along the axis of
    largest variance, on the side farther from the lens center.
    """
    _, x, y, xx, _, yy = values
    at_x, at_y, square_x, product, square_y = sums[1:] / np.where(sums[0] > 0.0, sums[0], 1.0)
    square_x, product, square_y = square_x - at_x * at_x, product - at_x * at_y, square_y - at_y * at_y
    angle = 0.5 * np.arctan2(2.0 * product, square_x - square_y)
    away = xx + yy + LOPSIDED[0] * x + LOPSIDED[1] * y
    along = (x - at_x[cells]) * np.cos(angle)[cells] + (y - at_y[cells]) * np.sin(angle)[cells]
    farther = np.bincount(cells.ravel(), (light * along * away).ravel(), len(angle))
    return np.asarray((square_x + square_y > most)[cells] & (along * np.sign(farther)[cells] > 0.0))


def _neighbors(plane: Array) -> Array:
    """Sum of each pixel of a plane and its neighbors."""
    padded = np.pad(plane, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])
