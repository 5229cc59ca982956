"""Depth along rays in 106 bits from the numbers of a scene, by the textbook's formula: what geometry is measured by.

Nothing of the package's geometry is used. A surface is one polynomial of second degree in the camera frame, with
coefficients from mpmath; where B^2 - A C cancels, 106 bits are enough. Validated against mpmath ray by ray
(`solve_mp`, tests/benchmarks/test_oracle.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
from mpmath import mpf
from numpy.typing import NDArray

from benchmarks.stability.doubledouble import Wide, rounded, wide
from clsco.scene.model import Object, ObjectMotion

Array = NDArray[Any]
DIGITS = 80
LOST = 2.0**-98  # of B^2, below which B^2 - A C is 0 to 106 bits
NEAREST = 1e6  # 1/mm: nearer than 1e-6 mm is nothing


@dataclass(frozen=True, eq=False)
class Surface:
    """P.Q P + 2 L.P + K = 0 in the camera frame: object arrays of mpmath numbers Q (3, 3), L (3,), and K.

    nappe: of N.P + n, the sign that counts, 0 for any; axis (3,) N, origin n.
    """

    q: Array
    l: Array  # noqa: E741 - the name of the linear part in physics
    k: Any
    nappe: int
    axis: Array
    origin: Any


@dataclass(frozen=True, eq=False)
class Depths:
    """Answers for rays (...): whether they meet the surface, inverse depth in 1/mm, whether that is the larger root in
    size, and discriminant and leading coefficient, whose signs decide."""

    hit: NDArray[np.bool_]
    w: Wide
    larger: NDArray[np.bool_]
    discriminant: Wide
    leading: Wide


def _vector(values: Any) -> Array:
    return np.array([mpf(value) for value in values], dtype=object)


def _turn(motion: ObjectMotion) -> Array:
    """Rotation of an object after one second (2.14 to 2.23), z towards the camera there and away from it here."""
    sines, cosines = [], []
    for degrees in motion.angular_velocity:
        angle = mpmath.radians(mpf(degrees))
        sines.append(mpmath.sin(angle))
        cosines.append(mpmath.cos(angle))
    (sx, sy, sz), (cx, cy, cz) = sines, cosines
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]], dtype=object)
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]], dtype=object)
    about_z = np.array([[cz, sz, 0], [-sz, cz, 0], [0, 0, 1]], dtype=object)
    flip = np.diag(_vector([1, 1, -1]))
    return flip @ about_z @ about_y @ about_x @ flip


def _in_own_frame(item: Object) -> tuple[Array, Array, Any, Array, int]:
    """Q, L, K about the object's origin, that origin, and the nappe (3.7, 3.11, 3.18, 3.23, 3.34, 3.39)."""
    zero, still = _vector([0, 0, 0]), np.diag(_vector([1, 1, 1]))
    if item.shape == "plane":
        normal = _vector([-mpf(item.slope_x), -mpf(item.slope_y), 1]) / 2
        return still * 0, normal, mpf(0), _vector([0, 0, item.distance]), 0
    if item.shape == "cone":
        steep = mpmath.tan(mpmath.radians(mpf(item.half_angle))) ** 2
        return np.diag(_vector([1, 1, -steep])), zero, mpf(0), _vector(item.apex), 1 if item.nappe == "away" else -1
    assert item.shape != "rectangle"
    assert item.shape != "disc"
    assert item.shape != "box"
    assert item.shape != "depth_map"
    assert item.shape != "background"
    center = _vector(item.center)
    if item.shape == "sphere":
        return still, zero, -(mpf(item.radius) ** 2), center, 0
    if item.shape == "cylinder":
        axis = _vector(item.axis)
        return still - np.outer(axis, axis) / (axis @ axis), zero, -(mpf(item.radius) ** 2), center, 0
    if item.shape == "ellipsoid":
        return np.diag(1 / _vector(item.semi_axes) ** 2), zero, mpf(-1), center, 0
    xx, yy, zz, xy, yz, zx, *linear, constant = _vector(item.coefficients)
    q = np.array([[xx, xy / 2, zx / 2], [xy / 2, yy, yz / 2], [zx / 2, yz / 2, zz]], dtype=object)
    return q, np.array(linear, dtype=object) / 2, constant, center, 0


def surface(item: Object, motion: ObjectMotion) -> Surface:
    """The surface of an object after one second of a motion."""
    with mpmath.workdps(DIGITS):
        q, l, k, origin, nappe = _in_own_frame(item)  # noqa: E741
        turn = _turn(motion)
        at = origin + _vector(motion.velocity)
        q, l = turn @ q @ turn.T, turn @ l  # noqa: E741
        axis = turn[:, 2]
        return Surface(q, l - q @ at, at @ q @ at - 2 * (l @ at) + k, nappe, axis, -(axis @ at))


def solve(of: Surface, x: Wide, y: Wide) -> Depths:
    """Inverse depth of the nearest visible point along rays (x, y, 1), 0 where there is none: C w^2 + 2 B w + A = 0."""
    with mpmath.workdps(DIGITS):
        numbers = [of.q[0, 0], 2 * of.q[0, 1], of.q[1, 1], 2 * of.q[0, 2], 2 * of.q[1, 2], of.q[2, 2]]
        parts = rounded([*numbers, *of.l, of.k, *of.axis, of.origin])
    c = [Wide(high, low) for high, low in zip(parts.high, parts.low, strict=True)]
    a = (c[0] * x + c[1] * y + c[3]) * x + (c[2] * y + c[4]) * y + c[5]
    b = c[6] * x + c[7] * y + c[8]
    square = b * b
    discriminant = square - a * c[9]
    nothing = np.abs(discriminant.high) < LOST * square.high  # as of a ray through an apex
    discriminant = wide(np.zeros(a.high.shape)).where(nothing, discriminant)
    root = discriminant.sqrt()
    with np.errstate(all="ignore"):
        negative = b.high < 0.0
        t = (root - b).where(negative, -root - b)
        along = c[10] * x + c[11] * y + c[12]
        found, w = np.zeros(a.high.shape, bool), wide(np.zeros(a.high.shape))
        larger = t / c[9] if of.k != 0 else w
        for candidate in (larger, a / t):
            counts = (discriminant.high >= 0.0) & (candidate.high > 0.0) & (candidate.high < NEAREST)
            counts &= of.nappe * (c[13] * candidate + along).high >= 0.0
            nearer = counts & ((candidate - w).high > 0.0)
            found, w = found | nearer, candidate.where(nearer, w)
    return Depths(found, w, found & (w.high == larger.high), discriminant, a)


def exactly(high: float, low: float) -> Any:
    """The number of mpmath that is high + low."""
    with mpmath.workdps(DIGITS):
        return mpf(float(high)) + mpf(float(low))


def agreement(found: Any, exact: Any) -> float:
    """Count the bits in which two numbers of mpmath agree, 106 for all; 0 where one of them alone is 0."""
    with mpmath.workdps(DIGITS):
        if found == exact:
            return 106.0
        return 0.0 if exact == 0 or found == 0 else float(-mpmath.log(abs(found / exact - 1), 2))


def solve_mp(of: Surface, x: Any, y: Any) -> Any:
    """The same for one ray, by mpmath's own arithmetic and the other form of the roots, C / (-B +- sqrt(D))."""
    with mpmath.workdps(DIGITS):
        ray = _vector([x, y, 1])
        a, b = ray @ of.q @ ray, of.l @ ray
        discriminant = b * b - a * of.k
        if discriminant < 0:
            return mpf(0)
        root = mpmath.sqrt(discriminant)
        # Z = -(b +- root) / a, and w = 1 / Z; where a = 0 one of them is at infinity.
        depths = [of.k / (-b - sign * root) if -b - sign * root else mpmath.inf for sign in (1, -1)]
        seen = [1 / z for z in depths if 0 < z < mpmath.inf and 1 / z < NEAREST]
        seen = [w for w in seen if of.nappe * (of.axis @ ray + w * of.origin) >= 0]
        return max(seen, default=mpf(0))
