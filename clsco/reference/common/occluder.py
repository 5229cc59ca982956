"""One occluder: the fraction of the lens that it hides from single taps.

For an unbounded surface this is a cubic step of h = -B - sqrt(C F) over the width of the soft edge; for a bounded
surface it follows from the conditions on its intersections. B, C and F are those of `visibility`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.reference.common.geometry import Array

Mask = NDArray[np.bool_]

TINY = 1e-30
LEAST_WIDTH = 0.001  # least ratio of an edge's squared width to that without a rim


@dataclass(frozen=True, eq=False)
class Occluder:
    """One surface between N points and the lens, for tests at taps offset by x, y cells, right and down.

    h (N, 3), root (N,), f (N, 5): the height in widths of the soft edge is h . (1, x, y) + root - sqrt(root^2 + f . (x,
    y, x^2, x y, y^2)). strip (N,): see `strip_share`. crossings (N,): 1 or 2 intersections, None for a plane. follows,
    narrows, trails (N,): see `clsco.reference.common.equation.source_ways`.

    limits: conditions (N, 4) each: limit_0 + v (limit_1 + limit_2 x + limit_3 y) >= 0; for a plane, the coefficients of
    h for 1, x, y, then the `part` of `two_boxes`. needed: for each condition, a mask (N,) of points for which it
    matters. Used only if there are limits: b (N, 3), f0 (N,), c, d (N, 6), the coefficients of B, F, C and D = B^2 - C
    F for 1, x, y, x^2, x y, y^2; soft (N,), 1 / width of the edge.
    """

    h: Array
    root: Array
    f: Array
    crossings: NDArray[np.int64] | None = None
    b: Any = None
    f0: Any = None
    c: Any = None
    d: Any = None
    soft: Any = None
    limits: tuple[Array, ...] = ()
    needed: tuple[Mask, ...] = ()
    strip: Array | float = 0.0
    follows: Array | float = 0.0
    narrows: Array | float = 0.0
    trails: Array | float = 1.0

    def select(self, chosen: NDArray[Any]) -> Occluder:
        arrays = {k: v[chosen] for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        limits, needed = (tuple(array[chosen] for array in arrays) for arrays in (self.limits, self.needed))
        return Occluder(**arrays, limits=limits, needed=needed)


@dataclass(frozen=True, eq=False)
class Cut:
    """Effect of an aperture's edge on taps of wide lenses, which see only a part of their lens cells.

    aside_x, aside_y (N,): displacement in px from the middle of the visible part to the tap. xx, xy, yy (N,): reduction
    of the variance of the visible part, from 0 (none) to 1. trail_x, trail_y (N,): reduction of the variance of the
    part of the source that is seen through one lens point. covariance (3, N): with bent rays, the covariance of the
    positions in source and lens (`clsco.optics.ray_means.RayMeans`).
    """

    aside_x: Array
    aside_y: Array
    xx: Array
    xy: Array
    yy: Array
    trail_x: Array
    trail_y: Array
    covariance: Array | None = None

    def select(self, chosen: NDArray[Any]) -> Cut:
        return Cut(**{name: array[..., chosen] for name, array in vars(self).items() if array is not None})


def sharpened(m: Occluder, cut: Cut | None, x: Array, y: Array) -> Array | float:
    """Factor (N,) by which edges with normals x, y (N,) are steeper because taps see only a part of their cells."""
    if cut is None:
        return 1.0
    square = x * x + y * y + TINY
    xx, xy, yy = cut.xx, cut.xy, cut.yy
    if cut.covariance is not None:
        xx, xy, yy = (xx, xy, yy) - np.abs(m.follows) * cut.covariance
    across = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / square
    if cut.covariance is not None:
        varies = 1.0 + m.narrows * (2.0 * m.follows - across)
    else:
        trail = (x * x * cut.trail_x + y * y * cut.trail_y) / square
        varies = m.narrows * (1.0 - across) + m.trails * (1.0 - trail)
    return np.asarray(1.0 / np.sqrt(np.maximum(varies, LEAST_WIDTH)))


def soft_step(t: Array) -> Array:
    """Cubic step from 0 at t = -1/2 to 1 at 1/2."""
    t = np.clip(t + 0.5, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def two_boxes(t: Array, part: Array) -> Array:
    """Step from 0 at t = -1/2 to 1 at 1/2: a sharp step blurred by two boxes of widths `part` and 1 - `part`.

    part: at most 1/2.
    """
    distance = np.maximum(0.5 - np.abs(t), 0.0)
    least = np.minimum(distance, part)
    beyond = least * (2.0 * distance - least) / (2.0 * part * (1.0 - part))
    return np.where(t < 0.0, beyond, 1.0 - beyond)


@dataclass(frozen=True, eq=False)
class Part:
    """Fraction (N,) of taps' lens cells, hidden or free.

    x, y (N,): direction, of any length, in which more is hidden.
    """

    share: Array
    x: Array
    y: Array

    def where(self, chosen: Mask, other: Part) -> Part:
        """This part where `chosen` (N,) is True, else the other."""
        pairs = ((self.share, other.share), (self.x, other.x), (self.y, other.y))
        return Part(*(np.where(chosen, first, second) for first, second in pairs))

    @property
    def slope(self) -> Array:
        """Length (N,) of the direction."""
        return np.asarray(np.hypot(self.x, self.y))


def leave_free(free_part: Part, hidden: Part) -> Part:
    """Part of the cells that remains free if a further surface hides the part `hidden` of them.

    If the two edges are perpendicular, the remaining part is the product of the free fractions. If they are parallel
    and both surfaces hide the same side, it is the smaller free fraction. If they hide opposite sides, it is the strip
    between the edges, which is empty if the surfaces share that edge.
    """
    remaining = 1 - hidden.share
    product = free_part.share * remaining
    free_scale, scale = 1 / (free_part.slope + TINY), 1 / (hidden.slope + TINY)
    cosine = (free_part.x * hidden.x + free_part.y * hidden.y) * (free_scale * scale)
    gap = np.maximum(free_part.share - hidden.share, 0.0)
    excess = np.where(cosine > 0, np.minimum(free_part.share, remaining) - product, product - gap)
    left_weight, weight = free_part.share * (1 - free_part.share) * free_scale, hidden.share * remaining * scale
    x, y = left_weight * free_part.x + weight * hidden.x, left_weight * free_part.y + weight * hidden.y
    return Part(product + cosine * excess, x, y)


@dataclass(frozen=True, eq=False)
class Crossing:
    """One intersection of the lines to taps with a surface, at w + v: v (N,), and its derivatives x, y (N,)."""

    v: Array
    x: Array
    y: Array


def crossing_at(m: Occluder, v: Array, b: Array, c: Array, x: Array, y: Array, least: Array) -> Crossing:
    """The `Crossing` at w + v (N,); b, c (N,): B and C at the taps x, y (N,).

    least (N,): signed lower bound of |C v + B| = sqrt(D). Without it the derivative of v is infinite at the outline,
    where every condition would be uncertain.
    """
    steep = c * v + b
    scale = -v / np.where(np.abs(steep) > np.abs(least), steep, least)
    _, c_x, c_y, c_xx, c_xy, c_yy = m.c.T
    vx = scale * (m.b[:, 1] + 0.5 * v * (c_x + 2 * c_xx * x + c_xy * y))
    vy = scale * (m.b[:, 2] + 0.5 * v * (c_y + c_xy * x + 2 * c_yy * y))
    return Crossing(v, vx, vy)


def limit_part(m: Occluder, limit: Array, at: Crossing, x: Array, y: Array, cut: Cut | None = None) -> Part:
    """Part (N,) of the taps' cells for which an intersection satisfies the condition `limit` (N, 4)."""
    slope = limit[:, 1] + limit[:, 2] * x + limit[:, 3] * y
    gx, gy = at.v * limit[:, 2] + slope * at.x, at.v * limit[:, 3] + slope * at.y
    steep = m.soft * sharpened(m, cut, gx, gy) / (np.hypot(gx, gy) + TINY)
    return Part(soft_step((limit[:, 0] + at.v * slope) * steep), gx, gy)


def crossing_part(m: Occluder, at: Crossing, x: Array, y: Array, cut: Cut | None) -> Part:
    """Part (N,) of the taps' cells for which an intersection occludes: the smallest over all conditions."""
    least = Part(np.ones_like(x), np.zeros_like(x), np.zeros_like(x))
    for limit, needed in zip(m.limits, m.needed, strict=True):
        part = limit_part(m, limit, at, x, y, cut)
        least = part.where(needed & (part.share < least.share), least)
    # For the point's own surface, tilt removes the radiance behind it; a step there would only add rounding errors.
    return replace(least, share=np.where((m.f0 == 0) | (at.v > 0), least.share, 0.0))


def outline_part(m: Occluder, x: Array, y: Array) -> Part:
    """A `Part` with D = B^2 - C F (N,) at taps x, y (N,) as its `share`, and the gradient of D as its direction."""
    d, d_x, d_y, d_xx, d_xy, d_yy = m.d.T
    height = d + x * (d_x + d_xx * x + d_xy * y) + y * (d_y + d_yy * y)
    return Part(height, d_x + 2 * d_xx * x + d_xy * y, d_y + d_xy * x + 2 * d_yy * y)


def find_crossings(m: Occluder, x: Array, y: Array, width: float = 1.0) -> tuple[Crossing, Crossing]:
    """Both intersections at taps x, y (N,); if there is only one, the other has v <= 0.

    width: distance from an outline, in widths of the edge, within which derivatives are limited; 0 for no limit.
    """
    b = m.b[:, 0] + m.b[:, 1] * x + m.b[:, 2] * y
    c, d = (p[:, 0] + x * (p[:, 1] + p[:, 3] * x + p[:, 4] * y) + y * (p[:, 2] + p[:, 5] * y) for p in (m.c, m.d))
    root = np.sqrt(np.maximum(d, 0.0))
    t = np.where(b < 0, root - b, -b - root)
    t = np.where(np.abs(t) > TINY, t, TINY)
    # Of two crossings: over the width of the edge sqrt(D) changes by at most sqrt(width |gradient of D|).
    least = np.where(m.f0 <= 0, 0.0, 0.5 * np.sqrt(width * outline_part(m, x, y).slope / m.soft)) + TINY
    least = np.where(b < 0, least, -least)
    return crossing_at(m, t / c, b, c, x, y, least), crossing_at(m, m.f0 / t, b, c, x, y, -least)


def occluded_height(m: Occluder, x: Array, y: Array) -> Array:
    """h (N,) of an unbounded surface at taps x, y (N,), divided by the width of the soft edge."""
    fx, fy, fxx, fxy, fyy = m.f.T
    f = x * (fx + fxx * x + fxy * y) + y * (fy + fyy * y)
    under = np.sqrt(np.maximum(m.root * m.root + f, 0.0))
    return np.asarray(m.h[:, 0] + m.h[:, 1] * x + m.h[:, 2] * y - f / (under + m.root + TINY))


def strip_share(thin: Array | float) -> Array:
    """Correction (N,) added to h, in widths of the edge, so that a thin strip hides exactly its own width.

    thin (N,): curvature of h across the outline minus the curvature along the outline, times half the width of the
    edge, divided by the slope; up to 15.
    """
    return np.asarray(np.minimum(0.05 * thin, np.maximum(0.073 - 0.02 * thin, 0.03 - 0.0105 * thin)))


def occluded_part(m: Occluder, x: Array, y: Array, cut: Cut | None = None) -> Part:
    """Part (N,) of the lens that one surface hides from taps x, y (N,), averaged over the tap's cell.

    cut: for wide lenses, else None. If the aperture's edge cuts the view of a tap, the tap's light also comes from only
    a part of the source's pixel, whose middle is displaced.
    """
    if cut is not None:
        x, y = x + m.follows * cut.aside_x, y + m.follows * cut.aside_y
    if m.limits and m.crossings is None:  # a plane
        inside = Part(np.ones_like(x), np.zeros_like(x), np.zeros_like(x))  # with the direction in which less is hidden
        for h, needed in zip(m.limits, m.needed, strict=True):
            steep = sharpened(m, cut, h[:, 1], h[:, 2])
            outside = 1 - two_boxes((h[:, 0] + h[:, 1] * x + h[:, 2] * y) * steep, h[:, 3])
            inside = leave_free(inside, Part(outside, -h[:, 1], -h[:, 2])).where(needed, inside)
        return Part(inside.share, -inside.x, -inside.y)
    # At the edge h = 0, so that the root equals the terms before it.
    fx, fy, fxx, fxy, fyy = m.f.T
    root = 2 * (m.h[:, 0] + m.h[:, 1] * x + m.h[:, 2] * y + m.root)
    across, down = root * m.h[:, 1] - (fx + 2 * fxx * x + fxy * y), root * m.h[:, 2] - (fy + fxy * x + 2 * fyy * y)
    steep = sharpened(m, cut, across, down)
    height = occluded_height(m, x, y) * steep + strip_share(m.strip / steep) - steep * strip_share(m.strip)
    full = Part(soft_step(height), across, down)
    if not m.limits:
        return full
    with np.errstate(all="ignore"):  # a lens point on the surface itself has an infinite crossing
        near_part, far_part = (crossing_part(m, at, x, y, cut) for at in find_crossings(m, x, y))
    part = near_part.where((m.f0 == 0) | (near_part.share > far_part.share), far_part)
    outline = outline_part(m, x, y)
    steep = m.soft * sharpened(m, cut, outline.x, outline.y)
    within = soft_step(outline.share * steep / (outline.slope + TINY))
    twice = replace(part.where(part.share <= within, outline), share=part.share * within)
    # Without any remaining condition, a surface with two intersections is treated as an unbounded one.
    return part.where((m.f0 == 0) | (m.crossings == 1), twice.where(np.any(m.needed, axis=0), full))


def hides_all(m: Occluder, most: Array) -> tuple[Mask, tuple[Mask, ...]]:
    """True (N,) if a surface hides the lens at 16 points up to slightly beyond `most` (N,) cells from the middle.

    Also returns, for each condition, a mask (N,) of points for which some intersection does not fully satisfy it. All
    other conditions can be dropped; with a single intersection, the first is always kept.
    """
    hidden, needed = np.ones(most.shape, dtype=bool), [np.zeros(most.shape, dtype=bool) for _ in m.limits]
    needed[0] |= m.crossings == 1
    for radius in (most / np.cos(np.pi / 8), 0.5 * most):
        for angle in np.arange(8) * (np.pi / 4):
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            hidden &= occluded_part(m, x, y).share >= 1.0
            with np.errstate(all="ignore"):
                for at in find_crossings(m, x, y, 0.0):
                    for k, limit in enumerate(m.limits):
                        needed[k] |= (at.v > 0) & (limit_part(m, limit, at, x, y).share < 1.0)
    return hidden, tuple(needed)
