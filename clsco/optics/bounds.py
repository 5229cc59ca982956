"""Bounds of an object that cut its surface; other bounds would cost time, and soften edges that do not exist (pure).

A surface is Q(p) = p M p + 2 L p + K = 0 in the object's own frame. A bound cuts it if the surface within the bounds of
the other axes extends beyond this bound. The surface ends along an axis at a root of Q where, for each other axis,
either a bound is reached or Q is stationary along that axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from math import inf

import numpy as np
from numpy.typing import NDArray

TOUCHING = 1e-7  # fraction of the largest bound: a surface that passes a bound by less, as by rounding, touches it
FAR = 1e3  # multiple of the largest bound, in place of an infinite one
NULL = 1e-13  # fraction of the largest coefficient that counts as 0
Interval = tuple[float, float]
Bounds = tuple[Interval, Interval, Interval]
Array = NDArray[np.float64]


@lru_cache(maxsize=1024)
def cutting(rows: tuple[tuple[float, ...], ...], nappe: int, bounds: Bounds) -> Bounds | None:
    """Bounds that really cut a surface, or None if no bound does. A bound that the surface, cut by the other bounds, at
    most touches is replaced by an infinite one.

    rows: matrix (M, L; L, K) of the surface, for coordinates in mm; nappe: sign required of the third coordinate, 0 for
    either; bounds: low and high limit of each axis, mm.
    """
    size = max(abs(limit) for interval in bounds for limit in interval)
    unit = np.array([size, size, size, 1.0])
    matrix, box = np.array(rows) * unit * unit[:, None], np.array(bounds) / size
    half = np.array([[-inf, inf], [-inf, inf], [0.0 if nappe > 0 else -inf, 0.0 if nappe < 0 else inf]])
    cuts = np.ones((3, 2), dtype=bool)
    for axis, side in product(range(3), range(2)):
        cuts[axis, side] = False
        box_left = np.where(cuts, box, [-FAR, FAR])
        box_left = np.stack([np.maximum(box_left[:, 0], half[:, 0]), np.minimum(box_left[:, 1], half[:, 1])], axis=1)
        # Along the axis itself only the nappe applies, as both of its bounds may be dropped.
        box_left[axis] = half[axis]
        sign = 1.0 if side else -1.0
        reached = [sign * place for place in _ends(matrix, axis, box_left)]
        cuts[axis, side] = not reached or max(reached) > sign * box[axis, side] + TOUCHING
    x, y, z = (tuple(limits) for limits in np.where(cuts, bounds, [-inf, inf]).tolist())
    return (x, y, z) if cuts.any() else None


def _ends(matrix: Array, axis: int, box: Array) -> Iterator[float]:
    """Candidates for the ends of a surface along an axis, in both directions; infinite where it has no end.

    matrix: (M, L; L, K); box: (3, 2), low and high limit of each axis. Finite candidates lie inside the box.
    """
    order = [axis, *(k for k in range(3) if k != axis), 3]
    m, (axis_interval, *sides) = matrix[np.ix_(order, order)], box[order[:3]]
    least = NULL * np.abs(matrix).max()
    slopes = [m[0, 1] * y + m[0, 2] * z + m[0, 3] for y, z in product(*sides)]
    if abs(m[0, 0]) <= least and min(slopes) <= least and max(slopes) >= -least:
        yield from (-inf, inf)  # Q has no square of this coordinate, and somewhere no linear term in it either
        return
    # Where Q is stationary along the free axes, their coordinates are linear in x; other axes are at an end of the box.
    for fixed in product((0, 1, None), repeat=2):
        free = [k + 1 for k, end in enumerate(fixed) if end is None]
        line = np.zeros((4, 2))  # p = line (x, 1)
        line[0, 0] = line[3, 1] = 1.0
        for k, end in enumerate(fixed):
            if end is not None:
                line[k + 1, 1] = sides[k][end]
        if free:
            part = m[np.ix_(free, free)]
            if abs(np.linalg.det(part)) <= (least if len(free) == 1 else least * np.abs(part).max()):
                continue  # Q is linear along some line; its ends are other cases
            line[free] = -np.linalg.solve(part, (m @ line)[free])
        for x in _roots(line.T @ m @ line):
            at = line @ (x, 1.0)
            intervals = (axis_interval, *sides)
            if all(low - TOUCHING <= c <= high + TOUCHING for c, (low, high) in zip(at, intervals, strict=False)):
                yield x


def _roots(form: Array) -> Iterator[float]:
    """Real x with (x, 1) form (x, 1) = 0; form: symmetric, (2, 2)."""
    a, b, c = form[0, 0], form[0, 1], form[1, 1]
    discriminant = b * b - a * c
    if discriminant < 0.0:
        return
    t = -(b + np.copysign(np.sqrt(discriminant), b))
    if a != 0.0:
        yield t / a
    if t != 0.0:
        yield c / t
