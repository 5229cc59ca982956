"""Round apertures with wave optics: light of a defocused point in concentric rings around it (float64, pure).

Lengths are in detector px. Q = wavelength s0 / (D pitch) is the unit of diffraction: the first dark ring of the Airy
pattern is at 1.22 Q. The phase at the edge of the opening is W20 = R / (4 Q) waves for blur radius R.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil

import numpy as np

from clsco.optics.pupils.circle import Circle, disc_coverage
from clsco.optics.pupils.diffracted import PANEL_NODES, Diffracted, panel_nodes, panels_of
from clsco.optics.pupils.pupil import Array, Pupil, unit_nodes
from clsco.optics.pupils.ring import Ring

SERIES_UNTIL = 14.0  # argument of J0: its power series below, its asymptotic one above, both to 1e-11
SERIES_TERMS, ASYMPTOTIC_TERMS = 48, 24
CELLS_PER_UNIT = 12  # rings per Q, two samples in each: the light oscillates by 1 / Q per px at most
WIDEST_CELL = 0.01  # px: a pixel's fraction of a ring from a point source has kinks where the ring passes its edges
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)  # nodes in a ring, of equal weights
MOST_SAMPLES = 2**22  # of the transform's kernel, computed at once
DIRECT = 64  # largest number of radii whose weights are not interpolated
PANEL = 0.25  # px of R that one polynomial covers; less if half a period of the oscillations, 2 Q, is shorter


@dataclass(frozen=True)
class HankelDiffracted(Diffracted):
    """Circle or ring without aberrations, see `Diffracted`."""

    STEPS = ((1.6, 2), (0.8, 4), (0.2, 8), (0.05, 16))

    @property
    def inner(self) -> float:
        """Radius of the central obstruction, in radii of the opening."""
        return self.opening.obstruction if isinstance(self.opening, Ring) else 0.0

    @property
    def rim(self) -> float:
        return 1.0 / (1.0 - self.inner)

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        a, b, r = np.broadcast_arrays(np.abs(dx), np.abs(dy), radius if self.signed else np.abs(radius))
        if not a.size:
            return np.zeros(a.shape)
        places, place = np.unique(np.maximum(a, b) + 1j * np.minimum(a, b), return_inverse=True)
        radii, which = np.unique(r, return_inverse=True)
        weights = self._weights if len(radii) <= DIRECT else self._interpolated
        shares = weights(places, radii, tent)
        return np.asarray(shares[place.reshape(a.shape), which.reshape(a.shape)])

    def left_out(self, radius: float) -> float:
        return 1.0 - float(replace(self, keeps=False)._light(np.array([radius])).sum())

    def _weights(self, places: NDArrayComplex, radii: Array, tent: bool) -> Array:
        """Weights (places, radii); places: a + b i for pixels at offsets a >= b >= 0 px."""
        rings, width = _rings(self, radii.tobytes()), cell_width(self.narrowest)
        weights = np.empty((len(places), len(radii)))
        for k, (a, b) in enumerate(zip(places.real.tolist(), places.imag.tolist(), strict=True)):
            first, shares = pixel_rings(a, b, tent, width)
            light = rings[first : first + len(shares)]
            weights[k] = shares[: len(light)] @ light
        return np.maximum(weights, 0.0)

    def _interpolated(self, places: NDArrayComplex, radii: Array, tent: bool) -> Array:
        """Weights, interpolated by polynomials in the blur radius; exact to 1e-9 for Q of 0.1 px or more."""
        panel = min(PANEL, 2.0 * self.narrowest)
        numbers, which, factors = panels_of(radii, panel)
        nodes = panel_nodes(numbers, panel)
        values = self._weights(places, nodes.ravel(), tent).reshape(len(places), -1, PANEL_NODES)
        return np.maximum(np.einsum("prn,rn->pr", values[:, which], factors), 0.0)

    def _light(self, radii: Array) -> Array:
        """Light in each ring (rings, radii)."""
        width, end = cell_width(self.narrowest), np.abs(radii) * self.extent + self.margin
        count = 2 * ceil(0.5 * float(end.max()) / width)
        light = sum(share * round_light(radii, unit, self.inner, width, count) for unit, share in self.bands)
        distance: Array = (np.arange(float(count))[:, None] + 0.5) * width
        return self.within(np.asarray(light), distance, end, distance)


NDArrayComplex = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]


def is_round(opening: Pupil) -> bool:
    """True for an aperture whose light has rotational symmetry."""
    return isinstance(opening, Circle | Ring)


@lru_cache(maxsize=32)
def _rings(pupil: HankelDiffracted, radii: bytes) -> Array:
    """Light in each ring (rings, radii); radii: bytes of an array of float64."""
    return pupil._light(np.frombuffer(radii))


def bessel_j0(x: Array) -> Array:
    """Bessel function J0 of arguments >= 0, to 1e-11."""
    x = np.asarray(x, np.float64)
    small = x < SERIES_UNTIL
    values = np.empty_like(x)
    quarter = -0.25 * x[small] ** 2
    term = total = np.ones_like(quarter)
    for k in range(1, SERIES_TERMS):
        term = term * quarter / (k * k)
        total = total + term
    values[small] = total
    z = x[~small]
    even, odd, power = np.ones_like(z), np.zeros_like(z), np.ones_like(z)
    for k in range(1, ASYMPTOTIC_TERMS):
        power = power * (2 * k - 1) ** 2 / (8.0 * k * z)
        if k % 2:
            odd += power if k % 4 == 3 else -power
        else:
            even += power if k % 4 == 0 else -power
    angle = z - 0.25 * np.pi
    values[~small] = np.sqrt(2.0 / (np.pi * z)) * (even * np.cos(angle) - odd * np.sin(angle))
    return values


def cell_width(unit: float) -> float:
    """Width of the rings for a unit of diffraction Q, px."""
    return min(unit / CELLS_PER_UNIT, WIDEST_CELL)


def round_intensity(r: Array, radii: Array, unit: float, inner: float) -> Array:
    """Light per px^2 around a defocused point, (r, radii), for a total of 1.

    r: distances from the point, px, increasing; radii: signed blur radii, px; unit: Q, px; inner: radius of the central
    obstruction, in radii of the opening, 0 for none. The amplitude is a Hankel transform, U(v) = integral of
    exp(2 pi i W20 t) J0(v sqrt(t)) over t = inner^2 .. 1, with v = pi r / Q, by Gauss-Legendre: its integrand is an
    entire function of t.
    """
    waves = float(np.abs(radii).max(initial=0.0)) / (4.0 * unit)
    range_of_phase = 2.0 * np.pi * waves + np.pi * r[-1] / unit
    nodes, weight = (values * (1.0 - inner**2) for values in unit_nodes(32 + 16 * int(np.ceil(range_of_phase / 48.0))))
    t = inner**2 + nodes
    phase = 2.0 * np.pi / unit * (0.25 * radii * t[:, None])
    real, imaginary = weight[:, None] * np.cos(phase), weight[:, None] * np.sin(phase)
    root, intensity = np.sqrt(t), np.empty((len(r), len(radii)))
    step = max(MOST_SAMPLES // len(t), 1)
    for start in range(0, len(r), step):
        kernel = bessel_j0(np.pi / unit * r[start : start + step, None] * root)
        intensity[start : start + step] = (kernel @ real) ** 2 + (kernel @ imaginary) ** 2
    return intensity * (0.25 * np.pi / unit**2 / (1.0 - inner**2))


def round_light(radii: Array, unit: float, inner: float, width: float, count: int) -> Array:
    """Light in `count` rings `width` px wide, (count, radii); other arguments as for `round_intensity`."""
    r = ((np.arange(count)[:, None] + GAUSS) * width).ravel()
    light = np.pi * width * r[:, None] * round_intensity(r, radii, unit, inner)
    return np.asarray(light[0::2] + light[1::2])


@lru_cache(maxsize=2**15)
def pixel_rings(a: float, b: float, tent: bool, width: float) -> tuple[int, Array]:
    """First ring that overlaps a pixel at (a, b) px, a >= b >= 0, and the fractions of the light of this ring and of
    the following rings that the pixel receives.

    tent: True for a square source instead of a point. Constant light within rings causes an error quadratic in their
    width; the fractions include Richardson's extrapolation from rings twice as wide.
    """
    half = 1.0 if tent else 0.5
    first = int(np.hypot(max(a - half, 0.0), max(b - half, 0.0)) / width) // 2 * 2
    last = (int(np.hypot(a + half, b + half) / width) // 2 + 1) * 2
    edges = np.maximum(np.arange(first, last + 1) * width, 1e-12)
    covered = disc_coverage(np.asarray(a), np.asarray(b), edges, tent)
    covered[0] *= first > 0
    areas = np.pi * width * width * (2.0 * np.arange(first, last) + 1.0)
    fine = np.diff(covered) / areas
    coarse = np.diff(covered[::2]) / (areas[0::2] + areas[1::2])
    return first, (4.0 * fine - np.repeat(coarse, 2)) / 3.0
