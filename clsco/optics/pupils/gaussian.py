"""Gaussian pupil: transmission decreases from the center of the lens, and is cut off at some sigma (float64, pure)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import erf, exp, sqrt
from statistics import NormalDist

import numpy as np

from clsco.optics.pupils.circle import disc_coverage
from clsco.optics.pupils.pupil import Array, Pupil


@dataclass(frozen=True)
class Gaussian(Pupil):
    """Gaussian of standard deviation `sigma` lens radii, cut at `cut` sigma along axes or, if `round`, in a circle."""

    sigma: float
    cut: float
    round: bool = False

    soft, name = True, "gaussian"

    @property
    def separable(self) -> bool:
        return not self.round

    @property
    def lengths(self) -> Mapping[str, float]:
        return {"sigma": self.sigma}

    @property
    def extent(self) -> float:
        """Cut-off along an axis."""
        return self.sigma * self.cut

    @property
    def light(self) -> float:
        """Relative light of the Gaussian, also beyond the unit circle; 1 for sigma = sqrt(1/2) if not cut off."""
        tail = exp(-0.5 * self.cut * self.cut)
        return 2.0 * self.sigma**2 * (1.0 - tail if self.round else erf(self.cut / sqrt(2.0)) ** 2)

    @property
    def second_moment(self) -> float:
        tail = exp(-0.5 * self.cut * self.cut)
        if self.round:
            return self.sigma**2 * (1.0 - 0.5 * self.cut * self.cut * tail / (1.0 - tail))
        inside = 2.0 * NormalDist().cdf(self.cut) - 1.0
        return self.sigma**2 * (1.0 - 2.0 * self.cut * tail / sqrt(2.0 * np.pi) / inside)

    def transmission(self, x: Array, y: Array) -> Array:
        square = x * x + y * y
        size = square if self.round else np.maximum(x * x, y * y)
        return np.asarray(np.where(size <= self.extent**2, np.exp(-0.5 * square / self.sigma**2), 0.0))

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        """Value of `Pupil.share` with a square cut-off; only PSFs sampled at pixel centers have a round one."""
        size = np.abs(radius)
        return self.axis_share(dx, size, tent) * self.axis_share(dy, size, tent)

    def axis_share(self, offset: Array, radius: Array, tent: bool) -> Array:
        """Factor of `share` along one axis."""
        return gaussian_axis(offset, self.sigma * radius, self.cut, tent)

    def cells(self, count: int) -> Array:
        at = np.arange(2.0 * count) + 0.5 - count
        x, y = np.meshgrid(at, at)
        area, spread = disc_coverage(x, y, np.asarray(float(count)), tent=False), self.cut / count
        return np.asarray(area * np.exp(-0.5 * (x * x + y * y) * spread**2))


def gaussian_axis(offset: Array, sigma: Array, cut: float, tent: bool) -> Array:
    """Integral along an axis of a pixel's response at `offset` over a normalized Gaussian cut off at +- cut sigma."""
    offset, sigma = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(np.abs(offset), sigma))

    def mass(position: Array) -> tuple[Array, Array]:
        z = np.clip(position / sigma, -cut, cut)
        probability = 0.5 * np.vectorize(erf, otypes=[float])(z / sqrt(2.0))
        return probability, sigma * np.exp(-0.5 * z * z) / sqrt(2.0 * np.pi)

    total = erf(cut / sqrt(2.0))
    if not tent:
        return np.asarray((mass(offset + 0.5)[0] - mass(offset - 0.5)[0]) / total)
    (p0, g0), (p1, g1), (p2, g2) = (mass(offset + m) for m in (-1.0, 0.0, 1.0))
    rising = (1.0 - offset) * (p1 - p0) - (g1 - g0)
    falling = (1.0 + offset) * (p2 - p1) + (g2 - g1)
    return np.asarray(np.maximum(rising + falling, 0.0) / total)
