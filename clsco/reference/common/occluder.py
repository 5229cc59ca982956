"""One occluder: which share of the lens it hides from single taps.

Of a surface without limits that is a cubic step of h = -B - sqrt(C F) over the width of the soft edge, else of the
conditions on its crossings; B, C and F as in `visibility`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.reference.common.geometry import Array

Mask = NDArray[np.bool_]

TINY = 1e-30


@dataclass(frozen=True, eq=False)
class Occluder:
    """One surface between N points and the lens; x, y: offset of a tap in cells, right and down.

    h (N, 3): constant, x, y, over the width of the soft edge, without the root; root (N,), f (N, 5): x, y, xx, xy, yy
    under it. With limits: crossings (N,) 1 or 2, or 0 for a plane, whose limits are an h (N, 3) each; else b (N, 3),
    f0 (N,), c, d (N, 6), soft (N,): 1 over the width of the edge; limits: (N, 4) each,
    limit + v (limit_0 + limit_x x + limit_y y) >= 0; needed: (N,) each, where the limit matters.
    """

    h: Array
    root: Array
    f: Array
    crossings: NDArray[np.int64]
    b: Array
    f0: Array
    c: Array
    d: Array
    soft: Array
    limits: tuple[Array, ...]
    needed: tuple[Mask, ...]

    def of(self, chosen: NDArray[Any]) -> Occluder:
        """The same for some of the points."""
        arrays = {k: v[chosen] for k, v in vars(self).items() if k not in ("limits", "needed")}
        limits, needed = (tuple(array[chosen] for array in arrays) for arrays in (self.limits, self.needed))
        return Occluder(**arrays, limits=limits, needed=needed)


def soft_step(t: Array) -> Array:
    """Cubic step from 0 at t = -1/2 to 1 at 1/2."""
    t = np.clip(t + 0.5, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


@dataclass(frozen=True, eq=False)
class Crossing:
    """One of the crossings with the lines to taps: w + v, and how v changes with the tap, (N,) each."""

    v: Array
    x: Array
    y: Array


def crossing_at(m: Occluder, v: Array, b: Array, c: Array, x: Array, y: Array, least: Array) -> Crossing:
    """The crossing at w + v (N,); b, c, x, y: (N,), at the taps.

    least: of C v + B = sqrt(D) or -sqrt(D), with its sign: without it v changes endlessly at the outline, where no
    condition would ever be clear.
    """
    steep = c * v + b
    scale = -v / np.where(np.abs(steep) > np.abs(least), steep, least)
    _, c_x, c_y, c_xx, c_xy, c_yy = m.c.T
    vx = scale * (m.b[:, 1] + 0.5 * v * (c_x + 2 * c_xx * x + c_xy * y))
    vy = scale * (m.b[:, 2] + 0.5 * v * (c_y + c_xy * x + 2 * c_yy * y))
    return Crossing(v, vx, vy)


def limit_share(m: Occluder, limit: Array, at: Crossing, x: Array, y: Array) -> Array:
    """Share (N,) of the taps' cells over which a crossing meets one condition (N, 4)."""
    slope = limit[:, 1] + limit[:, 2] * x + limit[:, 3] * y
    steep = np.hypot(at.v * limit[:, 2] + slope * at.x, at.v * limit[:, 3] + slope * at.y)
    return soft_step((limit[:, 0] + at.v * slope) * m.soft / (steep + TINY))


def crossing_share(m: Occluder, at: Crossing, x: Array, y: Array) -> Array:
    """Share (N,) of them from which a crossing occludes: the least that any condition leaves."""
    least = np.ones_like(x)
    for limit, needed in zip(m.limits, m.needed, strict=True):
        least = np.where(needed, np.minimum(least, limit_share(m, limit, at, x, y)), least)
    # Behind a point of the surface itself the tilt lets no radiance pass; a step there would only show in rounding.
    return np.where((m.f0 == 0) | (at.v > 0), least, 0.0)


def outline_gradient(m: Occluder, x: Array, y: Array) -> Array:
    """Gradient (N,) of D = B^2 - C F at taps x, y (N,)."""
    _, d_x, d_y, d_xx, d_xy, d_yy = m.d.T
    return np.asarray(np.hypot(d_x + 2 * d_xx * x + d_xy * y, d_y + d_xy * x + 2 * d_yy * y))


def find_crossings(m: Occluder, x: Array, y: Array, width: float = 1.0) -> tuple[Crossing, Crossing]:
    """Both crossings at taps x, y (N,), or the one; width: 0 to leave no condition clear at an outline."""
    b = m.b[:, 0] + m.b[:, 1] * x + m.b[:, 2] * y
    c, d = (p[:, 0] + x * (p[:, 1] + p[:, 3] * x + p[:, 4] * y) + y * (p[:, 2] + p[:, 5] * y) for p in (m.c, m.d))
    root = np.sqrt(np.maximum(d, 0.0))
    t = np.where(b < 0, root - b, -b - root)
    t = np.where(np.abs(t) > TINY, t, TINY)
    # Of two crossings: over the width of the edge sqrt(D) changes by at most sqrt(width |gradient of D|).
    least = np.where(m.f0 <= 0, 0.0, 0.5 * np.sqrt(width * outline_gradient(m, x, y) / m.soft)) + TINY
    least = np.where(b < 0, least, -least)
    return crossing_at(m, t / c, b, c, x, y, least), crossing_at(m, m.f0 / t, b, c, x, y, -least)


def occluded_height(m: Occluder, x: Array, y: Array) -> Array:
    """h (N,) of a surface without limits at taps x, y (N,), over the width of the soft edge."""
    fx, fy, fxx, fxy, fyy = m.f.T
    f = x * (fx + fxx * x + fxy * y) + y * (fy + fyy * y)
    under = np.sqrt(np.maximum(m.root * m.root + f, 0.0))
    return np.asarray(m.h[:, 0] + m.h[:, 1] * x + m.h[:, 2] * y - f / (under + m.root + TINY))


def occluded_share(m: Occluder, x: Array, y: Array) -> Array:
    """Share (N,) of the lens, over the cells of taps x, y (N,), that one surface hides."""
    if not m.limits:
        return soft_step(occluded_height(m, x, y))
    if m.limits[0].shape[1] == 3:  # a plane
        return np.asarray(np.min([soft_step(h[:, 0] + h[:, 1] * x + h[:, 2] * y) for h in m.limits], axis=0))
    with np.errstate(all="ignore"):  # a lens point on the surface itself has an infinite crossing
        one, other = (crossing_share(m, at, x, y) for at in find_crossings(m, x, y))
    # Without any condition left, a surface that is crossed twice is as one that never had any.
    share, d = np.where(m.f0 == 0, one, np.maximum(one, other)), m.d
    height = d[:, 0] + x * (d[:, 1] + d[:, 3] * x + d[:, 4] * y) + y * (d[:, 2] + d[:, 5] * y)
    twice = np.where(
        np.any(m.needed, axis=0),
        share * soft_step(height * m.soft / (outline_gradient(m, x, y) + TINY)),
        soft_step(occluded_height(m, x, y)),
    )
    return np.where(m.crossings == 1, share, twice)


def hides_all(m: Occluder, most: Array) -> tuple[Mask, tuple[Mask, ...]]:
    """Mark sources (N,) for which a surface hides the lens at 16 points all over it, a little beyond its rim, `most`
    (N,), among them.

    Also which conditions (N,) each some crossing there does not meet wholly; others can be dropped, but for one where
    there is one crossing.
    """
    hidden, needed = np.ones(most.shape, dtype=bool), [np.zeros(most.shape, dtype=bool) for _ in m.limits]
    needed[0] |= m.crossings == 1
    for radius in (most / np.cos(np.pi / 8), 0.5 * most):
        for angle in np.arange(8) * (np.pi / 4):
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            hidden &= occluded_share(m, x, y) >= 1.0
            with np.errstate(all="ignore"):
                for at in find_crossings(m, x, y, 0.0):
                    for k, limit in enumerate(m.limits):
                        needed[k] |= (at.v > 0) & (limit_share(m, limit, at, x, y) < 1.0)
    return hidden, tuple(needed)
