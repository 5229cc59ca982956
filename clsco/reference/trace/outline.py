"""Coverage at outlines, in NumPy float64: the areas that sub-pixel sources represent, in their own and adjacent cells.

The formulas are at the head of kernels/trace/outline.clh. Arrays of cells are (S + 2, S + 2) for each pixel: its own
cells, S x S, surrounded by one row or column of cells of each neighbor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens import ray_step
from clsco.reference.common.geometry import Array, blur_radius, both_roots, pixel_ray, quarter_discriminant, turned
from clsco.reference.trace.view import View

UNMARKED = 255  # the label of cells without sources of their own
SHARP_OUTLINE = 1.5  # px, blur radius below which the squares between cells of several pixels are cut at outlines
LEAST_PART = 1e-6  # least covered share of a square for which an empty cell becomes a source
Labels = NDArray[np.uint8]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Coverage:
    """Coverage of the cells of M pixels, arrays (M, S + 2, S + 2), complete only for the pixels' own cells.

    covered: area that a source represents, in cells; right, down: position relative to the cell's middle, in cells,
    where the source's radius, tilt and radiance are evaluated; label: label of each cell, also of empty cells that a
    surface covers in part. For the latter cells, part: covered area; step_x, step_y: displacement to the middle of a
    full cell.
    """

    covered: Array
    right: Array
    down: Array
    label: Labels
    part: Array
    step_x: Array
    step_y: Array


def root_margins(view: View, label: int, rays: Array) -> tuple[Array, Array]:
    """Inverse depth (n,) of a root along rays (n, 3), and the conditions of its visibility (conditions, n).

    A condition is negative where it is violated. If a ray misses the surface, values are those at the closest approach.
    """
    number = (label - 1) // 2
    surface, box = view.surfaces[number], view.bounds[number]
    shape, d, own_rays = surface.canonical, turned(surface.turn, rays), turned(surface.own_turn, rays)
    a, b = (shape.q * d * d).sum(axis=-1), ((shape.q * surface.offset + shape.l) * d).sum(axis=-1)
    discriminant = quarter_discriminant(surface, d)
    plus, minus = both_roots(surface, a, b, np.sqrt(np.maximum(discriminant, 0.0)))
    # Of the two roots of a plane one is 0; which one changes at the horizon.
    w = (plus if label & 1 else minus) if shape.q.any() else plus + minus
    margins = [discriminant, w, shape.nappe * (surface.offset[2] * w + d[..., 2])]
    for axis, (low, high) in enumerate(box or ()):
        position = surface.own_offset[axis] * w + own_rays[..., axis]
        margins += [position - low * w] if low > -np.inf else []
        margins += [high * w - position] if high < np.inf else []
    if shape.radius < np.inf:
        margins.append(shape.radius * w - np.hypot(*(surface.offset[:2] * w[:, None] + d[:, :2]).T))
    return w, np.stack(margins)


def is_curved(view: View, label: int) -> bool:
    """True for a label of a surface that is not a plane."""
    return 0 < label < UNMARKED and bool(view.surfaces[(label - 1) // 2].canonical.q.any())


def is_at_limb(view: View, label: int, rays: Array, samples: int) -> Array:
    """True (n,) for rays (n, 3) that hit the front of a curved surface less than half a cell from its limb.

    The distance is estimated from the discriminant and its slopes. samples: cells per pixel along each axis.
    """
    surface = view.surfaces[(label - 1) // 2]
    if not is_curved(view, label) or (label % 2 == 1) != (surface.constant > 0.0):
        return np.zeros(len(rays), dtype=bool)
    discriminant = quarter_discriminant(surface, turned(surface.turn, rays))
    steps = ray_step(view.camera) / samples * np.eye(3)[:2]
    slopes = [quarter_discriminant(surface, turned(surface.turn, rays + step)) - discriminant for step in steps]
    return np.asarray(4.0 * discriminant**2 < slopes[0] ** 2 + slopes[1] ** 2)


def end_of_root(view: View, label: int, start: Array, stop: Array) -> Array:
    """Fraction (n,) of the way from rays `start` (n, 3) to `stop` where a root, visible at `start`, ends; else 1."""
    at_start, at_stop = (root_margins(view, label, rays)[1] for rays in (start, stop))
    inside, fails = np.maximum(at_start, 0.0), at_stop < 0.0
    return np.asarray(np.where(fails, inside / np.where(fails, inside - at_stop, 1.0), 1.0).min(axis=0))


def outline_place(view: View, first: int, second: int, start: Array, stop: Array) -> Array:
    """Fraction (n,) of the way from rays `start` (n, 3) to `stop` at which label `first` changes to `second`."""
    end = end_of_root(view, first, start, stop) if first else np.ones(len(start))
    begin = end_of_root(view, second, stop, start) if second else np.ones(len(start))
    through = np.full(len(start), 0.5)
    if first and second:
        # The two surfaces pass through one another.
        at_start, at_stop = (
            sign * (root_margins(view, first, rays)[0] - root_margins(view, second, rays)[0])
            for sign, rays in ((1.0, start), (-1.0, stop))
        )
        usable = (at_start >= 0.0) & (at_stop >= 0.0) & (at_start + at_stop > 0.0)
        through = np.where(usable, at_start / np.where(usable, at_start + at_stop, 1.0), 0.5)
    return np.where(end < 1.0, end, np.where(begin < 1.0, 1.0 - begin, through))


def labels_around(row: Index, column: Index, label: Labels, shape: tuple[int, int]) -> Labels:
    """Labels (M, S + 2, S + 2) of the cells (M, S, S) of pixels and of the surrounding cells, on a grid of `shape`."""
    samples = label.shape[1]
    slot = np.full((shape[0] + 2, shape[1] + 2), -1)
    slot[row + 1, column + 1] = np.arange(len(row))
    cells = np.concatenate([label, np.full((1, samples, samples), UNMARKED, np.uint8)])
    sides = ((0, slice(0, 1), slice(-1, None)), (1, slice(1, -1), slice(None)), (2, slice(-1, None), slice(0, 1)))
    around = np.empty((len(row), samples + 2, samples + 2), np.uint8)
    for below, rows, inner_rows in sides:
        for beside, columns, inner_columns in sides:
            around[:, rows, columns] = cells[slot[row + below, column + beside]][:, inner_rows, inner_columns]
    return around


def crossing_between(view: View, row: Index, column: Index, label: Labels, first: Index, second: Index) -> Array:
    """Fractions (M, sides) of the way from `first` to `second` cells at which there is an outline, -1 for none.

    row, column: (M,) of the pixels; label: (M, S + 2, S + 2) of their cells; first, second: (sides,), flat indices of
    cells.
    """
    side = label.shape[1]
    flat = label.reshape(len(label), side * side)
    pairs = np.stack([flat[:, first], flat[:, second]], axis=-1)
    crossed = (pairs[..., 0] != pairs[..., 1]) & (pairs != UNMARKED).all(axis=-1)
    fractions = np.full(crossed.shape, -1.0)
    for first_label, second_label in {*map(tuple, pairs[crossed].tolist())}:
        pixel, edge = np.nonzero(crossed & (pairs == (first_label, second_label)).all(axis=-1))
        rays = []
        for cell in (first[edge], second[edge]):
            down, right = ((n - 0.5) / (side - 2) - 0.5 for n in np.divmod(cell, side))
            rays.append(pixel_ray(view.camera, row[pixel] + down, column[pixel] + right))
        fractions[pixel, edge] = outline_place(view, first_label, second_label, *rays)
    return fractions


def mean_above(first: Array, last: Array) -> Array:
    """Mean (n,) of max(0, y) along lines on which y goes from `first` to `last` (n,)."""
    low, high = np.minimum(first, last), np.maximum(first, last)
    above = 0.5 * high * high / np.maximum(high - low, 1e-30)
    return np.where(low >= 0.0, 0.5 * (low + high), np.where(high <= 0.0, 0.0, above))


def quarter_beside(top: Array, bottom: Array, row: NDArray[np.intp], column: NDArray[np.intp]) -> Array:
    """Area (n,) of the part of a unit square's quarter that is left of a straight line.

    row, column: 0 or 1 (n,), the quarter. The line goes from x = top (n,) on the upper side to x = bottom (n,) on the
    lower.
    """
    step = 0.5 * (bottom - top)
    first = top + row * step - 0.5 * column
    return np.asarray(0.5 * (mean_above(first, first + step) - mean_above(first - 0.5, first + step - 0.5)))


def cut_square(coverage: Coverage, label: Labels, i: int, j: int, place: Array, surface_label: Labels) -> None:
    """Assign the area that a surface covers in squares (n,) to its cells in the same pixel, or to empty cells.

    label: (n, S + 2, S + 2); i, j: the upper left cell of the square; place: (4, n), where an outline crosses the top,
    bottom, left and right sides; surface_label: (n,), label of the surface, 0 to skip a square.
    """
    side, index = label.shape[1], np.arange(len(surface_label))
    along = (place[2] >= 0.0) & (place[3] >= 0.0)
    corner = ~along & ~((place[0] >= 0.0) & (place[1] >= 0.0))
    # The corner beside the line, or the one that the line cuts off; rows and columns count from this corner.
    row, column = ((corner & (edge >= 0.0)).astype(np.intp) for edge in (place[1], place[3]))
    first, last = np.where(along, place[2], place[row, index]), np.where(along, place[3], place[1])
    below = np.where(row == 1, 1.0 - place[2 + column, index], place[2 + column, index])
    across = np.where(column == 1, 1.0 - first, first)
    last = np.where(corner, across - across / np.maximum(below, 1e-6), last)
    first = np.where(corner, across, first)
    beside = label[index, i + row, j + column] == surface_label
    cells = [(y, x) for y in (i, i + 1) for x in (j, j + 1) if 0 < y < side - 1 and 0 < x < side - 1]
    areas = []
    for y, x in cells:
        at = (np.abs(y - i - row), np.abs(x - j - column))
        part = quarter_beside(first, last, *(np.where(along, *pair) for pair in (at[::-1], at)))
        areas.append(np.where(beside, part, 0.25 - part))
    on_surface = [(surface_label > 0) & (label[:, y, x] == surface_label) for y, x in cells]
    count, total = np.sum(on_surface, axis=0), np.sum(areas, axis=0)
    for (y, x), area, covers in zip(cells, areas, on_surface, strict=True):
        coverage.covered[:, y, x] += np.where(covers, total / np.maximum(count, 1) - 0.25, 0.0)
        # The surface is hit in the middle of its nearest cell, which is in another pixel.
        empty = (surface_label > 0) & (count == 0) & (area > LEAST_PART)
        aside, down = (1 if x == j else -1), (1 if y == i else -1)
        is_beside, is_below = (label[:, y, x + aside] == surface_label), (label[:, y + down, x] == surface_label)
        coverage.part[:, y, x] += np.where(empty, area, 0.0)
        coverage.label[empty, y, x] = surface_label[empty]
        coverage.step_x[empty, y, x] = np.where(is_beside | ~is_below, aside, 0.0)[empty]
        coverage.step_y[empty, y, x] = np.where(is_beside, 0.0, down)[empty]


def cut_label(view: View, corners: Labels, rays: Array) -> Labels:
    """Labels (n,) of the surfaces near the focus for which squares are cut; 0 for no cut, as with two surfaces.

    corners: (n, 2, 2), labels of the cells at the squares' corners; rays: (n, 3), through the centers of the squares.
    """
    labels = corners.max(axis=(1, 2))
    alone = ((corners == 0) | (corners == labels[:, None, None])).all(axis=(1, 2))
    for label in {*labels.tolist()} - {0, UNMARKED}:
        mask = labels == label
        w, _ = root_margins(view, label, rays[mask])
        alone[mask] &= np.abs(blur_radius(view.lens, rays[mask], w)) < SHARP_OUTLINE
    return np.asarray(labels * alone)


def share_square(
    coverage: Coverage, curved: NDArray[np.bool_], i: int, j: int, place: Array, cut: NDArray[np.bool_]
) -> None:
    """Add to a surface's cells the area that it covers in squares (n,) between four cells, minus the cells' quarters.

    curved: (n, S + 2, S + 2), True if a cell's surface is curved; place: as for `cut_square`, -1 for a side that no
    outline crosses (an outline crosses two sides); cut: (n,), squares that `cut_square` handles.
    """
    top, bottom, left, right = place
    corners = ((i, j), (i, j + 1)), ((i + 1, j), (i + 1, j + 1)), ((i, j), (i + 1, j)), ((i, j + 1), (i + 1, j + 1))
    straight = (top < 0.0) == (bottom < 0.0)
    for number, (cells, crossing) in enumerate(zip(corners, place, strict=True)):
        moved = coverage.right if number < 2 else coverage.down
        crossed, offset = crossing >= 0.0, crossing - 0.5
        for cell, sign in zip(cells, (1.0, -1.0), strict=True):
            # Where the cell's source is evaluated, in cells from its middle.
            shift = np.where(curved[:, *cell], 0.75 * offset + sign * 0.25, 0.5 * offset)
            moved[:, *cell] += np.where(crossed, np.where(straight, 0.5, 0.25) * shift, 0.0)
            coverage.covered[:, *cell] += np.where(crossed & straight & ~cut, sign * 0.5 * offset, 0.0)
    # One corner against three.
    for row, across in enumerate((top, bottom)):
        for column, along in enumerate((left, right)):
            usable = ~straight & ~cut & (across >= 0.0) & (along >= 0.0)
            x, y = (np.where(turned_over, 1.0 - n, n) for turned_over, n in ((column, across), (row, along)))
            offset = np.where(usable, 0.5 * x * y - 0.25, 0.0)
            coverage.covered[:, i + row, j + column] += offset
            coverage.covered[:, i + row, j + 1 - column] -= 0.5 * offset
            coverage.covered[:, i + 1 - row, j + column] -= 0.5 * offset


def cell_coverage(view: View, row: Index, column: Index, label: Labels) -> Coverage:
    """Coverage of the cells of pixels (M,), with labels from `labels_around`."""
    side = label.shape[1]
    cell = np.arange(side * side).reshape(side, side)
    across, along = (
        crossing_between(view, row, column, label, first.ravel(), second.ravel())
        for first, second in ((cell[:, :-1], cell[:, 1:]), (cell[:-1], cell[1:]))
    )
    across, along = across.reshape(-1, side, side - 1), along.reshape(-1, side - 1, side)
    right, down, part, step_x, step_y = np.zeros((5, *label.shape))
    coverage = Coverage(np.ones(label.shape), right, down, label.copy(), part, step_x, step_y)
    curved = np.array([is_curved(view, n) for n in range(2 * len(view.surfaces) + 1)] + [False])
    curved = curved[np.where(label == UNMARKED, len(curved) - 1, label)]
    for i in range(side - 1):
        for j in range(side - 1):
            edges = np.stack([across[:, i, j], across[:, i + 1, j], along[:, i, j], along[:, i, j + 1]])
            marked = (label[:, i : i + 2, j : j + 2] != UNMARKED).all(axis=(1, 2))
            # Squares with three surfaces, or with two outlines, keep the quarters.
            usable = marked & ((edges >= 0.0).sum(axis=0) == 2)
            if usable.any():
                places, cut = np.where(usable, edges, -1.0), np.zeros(len(label), np.uint8)
                if i % (side - 2) == 0 or j % (side - 2) == 0:
                    rays = pixel_ray(view.camera, row + i / (side - 2) - 0.5, column + j / (side - 2) - 0.5)
                    cut = usable * cut_label(view, label[:, i : i + 2, j : j + 2], rays)
                    cut_square(coverage, label, i, j, places, cut)
                share_square(coverage, curved, i, j, places, cut > 0)
    covered = coverage.part > 0.0
    for name, new in (("covered", "part"), ("right", "step_x"), ("down", "step_y")):
        getattr(coverage, name)[covered] = getattr(coverage, new)[covered]
    return coverage
