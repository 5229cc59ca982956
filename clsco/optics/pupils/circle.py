"""Circular pupil: the blur is a disc, whose areas in pixels are exact (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsco.optics.pupils.pupil import Array, Pupil


@dataclass(frozen=True)
class Circle(Pupil):
    """Open lens: light passes at |l| <= 1."""

    uniform = True
    name, light, second_moment = "circle", 1.0, 0.25

    def transmission(self, x: Array, y: Array) -> Array:
        return np.asarray((x * x + y * y <= 1.0).astype(np.float64))

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        size = np.abs(radius)
        return np.asarray(disc_coverage(dx, dy, size, tent) / (np.pi * size * size))

    def cells(self, count: int) -> Array:
        at = np.arange(2.0 * count) + 0.5 - count
        return disc_coverage(at[None, :], at[:, None], np.asarray(float(count)), tent=False)


def _ramp_pieces(b: Array, level: Array, sign: float, tent: bool) -> tuple[Array, Array, Array]:
    """Coefficients of 1, h, h^2 in the integral of the pixel's response up to u = sign h - b.

    b: position of the pixel along the chord; level: any u in the piece between two knots for which the coefficients are
    valid.
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

    dx, dy and radius > 0 are in px and broadcast. tent=False: response of a unit square (area of the disc in the
    pixel); tent=True: of the square convolved with itself (a square source and a square detector). Closed form: along
    each chord the response integrates to a quadratic in the chord's half-length h = sqrt(R^2 - x^2); the integrals over
    x of 1, h, h^2 and x times these are elementary between breakpoints. Accurate to 1e-10; the sum over integer offsets
    is pi R^2.
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
    """Value of `disc_coverage` at offsets a, b >= 0, radius r: 1-D arrays, of pixels that the circle crosses."""
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
