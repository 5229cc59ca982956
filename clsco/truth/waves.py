"""Light of pixels by wave optics without occlusion and tilt: sums over the pinhole image (float64).

Surfaces are divided into cells smaller than a pixel; the light of a cell of blur radius R spreads by |U|^2, U the
transform of the aperture with the phases of R and of the wavefront errors. Spreads are computed for some radii and
interpolated between these. Light that leaves the window is spread evenly over it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter, minimum_filter

from clsco.truth.kernel import pinhole
from clsco.truth.pixels import labels_at, radius_of
from clsco.truth.problem import Array, Problem
from clsco.truth.pupils import is_open, path_of

FINE = 4  # number of sampled points along a side of a cell of the aperture
RADII_PER_UNIT = 4  # number of computed spreads per Q px of blur radius
FAR, FAR_UNITS, RIM = 30.0, 20.0, 1.2  # the window reaches at least FAR px + FAR_UNITS Q beyond RIM R
TILTED = 0.02  # a surface counts as tilted if R changes by more per px
HIDDEN = 2e-3  # largest share of a pixel's light from tilted surfaces, or from places where surfaces may be hidden


class Cells(NamedTuple):
    """Cells of the frame and of half a `window` in px around it, `parts` x `parts` per pixel; arrays (y, x).

    radius: blur radius, px; shines: mask of cells with light; hidden: mask of cells where surfaces are tilted or may
    hide another; problem: the scene seen by a pinhole; places (n, 5): cells with light, for `accumulate`.
    """

    parts: int
    window: int
    radius: Array
    shines: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    problem: Problem
    places: Array


def unit_of(problem: Problem, wavelength: float) -> float:
    """Unit of diffraction Q = wavelength s0 / (D p) in px, for a wavelength in nm."""
    step, half, *_ = problem.moments.lenses[0]
    return float(1e-6 * wavelength / (2.0 * half * step))


def cells_of(problem: Problem) -> Cells:
    """The cells of a frame."""
    psf, background = problem.scene.psf, problem.surfaces.background
    widest = unit_of(problem, max(psf.wavelengths) + 0.5 * psf.bandwidth)
    depth, label = labels_at(problem, 0)
    far = np.abs(radius_of(problem, depth, 0))[(label >= 0) | (background >= 0)].max(initial=0.0)
    bent = 4.0 * widest * np.abs(path_of(psf)).sum()
    parts, window = 4 if widest < 1.0 else 2, 2 * math.ceil(RIM * far + bent + FAR + FAR_UNITS * widest)
    size = [(count + window) * parts for count in problem.size]
    depth, label, lenses = np.empty(size), np.empty(size, np.int64), problem.moments.lenses.copy()
    lenses[:, 0] /= parts
    pinhole(depth, label, 0, problem.surfaces, problem.moments._replace(lenses=lenses), problem.optics.numbers)
    label = np.where(label < 0, background, label)
    near = minimum_filter(depth, 3)  # cells at an outline have the depth of the surface in a part of the cell
    radius = radius_of(problem, np.where(label < 0, near, depth), 0)
    around = 2 * math.ceil(RIM * far * parts + parts) + 1
    last, first = maximum_filter(label, around), minimum_filter(np.where(label < 0, 2**31, label), around)
    shines = maximum_filter(label, 3) >= 0
    row, column = np.nonzero(shines)
    places = np.full((len(row), 5), 1.0 / parts)
    places[:, 0], places[:, 1], places[:, 4] = column / parts - window // 2, row / parts - window // 2, 0.0
    lenses, numbers = problem.moments.lenses.copy(), problem.optics.numbers.copy()
    lenses[:, 1], numbers[18] = 1e-9, 0.0
    moments, optics = problem.moments._replace(lenses=lenses), problem.optics._replace(numbers=numbers)
    inner = minimum_filter(shines, 3)  # excludes differences across an outline to empty cells
    tilted = (np.hypot(*np.gradient(np.where(shines, radius, 0.0))) * parts > TILTED) & inner
    hidden, pinholes = ((first < last) | tilted) & shines, problem._replace(moments=moments, optics=optics)
    return Cells(parts, window, radius, shines, hidden, pinholes, places)


def spread_light(problem: Problem, cells: Cells, light: Array, error: Array) -> tuple[Array, Array, Array]:
    """Radiance (rows, columns, channels) of a frame, its standard error, and the fraction (rows, columns) of each
    pixel's light from hidden or tilted surfaces; light, error (n, channels): radiance of the cells with light, and its
    standard error.
    """
    psf, parts, channels = problem.scene.psf, cells.parts, light.shape[1]
    radii, count = cells.radius[cells.shines], [next_fast_len(size) for size in cells.radius.shape]
    middles = psf.wavelengths if channels == 3 else psf.wavelengths[1:2]
    finest = unit_of(problem, min(psf.wavelengths) - 0.5 * psf.bandwidth)
    steps = math.ceil(np.ptp(radii) * RADII_PER_UNIT / finest)
    nodes, gap = np.linspace(radii.min(), radii.max(), 1 + steps, retstep=True)
    sums = np.zeros((channels, 3, count[0], count[1] // 2 + 1), complex)
    at, band_weights = np.polynomial.legendre.leggauss(3 if psf.bandwidth else 1)
    for radius in nodes:
        part = np.clip(1.0 - np.abs(radii - radius) / gap, 0.0, 1.0) if gap > 0.0 else np.ones(len(radii))
        for channel in range(channels if part.any() else 0):
            bands = zip(middles[channel] + 0.5 * psf.bandwidth * at, 0.5 * band_weights, strict=True)
            spread = sum(share * _spread(problem, cells, wavelength, float(radius)) for wavelength, share in bands)
            values = light[:, channel], cells.hidden[cells.shines].astype(float), part * error[:, channel] ** 2
            for k, value in enumerate(values):
                sources, weights, index = np.zeros(cells.radius.shape), np.zeros(count), _signed(len(spread))
                sources[cells.shines] = part * value
                weights[np.ix_(index, index)] = spread if k < 2 else spread**2
                sums[channel, k] += np.fft.rfft2(sources, count) * np.fft.rfft2(weights)
    rows, columns = (parts * (np.arange(n) + cells.window // 2) + parts // 2 for n in problem.size)
    mean, hidden, square = np.fft.irfft2(sums, count)[..., rows[:, None], columns].swapaxes(0, 1)
    exposure = np.moveaxis(mean, 0, -1), np.sqrt(np.maximum(np.moveaxis(square, 0, -1), 0.0))
    return *exposure, hidden.max(axis=0)


def _signed(count: int) -> NDArray[np.int64]:
    """Indices 0, 1, .., -2, -1 of `count` elements."""
    return np.rint(np.fft.fftfreq(count, 1.0 / count)).astype(np.int64)


def _spread(problem: Problem, cells: Cells, wavelength: float, radius: float) -> Array:
    """Fraction of a cell's light that a pixel receives, by the cell's position relative to the pixel's middle.

    The indices count cells up and to the left; negative indices wrap around.
    """
    unit, psf, pupil = unit_of(problem, wavelength), problem.scene.psf, problem.optics.pupil
    extent = max(1.0 / problem.scene.aperture.squeeze, 1.0)
    fine = cells.parts * math.ceil(2.0 * extent / unit / cells.parts)  # samples per px, so that there is no aliasing
    count, pitch = cells.window * fine, 2.0 * unit / cells.window
    most = math.ceil(extent / pitch)
    index = np.arange(-most, most + 1)
    x, y, path = index * pitch, -index[:, None] * pitch, path_of(psf)
    waves = radius / (4.0 * unit) * (x * x + y * y)
    for i, j in zip(*np.nonzero(path), strict=True):
        waves += psf.wavelengths[1] / wavelength * path[i, j] * x**i * y**j
    field = np.zeros((count, count), complex)
    amplitude, passed = _amplitude(index, pitch, pupil[0], pupil[2])
    field[np.ix_(index, index)] = amplitude * np.exp(2j * np.pi * waves)
    mean = np.sinc(np.fft.fftfreq(count))  # factor of the amplitude due to averaging over cells of the aperture
    light = np.abs(np.fft.fft2(field) / (mean * mean[:, None])) ** 2 / (passed * count**2)
    light += (1.0 - light.sum()) / count**2
    f = np.fft.fftfreq(count, 1.0 / fine)
    response = np.sinc(f) * np.sinc(f / cells.parts) * np.exp(-1j * np.pi * f / cells.parts)
    weights = np.fft.ifft2(np.fft.fft2(light) * response * response[:, None]).real
    step = fine // cells.parts
    return np.asarray(weights[::step, ::step] * step**2)


@njit(cache=True)
def _amplitude(index, pitch, p, columns):  # type: ignore[no-untyped-def]
    """Amplitude (y, x) in cells of the aperture, the first row on top, and the total light of the cells."""
    amplitude, passed = np.zeros((len(index), len(index))), 0.0
    for i in range(len(index)):
        for j in range(len(index)):
            for k in range(FINE * FINE):
                x = (index[j] + (k % FINE + 0.5) / FINE - 0.5) * pitch
                y = -(index[i] + (k // FINE + 0.5) / FINE - 0.5) * pitch
                part = is_open(x, y, p, columns)
                amplitude[i, j] += math.sqrt(part) / FINE**2
                passed += part / FINE**2
    return amplitude, passed
