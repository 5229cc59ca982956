"""Selection of pixels to compare with rays: at outlines, in focus, at small objects, and anywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.truth.kernel import pinhole
from clsco.truth.problem import Array, Problem

CLASSES = ("outline", "focus", "random", "small")
OUTLINE, FOCUS, RANDOM, SMALL = range(4)
COUNTS = {OUTLINE: 250, FOCUS: 100, RANDOM: 100, SMALL: 50}
OF_EACH = 10  # number of pixels tested for each object, however small
SMALL_PX, FOCUS_PX, AROUND_PX = 3.0, 0.3, 2.0  # px: small images are narrower; |R| in focus; beyond outlines' blur
LINE = np.linspace(-1.0, 1.0, 65)
_Places = tuple[NDArray[Any], NDArray[Any], int, int]


@dataclass(frozen=True, eq=False)
class Pixels:
    """Pixels (n,) by row and column, with the class of each, and the number of its object, -1 for none."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    kind: NDArray[np.int64]
    item: NDArray[np.int64]

    def select(self, chosen: NDArray[np.bool_]) -> Pixels:
        return Pixels(*(values[chosen] for values in vars(self).values()))


@dataclass(frozen=True)
class Extent:
    """Image of an object.

    places: points (n, 3) along the object in its own frame, mm; half: half of its size (3) in this frame, mm; width:
    width of the image at mid-exposure, px.
    """

    places: Array
    half: Array
    width: float

    @property
    def around(self) -> float:
        """Radius in mm of a ball that contains the object."""
        return float(self.half.max() if len(self.places) == 1 else np.linalg.norm(self.half))


def labels_at(problem: Problem, moment: int) -> tuple[Array, NDArray[np.int64]]:
    """Depth and object (rows, columns) at the middle of each pixel at a moment."""
    depth, label = np.empty(problem.size), np.empty(problem.size, np.int64)
    pinhole(depth, label, moment, problem.surfaces, problem.moments, problem.optics.numbers)
    return depth, label


def choose_pixels(problem: Problem, seed: int) -> Pixels:
    """Pixels to test, equal for equal seeds."""
    draw, middle = np.random.default_rng(seed), len(problem.moments.poses) // 2
    moments = sorted({0, middle, len(problem.moments.poses) - 1})
    (rows, columns), background = problem.size, problem.surfaces.background
    depth_labels = [labels_at(problem, moment) for moment in moments]
    radii = [
        np.where((labels < 0) & (background < 0), 0.0, radius_of(problem, depth, moment))
        for (depth, labels), moment in zip(depth_labels, moments, strict=True)
    ]
    label = depth_labels[moments.index(middle)][1]
    label = np.where(label < 0, background, label)
    candidates: list[_Places] = []  # rows, columns, class, object or -1 for the visible one

    edges = [_outlines(labels, radius) for (_, labels), radius in zip(depth_labels, radii, strict=True)]
    edge_row, edge_column, reach = (np.concatenate(part) for part in zip(*edges, strict=True))
    if len(edge_row):
        at = draw.integers(0, len(edge_row), 4 * COUNTS[OUTLINE])
        near = reach[at] + AROUND_PX
        row = np.rint(edge_row[at] + near * draw.uniform(-1, 1, len(at)))
        column = np.rint(edge_column[at] + near * draw.uniform(-1, 1, len(at)))
        candidates.append((row, column, OUTLINE, -1))
    row, column = np.nonzero((np.abs(radii[moments.index(middle)]) < FOCUS_PX) & (label >= 0))
    at = draw.integers(0, max(len(row), 1), COUNTS[FOCUS] if len(row) else 0)
    candidates.append((row[at], column[at], FOCUS, -1))
    candidates.append((draw.integers(0, rows, COUNTS[RANDOM]), draw.integers(0, columns, COUNTS[RANDOM]), RANDOM, -1))
    extents = [extent_of(problem, n) for n in range(len(problem.scene.objects))]
    small = [n for n, extent in enumerate(extents) if extent is not None and extent.width < SMALL_PX]
    for n in small:
        count = max(OF_EACH, COUNTS[SMALL] // len(small))
        candidates.append((*_around(problem, n, middle, count, draw), SMALL, n))
    chosen = _inside(candidates, label, rows, columns)
    counts = np.bincount(chosen.item[chosen.item >= 0], minlength=len(problem.scene.objects))
    candidates = []
    for n in np.nonzero(counts < OF_EACH)[0].tolist():
        row, column = np.nonzero(label == n)
        at = draw.integers(0, max(len(row), 1), OF_EACH if len(row) else 0)
        candidates.append((row[at], column[at], RANDOM, n))
        if not len(row):
            candidates.append((*_around(problem, n, middle, OF_EACH, draw), SMALL, n))
    pair = vars(chosen).values(), vars(_inside(candidates, label, rows, columns)).values()
    return Pixels(*map(np.concatenate, zip(*pair, strict=True)))


def radius_of(problem: Problem, depth: Array, moment: int) -> Array:
    """R in px for depths (rows, columns), for a lens that is constant over the frame."""
    step, half, power, _ = problem.moments.lenses[moment]
    return np.asarray(half / step * (power - 1.0 / depth))


def _outlines(label: NDArray[np.int64], radius: Array) -> tuple[NDArray[Any], ...]:
    """Rows and columns (n,) of pixels beside another object, and the larger |R| of both objects."""
    parts = []
    for axis in (0, 1):
        row, column = np.nonzero(np.diff(label, axis=axis))
        larger = np.maximum(*(np.delete(np.abs(radius), k, axis) for k in (-1, 0)))
        parts.append((row, column, larger[row, column]))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def extent_of(problem: Problem, number: int) -> Extent | None:
    """Image of an object at mid-exposure; None for a plane, quadric, cone, background, or object behind the lens."""
    item: Any = problem.scene.objects[number]
    shape, box = item.shape, problem.surfaces.shapes[1, number, :6].reshape(3, 2)
    if shape in ("plane", "quadric", "background", "cone"):
        return None
    places, half = np.zeros((1, 3)), np.full(3, getattr(item, "radius", 0.0))
    if shape == "ellipsoid":
        half = np.array(item.semi_axes)
    elif shape in ("rectangle", "disc"):
        half = np.array([*item.size, 0.0]) / 2
        places[0, 2] = item.offset
        if shape == "rectangle":
            places = places + LINE[:, None] * np.where(half == half.max(), half, 0.0)
    elif shape == "cylinder":
        axis = np.asarray(item.axis) / np.linalg.norm(item.axis)
        length = 2.0 * abs(problem.surfaces.shapes[2, number, 11])
        places = np.clip(LINE[:, None] * length * axis, box[:, 0], box[:, 1])
        half = half + 0.5 * np.ptp(places, axis=0)
    m = problem.moments.poses[len(problem.moments.poses) // 2, number]
    at = places[len(places) // 2] @ m[:9].reshape(3, 3) + m[9:]
    if at[2] <= 0:
        return None
    scale = 1.0 / (problem.moments.lenses[len(problem.moments.poses) // 2, 0] * at[2])
    sizes = np.sort(2.0 * half)[::-1] * scale
    return Extent(places, half, float(sizes[1]))


def places_of(problem: Problem, number: int, moment: int, points: Array) -> tuple[Array, Array, Array]:
    """Column, row and R in px of those points (n, 3) of an object's own frame that are in front of the lens."""
    m, n = problem.moments.poses[moment, number], problem.optics.numbers
    x, y, z = (points @ m[:9].reshape(3, 3) + m[9:]).T
    ahead = z > 0
    x, y, z = x[ahead] / z[ahead], y[ahead] / z[ahead], z[ahead]
    square, (k1, k2, k3, p1, p2) = x * x + y * y, n[6:11]
    q, along = 1 + square * (k1 + square * (k2 + square * k3)), 2 * (p2 * x + p1 * y)
    step = problem.moments.lenses[moment, 0]
    column = (x * q + along * x + p2 * square) / step + 0.5 * (n[0] - 1)
    row = 0.5 * (n[1] - 1) - (y * q + along * y + p1 * square) / step
    return column, row, radius_of(problem, z, moment)


def _around(problem: Problem, number: int, moment: int, count: int, draw: np.random.Generator) -> tuple[Array, Array]:
    """Random rows and columns (count,) in the blur of an object that may be smaller than pixels."""
    extent = extent_of(problem, number)
    points = np.zeros((1, 3)) if extent is None else extent.places
    column, row, radius = places_of(problem, number, moment, points)
    inside = (column > -0.5) & (column < problem.size[1] - 0.5) & (row > -0.5) & (row < problem.size[0] - 0.5)
    if not inside.any():
        return np.zeros(0), np.zeros(0)
    at = draw.choice(np.nonzero(inside)[0], count)
    far = (np.abs(radius[at]) + 1.0) * np.sqrt(draw.uniform(0, 1, count))
    angle = draw.uniform(0, 2 * np.pi, count)
    return np.rint(row[at] + far * np.sin(angle)), np.rint(column[at] + far * np.cos(angle))


def _inside(candidates: list[_Places], label: NDArray[np.int64], rows: int, columns: int) -> Pixels:
    """Candidate pixels that lie in the frame, without duplicates, and as many of outlines as COUNTS allows."""
    parts = [
        np.stack([row, column, np.full(len(row), kind), np.full(len(row), item)], axis=-1).astype(np.int64)
        for row, column, kind, item in candidates
    ]
    table = np.concatenate(parts) if parts else np.zeros((0, 4), np.int64)
    table = table[(table[:, 0] >= 0) & (table[:, 0] < rows) & (table[:, 1] >= 0) & (table[:, 1] < columns)]
    _, first = np.unique(table, axis=0, return_index=True)
    table = table[np.sort(first)]
    outlines = np.cumsum(table[:, 2] == OUTLINE)
    table = table[(table[:, 2] != OUTLINE) | (outlines <= COUNTS[OUTLINE])]
    visible = label[table[:, 0], table[:, 1]]
    return Pixels(table[:, 0], table[:, 1], table[:, 2], np.where(table[:, 3] >= 0, table[:, 3], visible))
