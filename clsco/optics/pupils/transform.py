"""Diffraction by any aperture: light of a defocused point by Fourier transforms of the pupil (float64, pure).

Lengths are in detector px, Q = wavelength s0 / (D pitch). The amplitude at x is the transform of the pupil, U(x) =
integral of A(l) exp(2 pi i W(l)) exp(-i pi l x / Q) dl, with W = R |l|^2 / (4 Q) plus the wavefront's path / Q. All
wavelengths share the image grid, `parts` samples per px: a window of w px then has M = w / Q samples of the pupil over
its diameter, not necessarily an integer.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.optics.pupils.pupil import Array, Pupil
from clsco.optics.pupils.wavefront import Wavefront

Spectrum = NDArray[np.complex128]
FEWEST, MOST = 512, 2048  # samples of the pupil over its diameter
PER_SLOPE, LEAST_PER_SLOPE = 32.0, 8.0  # samples over the diameter for each wave per radius of the steepest slope
LEAST_PARTS = 4  # least number of samples of the image per px, for the edge of its window


def fast_length(least: float, step: int = 1) -> int:
    """Smallest multiple of `step`, at least `least`, with a fast transform: without prime factors above 5."""
    count = max(ceil(least / step - 1e-9), 1)
    while True:
        quotient = count
        for factor in (2, 3, 5):
            while quotient % factor == 0:
                quotient //= factor
        if quotient == 1:
            return count * step
        count += 1


def image_parts(unit: float, extent: float) -> int:
    """Even number of samples per px that resolves an image by an aperture of radius `extent`, for Q >= `unit` px."""
    return fast_length(max(2.0 * extent / unit, LEAST_PARTS), 2)


def pupil_samples(slope: float, part: float = 1.0) -> float:
    """Samples of the pupil over its diameter for a steepest phase slope in waves per radius.

    part: fraction of the samples that weights to 1e-4 of the light need. Raises SceneError if the phase would change by
    more than 1/4 wave between two of MOST samples, so that light would be misplaced.
    """
    if LEAST_PER_SLOPE * slope > MOST:
        rule = f"must turn the phase by at most 1/4 wave from one of {MOST} samples of the pupil to the next"
        raise SceneError(f"psf: defocus and aberrations {rule}; got {2.0 * slope / MOST:.3g} waves")
    return min(part * max(PER_SLOPE * slope, FEWEST), MOST)


def spot_light(
    opening: Pupil, wavefront: Wavefront, unit: float, radius: float, samples: float, parts: int, width: int
) -> Array:  # fmt: skip
    """Light (parts width, parts width) of a defocused point in cells of 1 / parts px around it, as a fraction of all of
    its light; row 0 on top, the point is at the middle index.

    unit: Q, px; radius: signed blur radius, px; samples: least number of samples of the pupil over its diameter; parts:
    cells per px, see `image_parts`; width: side of the returned light in px, even. The amplitude of a cell at the edge
    of the pupil is its area in the pupil; the square of this amplitude is less than the cell's light, and the missing
    light is outside the window.
    """
    window = fast_length(max(samples * unit, width))
    amplitude, at = _pupil(opening, wavefront, window / unit, unit)
    turn = np.exp(0.5j * np.pi / unit * radius * at * at)
    field = amplitude * turn * turn[:, None]
    count, half = parts * window, parts * width // 2
    for _ in range(2):  # each along rows, which are turned to columns; a shift of the pupil is a phase of the image
        spectrum = np.fft.fft(field, count)
        field = np.ascontiguousarray(np.concatenate([spectrum[:, -half:], spectrum[:, :half]], axis=1).T)
    cells = 0.25 * np.pi * (window / unit) ** 2 * opening.light
    return np.asarray((field.real**2 + field.imag**2) / (cells * count**2))


@lru_cache(maxsize=4)
def _pupil(opening: Pupil, wavefront: Wavefront, samples: float, unit: float) -> tuple[Spectrum | Array, Array]:
    """In-focus amplitude (y, x) in each cell of a grid with `samples` cells over the diameter, for Q = unit px, and the
    cell positions in radii along either axis.
    """
    root = opening.amplitude
    index = np.arange(-ceil(0.5 * samples * opening.extent), ceil(0.5 * samples * opening.extent) + 1.0)
    area = 0.25 * np.pi * samples**2 * root.light
    amplitude = area * root.rows(np.array([0.5 * samples]), index, index, tent=False)[0]
    at = index * (2.0 / samples)
    if wavefront.is_flat:
        return amplitude, at
    return amplitude * np.exp(2j * np.pi / unit * wavefront.path(at, at[:, None])), at


def spectra(light: Array) -> Spectrum:
    """Half spectrum of light (y, x): (frequencies of y, nonnegative frequencies of x)."""
    half = light.shape[1] // 2
    return np.fft.fft(np.fft.rfft(light, axis=1)[:, :half], axis=0)


def pixel_weights(spectrum: Spectrum, width: int, offset: tuple[float, float], tent: bool) -> Array:
    """Light in pixels (width, width) of a source in the middle pixel, at an offset (right, down) px within it.

    spectrum: of light in cells by `spectra`; tent: True for a square source instead of a point. Summing over a pixel's
    response multiplies the spectrum, and sampling at whole pixels folds it.
    """
    response = 2 if tent else 1
    across = np.arange(spectrum.shape[1]) / width
    factor = np.where(across > 0.0, 2.0, 1.0) * np.sinc(across) ** response * np.exp(-2j * np.pi * across * offset[0])
    by_column = np.fft.ifft(_folded(spectrum * factor, width), axis=1).T
    down = np.fft.fftfreq(by_column.shape[1], 1.0 / by_column.shape[1]) / width
    factor = np.sinc(down) ** response * np.exp(-2j * np.pi * down * offset[1])
    return np.ascontiguousarray(np.fft.ifft(_folded(by_column * factor, width), axis=1).real.T)


def _folded(spectrum: Spectrum, width: int) -> Spectrum:
    """Spectrum along rows folded: sums of frequencies that are aliases at whole pixels."""
    return np.asarray(spectrum.reshape(len(spectrum), -1, width).sum(axis=1))
