"""Apertures of any shape, and lenses with aberrations, by Fourier transforms of the pupil (float64, pure).

Lengths are in detector px, Q = wavelength s0 / (D pitch). The amplitude at x is the transform of the pupil, U(x) =
integral of A(l) exp(2 pi i W(l)) exp(-i pi l x / Q) dl, with W = R |l|^2 / (4 Q) plus the wavefront's path / Q. All
wavelengths share the image grid, `parts` samples per px: a window of w px then has M = w / Q samples of the pupil over
its diameter, not necessarily an integer.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import ceil, floor, log2
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsco.cache import Cache
from clsco.errors import SceneError
from clsco.optics.pupils.diffracted import PANEL_NODES, Diffracted, panel_nodes, panels_of
from clsco.optics.pupils.hankel import is_round
from clsco.optics.pupils.pupil import Array, Pupil
from clsco.optics.pupils.wavefront import Wavefront

Spectrum = NDArray[np.complex128]
FEWEST, MOST = 512, 2048  # samples of the pupil over its diameter
PER_SLOPE, LEAST_PER_SLOPE = 32.0, 8.0  # samples over the diameter for each wave per radius of the steepest slope
LEAST_PARTS = 4  # least number of samples of the image per px, for the edge of its window
RIM_CELLS, RIM_SIGMA = 128, 2  # cells per radius for the measured length of the rim, and their blur in cells
SHORTEST_PANEL, LONGEST_PANEL, PANEL_PER_UNIT = 0.25, 1.0, 6.0  # px of R for a polynomial: limits, and factor of Q
OF_FIELD = 0.5  # fraction of samples of the pupil that a field needs, as blending has larger errors
PLACES = 2**16  # number of distinct positions of sources along an axis of a pixel
SECONDS, PLACE = 2e-9, 16.0  # CPU time of a step of a transform; steps for each position of a source in its pixel
SPOT_BYTES, WEIGHTS_BYTES = 2**27, 2**27
spot_cache, _weights = Cache(SPOT_BYTES), Cache(WEIGHTS_BYTES)


@dataclass(frozen=True)
class FourierDiffracted(Diffracted):
    """Aperture of any shape with an optional wavefront error, see `Diffracted`.

    steepest: largest slope of the path over the frame, px per radius, that buffers must allow for; 0 if it is constant.
    """

    STEPS = ((1.6, 2), (0.45, 4), (0.1, 8), (0.04, 16))
    signed = True
    NODES: ClassVar[int] = PANEL_NODES  # number of nodes of each panel

    wavefront: Wavefront = field(default_factory=Wavefront)
    steepest: float = 0.0

    @property
    def name(self) -> str:
        return super().name if self.wavefront.is_flat else f"{super().name}, aberrations"

    @property
    def rim(self) -> float:
        return _rim(self.opening)

    @property
    def margin(self) -> float:
        """Distance of the cut-off as for a perfect lens, plus the wavefront's ray displacement."""
        return super().margin + 2.0 * self.slope

    @property
    def slope(self) -> float:
        """Largest slope of the path that buffers allow for, px per radius."""
        return max(self.wavefront.slope, self.steepest)

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        right, down, r = np.broadcast_arrays(dx, dy, radius)
        shares = np.zeros(r.shape)
        column, row = np.rint(right), np.rint(down)
        places = np.rint((column - right) * PLACES) + 1j * np.rint((row - down) * PLACES)
        numbers, which, factors = panels_of(r.ravel(), self.panel, self.NODES)
        panels = which.reshape(r.shape)
        for place in np.unique(places):
            for number in np.unique(panels[places == place]):
                mask = (places == place) & (panels == number)
                squares = self._squares(int(numbers[number]), (place.real / PLACES, place.imag / PLACES), tent)
                half = squares.shape[1] // 2
                x, y = column[mask].astype(np.int64), row[mask].astype(np.int64)
                inside = np.maximum(np.abs(x), np.abs(y)) < half
                values = squares[:, np.where(inside, y + half, 0), np.where(inside, x + half, 0)]
                shares[mask] = inside * np.einsum("ns,sn->s", values, factors[mask.ravel()])
        return self._clip(shares)

    def rows(self, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
        column, row = np.rint(dx).astype(np.int64), np.rint(dy).astype(np.int64)
        place = tuple(float(np.rint((at[0] - d[0]) * PLACES) / PLACES) for at, d in ((column, dx), (row, dy)))
        numbers, which, factors = panels_of(radii, self.panel, self.NODES)
        rows = np.zeros((len(radii), len(dy), len(dx)))
        for k, number in enumerate(numbers.tolist()):
            squares = self._squares(number, (place[0], place[1]), tent)
            half = squares.shape[1] // 2
            x, y = np.abs(column) < half, np.abs(row) < half
            values = squares[:, row[y][:, None] + half, column[x] + half]
            rows[np.ix_(which == k, y, x)] = np.tensordot(factors[which == k], values, axes=1)
        return self._clip(rows)

    def _clip(self, weights: Array) -> Array:
        return np.maximum(weights, 0.0)

    def left_out(self, radius: float) -> float:
        return 1.0 - float(replace(self, keeps=False)._light(radius, abs(radius)).sum()) / self._grown

    @property
    def panel(self) -> float:
        """Length in px of R of a panel, the range of one polynomial: a whole number of table intervals."""
        return min(max(2.0 ** floor(log2(PANEL_PER_UNIT * self.narrowest)), SHORTEST_PANEL), LONGEST_PANEL)

    def samples(self, radius: float) -> float:
        """Samples of the pupil over its diameter for a blur radius in px; raises SceneError if too many are needed."""
        slope = (0.5 * abs(radius) * self.extent + self.slope) / self.narrowest
        return pupil_samples(slope, OF_FIELD if self.steepest else 1.0)

    def _squares(self, number: int, place: tuple[float, float], tent: bool) -> Array:
        """Weights (nodes, y, x) at the nodes of a panel, for a source at `place` in its pixel."""
        if number < 0 and self.wavefront.is_flat:  # the blur of R, mirrored in the source
            mirrored = self._squares(-1 - number, (-place[0], -place[1]), tent)
            return np.roll(mirrored[::-1, ::-1, ::-1], 1, axis=(1, 2))
        if (upright := self.upright) != self:
            signs = tuple(-1.0 if turned else 1.0 for turned in self.wavefront.mirrored)
            axes = tuple(axis for axis, sign in zip((2, 1), signs, strict=True) if sign < 0.0)
            squares = upright._squares(number, (signs[0] * place[0], signs[1] * place[1]), tent)
            return np.roll(np.flip(squares, axes), (1,) * len(axes), axes)
        return _weights.get(
            (self, number, place, tent), lambda: self._make_squares(number, place, tent), lambda squares: squares.nbytes
        )

    def _make_squares(self, number: int, place: tuple[float, float], tent: bool) -> Array:
        spots = self._cached_spots(number)
        width = spots.shape[1] // image_parts(self.narrowest, self.extent)
        return np.stack([pixel_weights(spot, width, place, tent) for spot in spots])

    @property
    def _grown(self) -> float:
        """Mean of `Wavefront.grown` over the light of the opening."""
        return _mean_grown(self.opening, self.wavefront) if any(self.wavefront.change) else 1.0

    def _cached_spots(self, number: int) -> NDArray[Any]:
        return spot_cache.get((self, number), lambda: self._spots(number), lambda spots: spots.nbytes)

    @property
    def upright(self) -> FourierDiffracted:
        """The pupil with its wavefront mirrored to an orientation that several positions of the frame share.

        The pupil itself unless its opening is round.
        """
        return replace(self, wavefront=self.wavefront.upright) if is_round(self.opening) else self

    def seconds(self, radius: float, places: int) -> float:
        """Predicted CPU seconds for one node at R = `radius` px, and `places` positions of sources in a pixel."""
        parts, samples = image_parts(self.narrowest, self.extent), self.samples(radius)
        width = 2.0 * (radius * self.extent + self.margin + 2.0)
        count, side = parts * max(samples * self.narrowest, width), parts * width
        rows = (samples * self.extent + side) * len(self.bands)
        return SECONDS * (rows * count * log2(count) + side * side * (log2(side) + PLACE * places))

    def _spots(self, number: int) -> NDArray[Any]:
        """Spectra (nodes, y, x) of the light at the nodes of a panel, for sources at any position in their pixels."""
        nodes = panel_nodes(np.array([number]), self.panel)[0]
        farthest = self.panel * max(abs(number), abs(number + 1))
        return np.stack([spectra(self._light(radius, farthest)) for radius in nodes.tolist()])

    def _light(self, radius: float, farthest: float) -> Array:
        """Light within the margin in cells (y, x) around the source; farthest: |R| for which the size is chosen."""
        parts, samples = image_parts(self.narrowest, self.extent), self.samples(farthest)
        width = fast_length(2.0 * (farthest * self.extent + self.margin + 1.0) + 2.0, 2)
        light = sum(
            share * spot_light(self.opening, self.wavefront, unit, radius, samples, parts, width)
            for unit, share in self.bands
        )
        at = (np.arange(parts * width) - parts * width // 2) / parts
        distance, end = np.hypot(at, at[:, None]), np.asarray(abs(radius) * self.extent + self.margin)
        spread = self.within(np.ravel(light), distance.ravel(), end, np.asarray(1.0)).reshape(distance.shape)
        return spread * self._grown


@lru_cache(maxsize=64)
def _mean_grown(opening: Pupil, wavefront: Wavefront) -> float:
    light = opening.cells(RIM_CELLS)
    at = (np.arange(2.0 * RIM_CELLS) + 0.5 - RIM_CELLS) * (opening.extent / RIM_CELLS)
    return float((light * wavefront.grown(at, at[:, None])).sum() / light.sum())


@lru_cache(maxsize=64)
def _rim(opening: Pupil) -> float:
    """Length of the edges per area, relative to an open circle.

    The squared gradient of an amplitude blurred by a Gaussian integrates to 1 / (2 sigma sqrt(pi)) across an edge of
    any direction; by Parseval's theorem it is a sum over frequencies.
    """
    amplitude = np.pad(opening.amplitude.cells(RIM_CELLS), 8 * RIM_SIGMA)
    bend = (2.0 * np.pi * np.fft.fftfreq(len(amplitude))) ** 2
    squared = bend[:, None] + bend
    spectrum = np.abs(np.fft.fft2(amplitude)) ** 2 * squared * np.exp(-squared * RIM_SIGMA**2)
    length = 2.0 * RIM_SIGMA * np.sqrt(np.pi) * spectrum.sum() / amplitude.size
    return float(0.5 * length / (amplitude**2).sum() * RIM_CELLS / opening.extent)


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
