"""Diffraction by round apertures: light of a defocused point in concentric rings (float64, pure).

Lengths are in detector px. Q = wavelength s0 / (D pitch) is the unit of diffraction: the first dark ring of the Airy
pattern is at 1.22 Q. The phase at the edge of the opening is W20 = R / (4 Q) waves for blur radius R.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from clsco.optics.pupils.circle import disc_coverage
from clsco.optics.pupils.pupil import Array
from clsco.optics.pupils.quadrature import unit_nodes

SERIES_UNTIL = 14.0  # argument of J0: its power series below, its asymptotic one above, both to 1e-11
SERIES_TERMS, ASYMPTOTIC_TERMS = 48, 24
CELLS_PER_UNIT = 12  # rings per Q, two samples in each: the light oscillates by 1 / Q per px at most
WIDEST_CELL = 0.01  # px: a pixel's fraction of a ring from a point source has kinks where the ring passes its edges
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)  # nodes in a ring, of equal weights
MOST_SAMPLES = 2**22  # of the transform's kernel, computed at once
Path = Callable[[Array], Array]
"""Optical path in px (waves times Q) as a function of t, the squared distance from the lens center in lens radii."""


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


def round_intensity(r: Array, radii: Array, unit: float, inner: float, path: Path) -> Array:
    """Light per px^2 around a defocused point, (r, radii), for a total of 1.

    r: distances from the point, px, increasing; radii: signed blur radii, px; unit: Q, px; inner: radius of the central
    obstruction, in radii of the opening, 0 for none; path: optical path of aberrations. The amplitude is a Hankel
    transform, U(v) = integral of exp(2 pi i W(t)) J0(v sqrt(t)) over t = inner^2 .. 1, with v = pi r / Q, by
    Gauss-Legendre: its integrand is an entire function of t.
    """
    waves = float(np.abs(radii).max(initial=0.0)) / (4.0 * unit)
    bend = float(np.abs(np.gradient(path(np.linspace(0.0, 1.0, 257)), 1.0 / 256)).max()) / unit
    range_of_phase = 2.0 * np.pi * (waves + bend) + np.pi * r[-1] / unit
    nodes, weight = (values * (1.0 - inner**2) for values in unit_nodes(32 + 16 * int(np.ceil(range_of_phase / 48.0))))
    t = inner**2 + nodes
    phase = 2.0 * np.pi / unit * (0.25 * radii * t[:, None] + path(t)[:, None])
    real, imaginary = weight[:, None] * np.cos(phase), weight[:, None] * np.sin(phase)
    root, intensity = np.sqrt(t), np.empty((len(r), len(radii)))
    step = max(MOST_SAMPLES // len(t), 1)
    for start in range(0, len(r), step):
        kernel = bessel_j0(np.pi / unit * r[start : start + step, None] * root)
        intensity[start : start + step] = (kernel @ real) ** 2 + (kernel @ imaginary) ** 2
    return intensity * (0.25 * np.pi / unit**2 / (1.0 - inner**2))


def round_light(radii: Array, unit: float, inner: float, path: Path, width: float, count: int) -> Array:
    """Light in `count` rings `width` px wide, (count, radii); other arguments as for `round_intensity`."""
    r = ((np.arange(count)[:, None] + GAUSS) * width).ravel()
    light = np.pi * width * r[:, None] * round_intensity(r, radii, unit, inner, path)
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
