"""Point spread functions of a thin lens: weights in closed form and their tables (float64, pure).

A weight is the share of one source's energy that one detector pixel gets. The closed forms are exact; the tables
hold the same weights as piecewise cubics in the blur radius, which is what a device reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, erf, exp, floor, pi, sqrt
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsco.optics import polygon
from clsco.scene.model import Psf

Array = NDArray[np.float64]
MOST_SHAPES = 256  # that are kept
MINIMUM_BLUR = 0.5  # px; sampled PSFs leave smaller radii alone (thesis, 2.2)


Kind = Literal["disc", "separable", "symmetric", "general"]
Mask = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class PsfShape:
    """Properties of a PSF's weights: all that methods and kernels ask of it, from `shape_of`.

    Attributes
    ----------
    kind : str
        "disc": every covered pixel gets the same (the sampled pillbox), so no table is needed. "separable": a weight is
        the product of one along each axis (Gaussians cut at a square). "symmetric": the octants are alike. "general":
        nothing is alike; whole rows of weights, for single sources.
    extent : float
        Distance at which the PSF of R = 1 px ends, px; so it is the radius of the lens that it stands for, in aperture
        radii, as a ray through lens point l arrives at offset R l.
    sampled : bool
        Weights are taken at pixel centers, and jump where R passes one.
    soft : bool
        The PSF falls off towards its rim, instead of ending there (a Gaussian).
    second_moment : float
        Per axis, of R = 1 px, without what `pixel_moment` adds; px^2.
    pixel_moment : float
        Moment that the pixels of source and detector add to it per axis, px^2.
    mask : tuple of (x, y, distance)
        Edges of the opening of "general", see `clsco.optics.polygon.lens_mask`; empty for a circle.
    name : str
        For reports.
    """

    kind: Kind
    extent: float
    sampled: bool
    soft: bool
    second_moment: float
    pixel_moment: float
    mask: Mask
    name: str

    @property
    def signed(self) -> bool:
        """True if the weights of -R differ from those of R."""
        return self.kind == "general"

    @property
    def lens_mask(self) -> Array:
        """`mask` as an array (edges, 3), x to the right and y down."""
        return np.array(self.mask, np.float64).reshape(-1, 3)

    def is_sharp(self, largest: float) -> bool:
        """True if the PSF of the |blur radius| `largest` px is 1 in its own pixel and 0 elsewhere."""
        if self.sampled:
            return largest < MINIMUM_BLUR or self.extent * largest < 1.0
        area_only = self.pixel_moment < PIXEL_MOMENT["integrated"]
        return largest == 0.0 or (area_only and self.extent * largest <= 0.5)


PIXEL_MOMENT = {"sampled": 0.0, "area": 1 / 12, "integrated": 1 / 6}  # px^2 per axis: what `edge` adds


def _second_moment(psf: Psf) -> float:
    if psf.aperture.shape != "circle":
        return (2.0 + cos(2.0 * pi / psf.aperture.blades)) / 12.0
    if psf.model == "pillbox":
        return 0.25
    cut = psf.truncation
    if psf.edge == "sampled":  # cut off at a circle
        lost = exp(-0.5 * cut * cut)
        return psf.sigma_ratio**2 * (1.0 - 0.5 * cut * cut * lost / (1.0 - lost))
    inside = 2.0 * NormalDist().cdf(cut) - 1.0  # at a square
    return psf.sigma_ratio**2 * (1.0 - 2.0 * cut * exp(-0.5 * cut * cut) / sqrt(2.0 * pi) / inside)


_shapes: dict[int, tuple[Psf, PsfShape]] = {}
"""By the identity of a PSF, as it is asked for hundreds of times in a rendering, and comparing models takes longer."""


def shape_of(psf: Psf) -> PsfShape:
    """The `PsfShape` of a PSF and its aperture."""
    known = _shapes.get(id(psf))
    if known is None or known[0] is not psf:
        if len(_shapes) > MOST_SHAPES:
            _shapes.clear()
        known = _shapes[id(psf)] = psf, _shape_of(psf)
    return known[1]


def _shape_of(psf: Psf) -> PsfShape:
    sampled, gaussian, mask = psf.edge == "sampled", psf.model == "gaussian", Mask()
    kind: Kind = "symmetric"
    name = f"{psf.model}, {psf.edge}"
    if psf.aperture.shape != "circle":
        kind, name = "general", f"{name}, {psf.aperture.blades} blades"
        mask = tuple((float(x), float(y), float(distance)) for x, y, distance in _edges(psf))
    elif gaussian and not sampled:
        kind = "separable"
    elif sampled and not gaussian:
        kind = "disc"
    extent = psf.sigma_ratio * psf.truncation if gaussian else 1.0
    return PsfShape(kind, extent, sampled, gaussian, _second_moment(psf), PIXEL_MOMENT[psf.edge], mask, name)


def _edges(psf: Psf) -> Array:
    return polygon.lens_mask(psf.aperture.blades, psf.aperture.rotation)


def _corners(psf: Psf) -> Array:
    return polygon.vertices(psf.aperture.blades, psf.aperture.rotation)


def _ramp_pieces(b: Array, level: Array, sign: float, tent: bool) -> tuple[Array, Array, Array]:
    """Coefficients of 1, h, h^2 of the running integral of the pixel's response at u = sign h - b.

    `level` is u at a point inside the piece that is meant.
    """
    one, zero = np.ones_like(b), np.zeros_like(b)
    if not tent:
        inside = np.abs(level) < 0.5
        return np.where(inside, 0.5 - b, np.where(level > 0, one, zero)), np.where(inside, sign, zero), zero
    lower = (level > -1) & (level <= 0)
    upper = (level > 0) & (level < 1)
    constant = np.where(
        lower, 0.5 * (1 - b) ** 2, np.where(upper, 1 - 0.5 * (1 + b) ** 2, np.where(level > 0, one, zero))
    )
    linear = np.where(lower, sign * (1 - b), np.where(upper, sign * (1 + b), zero))
    square = np.where(lower, 0.5, np.where(upper, -0.5, zero))
    return constant, linear, square


def disc_coverage(dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
    """Integral over a disc at the origin of the response of a pixel at (dx, dy), in px^2.

    dx, dy, radius > 0: px, broadcast against each other. tent=False: the unit square (area of the disc in the
    pixel); tent=True: the square convolved with itself (the disc between a square source and a square
    detector). Closed form: along each chord the response integrates to a quadratic in the chord's half-length
    h = sqrt(R^2 - x^2); the integrals over x of 1, h, h^2 and x times these are elementary between breakpoints.
    Validated against adaptive quadrature to 1e-10; sums over the integers to pi R^2.
    """
    a, b, r = np.broadcast_arrays(np.abs(dx), np.abs(dy), radius)
    a, b, r = (np.asarray(v, dtype=np.float64) for v in (a, b, r))
    half = 1.0 if tent else 0.5
    far = np.hypot(a + half, b + half)
    near = np.hypot(np.maximum(a - half, 0), np.maximum(b - half, 0))
    result = np.where(far <= r, 1.0, 0.0)
    ring = (near < r) & (far > r)
    if ring.any():
        result[ring] = _ring_coverage(a[ring], b[ring], r[ring], tent)
    return result


def _ring_coverage(a: Array, b: Array, r: Array, tent: bool) -> Array:
    """disc_coverage for 1-D arrays of pixels that the circle crosses."""
    knots = (-1.0, 0.0, 1.0) if tent else (-0.5, 0.5)
    crossings = [np.sqrt(np.maximum(r * r - (b + m) ** 2, 0.0)) for m in knots]
    edges = [a + m for m in knots] + crossings + [-c for c in crossings]
    low, high = np.maximum(a + knots[0], -r), np.minimum(a + knots[-1], r)
    x = np.sort(np.clip(np.stack(edges), low, high), axis=0)
    h = np.sqrt(np.maximum((r - x) * (r + x), 0.0))
    chord = 0.5 * (x * h + r * r * np.arcsin(np.clip(x / r, -1.0, 1.0)))
    antiderivative = (x, x * x / 2, chord, -(h**3) / 3, r * r * x - x**3 / 3, r * r * x * x / 2 - x**4 / 4)
    ones, xs, hs, xhs, hhs, xhhs = (np.diff(v, axis=0) for v in antiderivative)
    middle = 0.5 * (x[1:] + x[:-1])
    h_middle = np.sqrt(np.maximum((r - middle) * (r + middle), 0.0))
    top = _ramp_pieces(np.broadcast_to(b, middle.shape), h_middle - b, 1.0, tent)
    bottom = _ramp_pieces(np.broadcast_to(b, middle.shape), -h_middle - b, -1.0, tent)
    c0, c1, c2 = (t - u for t, u in zip(top, bottom, strict=True))
    if tent:
        slope = np.where(middle < a, 1.0, -1.0)
        level = 1.0 - slope * a
        pieces = level * (c0 * ones + c1 * hs + c2 * hhs) + slope * (c0 * xs + c1 * xhs + c2 * xhhs)
    else:
        pieces = c0 * ones + c1 * hs
    return np.asarray(np.maximum(pieces.sum(axis=0), 0.0))


def _gaussian_axis(offset: Array, sigma: Array, cut: float, tent: bool) -> Array:
    """Integral of the pixel's response at `offset` over a unit Gaussian cut at +- cut sigma, along one axis."""
    offset, sigma = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(np.abs(offset), sigma))

    def mass(position: Array) -> tuple[Array, Array]:
        z = np.clip(position / sigma, -cut, cut)
        probability = 0.5 * np.vectorize(erf, otypes=[float])(z / sqrt(2.0))
        return probability, sigma * np.exp(-0.5 * z * z) / sqrt(2.0 * np.pi)

    whole = erf(cut / sqrt(2.0))
    if not tent:
        return np.asarray((mass(offset + 0.5)[0] - mass(offset - 0.5)[0]) / whole)
    (p0, g0), (p1, g1), (p2, g2) = (mass(offset + m) for m in (-1.0, 0.0, 1.0))
    rising = (1.0 - offset) * (p1 - p0) - (g1 - g0)
    falling = (1.0 + offset) * (p2 - p1) + (g2 - g1)
    return np.asarray(np.maximum(rising + falling, 0.0) / whole)


def psf_extent(psf: Psf, radius: Array | float) -> Array:
    """Distance in px at which the PSF of |blur radius| `radius` px ends: the radius, or the cut of the Gaussian."""
    return np.asarray(radius) * shape_of(psf).extent


def reach(psf: Psf, radius: float, subpixel: bool = False) -> int:
    """Largest |dx| or |dy| in px of a pixel that a source of blur radius `radius` px may light."""
    return int(reaches(psf, np.array([radius]), subpixel)[0])


def reaches(psf: Psf, radii: Array, subpixel: bool = False) -> NDArray[np.int64]:
    """`reach` of each of several radii."""
    extent = psf_extent(psf, radii)
    if psf.edge == "sampled" and not subpixel:
        found = np.where(radii >= MINIMUM_BLUR, np.floor(extent), 0.0)
    else:
        beyond = 1.0 if subpixel or psf.edge == "integrated" else 0.5
        found = np.maximum(np.ceil(extent + beyond) - 1.0, 0.0)
    return found.astype(np.int64)


def weights(psf: Psf, dx: Array, dy: Array, radius: Array) -> Array:
    """Share of a source's energy at integer offsets (dx, dy) px for blur radius `radius` px; sums to 1.

    The three broadcast; the sign of the radius matters where the shape is `signed`. Pillbox (2.26), through
    its aperture, and Gaussian (2.27, sigma = sigma_ratio R) in the `edge` forms of the
    scene file. A radius of 0 is the limit: all energy stays. Validated: energy 1 to 1e-12, quadrature, continuity.
    """
    if shape_of(psf).kind == "general":
        return _polygon_weights(psf, dx, dy, np.asarray(radius, np.float64), psf.edge == "integrated")
    dx, dy, r = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(dx, dy, np.abs(radius)))
    if psf.edge == "sampled":
        return _sampled_weights(psf, dx, dy, r)
    center = ((dx == 0) & (dy == 0)).astype(np.float64)
    tiny = r < 1e-9
    safe = np.where(tiny, 1.0, r)
    tent = psf.edge == "integrated"
    if psf.model == "pillbox":
        share = disc_coverage(dx, dy, safe, tent) / (np.pi * safe * safe)
    else:
        share = axis_weights(psf, dx, safe) * axis_weights(psf, dy, safe)
    return np.where(tiny, center, share)


def _polygon_weights(psf: Psf, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
    return polygon.polygon_share(_corners(psf), dx, dy, radius, tent)


def polygon_rows(psf: Psf, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
    """Weights (radii, dy, dx) of a polygon for positive radii, where dx and dy rise by 1 px."""
    return polygon.polygon_grid(_corners(psf), radii, dx, dy, tent)


def axis_weights(psf: Psf, offset: Array, radius: Array) -> Array:
    """Weights of a Gaussian along one axis, whose products are those of `weights`: for what is separable."""
    tiny = np.asarray(radius) < 1e-9
    sigma = psf.sigma_ratio * np.where(tiny, 1.0, radius)
    return np.where(tiny, offset == 0.0, _gaussian_axis(offset, sigma, psf.truncation, psf.edge == "integrated"))


def _sampled_weights(psf: Psf, dx: Array, dy: Array, r: Array) -> Array:
    """The thesis: pixel centers inside the circle, normalized; no blur below half a pixel."""
    square = dx * dx + dy * dy
    key = np.where(r < MINIMUM_BLUR, 0.0, sampled_key(psf) * r * r)
    value = (square <= key).astype(np.float64)
    limit = floor(sqrt(float(key.max(initial=0.0))))
    span = np.arange(-limit, limit + 1)
    lattice = np.sort((span[:, None] ** 2 + span[None, :] ** 2).ravel())
    if psf.model == "pillbox":
        return value / np.searchsorted(lattice, key, side="right")
    sigma = psf.sigma_ratio * np.maximum(r, MINIMUM_BLUR)
    # Sum over the lattice, once per shell of equal distance.
    shells, counts = np.unique(lattice, return_counts=True)
    total = np.zeros_like(r)
    for shell, count in zip(shells, counts, strict=True):
        total += np.where(shell <= key, count * np.exp(-shell / (2.0 * sigma * sigma)), 0.0)
    return value * np.exp(-square / (2.0 * sigma * sigma)) / total


def sampled_key(psf: Psf) -> float:
    """A sampled PSF covers the pixel centers with dx^2 + dy^2 <= key R^2; the table is indexed by that product."""
    return 1.0 if psf.model == "pillbox" else (psf.truncation * psf.sigma_ratio) ** 2


def subpixel_weights(psf: Psf, dx: Array, dy: Array, radius: Array) -> Array:
    """Share of a point source's energy at (dx, dy) px, not necessarily integers: exact circle-square coverage.

    Serves the sub-pixel sources at silhouettes, for every `edge`; arguments as for `weights`.
    """
    if shape_of(psf).kind == "general":
        return _polygon_weights(psf, dx, dy, np.asarray(radius, np.float64), tent=False)
    dx, dy, r = (np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(dx, dy, np.abs(radius)))
    safe = np.maximum(r, 1e-9)
    if psf.model == "pillbox":
        return disc_coverage(dx, dy, safe, tent=False) / (np.pi * safe * safe)
    sigma = psf.sigma_ratio * safe
    cut = psf.truncation
    return _gaussian_axis(dx, sigma, cut, tent=False) * _gaussian_axis(dy, sigma, cut, tent=False)


def subpixel_offsets(samples: int) -> Array:
    """Positions (samples,) of sub-pixel sources along one axis, in px from the pixel's center."""
    return (np.arange(samples) + 0.5) / samples - 0.5
