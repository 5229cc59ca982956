"""Soft depth edges: pixels with depths between those of two surfaces are assigned to one of them (float64, pure).

In a map that was averaged over pixels, resampled, blurred or compressed, the depth goes from one surface to the other
in a few steps. Each row and each column is searched separately for such runs of steps: all steps of a run have the same
sign, the middle ones are the steepest, and the surfaces at both ends are flat there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LEAST_STEP = 1.0  # smallest step of the blur radius at an edge, px, as for discontinuities (kernels/layered/layered.cl)
LONGEST = 8  # most steps on each side of the steepest: an edge at 45 degrees blurred by a Gaussian of 2 px has as many
SURFACE = 3  # number of pixels examined on each of the two surfaces
REACH = LONGEST + SURFACE - 1  # number of steps examined on each side of the steepest
LEAST = 0.05  # least step of an edge, as a share of its steepest step
ENDS = 4.0  # least ratio of an edge's last step to a step of the adjacent surface; at the limb of a sphere it is 3.2
FLAT = 0.25  # largest step on the surfaces, as a share of the steepest step
TAPER = 0.75  # largest outer step of a soft edge, as a share of the steepest step; ramps have larger ones
RAMP = 0.9  # least ratio of steps next to each other that have no edge
SHORT, FULL = 5, 0.7  # from SHORT pixels on, the mean step of an edge is at most FULL times the steepest
LEAST_STEEPEST = 0.1  # px, least steepest step; 0.07 of the whole edge from 1 to 10 m, blurred by 2 px
OVER, RINGING = 0.01, 0.15  # least and largest overshoot of an edge beyond a surface, as shares of the whole step
SETTLED = 0.4  # largest change of the surface behind an overshoot, as a share of the overshoot; 0.5 on a slanted plane
LARGER = 1.2  # ratio of steps above which an edge removes a smaller one whose surfaces have pixels of the larger edge
ROWS = 64  # number of rows whose steps are computed at once
PLACES = 1 << 14  # number of steep steps examined at once
COLOR_NOISE = 0.03  # least standard deviation of the surfaces' colors, as a share of the brighter one
AROUND = 8  # number of pixels on each surface from which the variance of its color is computed
SHIFT = 0.7  # standard deviation of the distance between an edge in depth and in color, px
MIXED = 5.0  # standard deviations from all mixtures of both colors, beyond which a color belongs to a third surface


@dataclass(frozen=True, eq=False)
class _Edges:
    """Soft edges crossed by lines (rows or columns), one per entry.

    line: number of the line. first: position in the line of the first surface's last pixel; the next `count` pixels are
    between the two surfaces. step: change of blur radius over the whole edge, signed, px. begin, end: radius of the
    first and of the second surface at the pixel next to the edge. begin_slope, end_slope: change of this radius per
    pixel away from the edge. begin_over, end_over: number of pixels next to the edge that overshoot, or that the last
    step of the edge has changed a little.
    """

    line: Indices
    first: Indices
    count: Indices
    step: Array
    begin: Array
    end: Array
    begin_slope: Array
    end_slope: Array
    begin_over: Indices
    end_over: Indices

    def __getitem__(self, chosen: NDArray[Any]) -> _Edges:
        return _Edges(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def assign_soft_edges(
    radius: Array, stored: Array | None = None, image: Callable[[], NDArray[Any]] | None = None
) -> tuple[Indices, Array]:
    """Find the pixels of a map whose depth is between two surfaces, and assign each of them to one of the two.

    Parameters
    ----------
    radius : ndarray (rows, columns)
        Any quantity linear in the inverse depth, in px of the blur radius; NaN without a surface.
    stored : ndarray (rows, columns), optional
        The values that were averaged or blurred, such as the depth, if they are not linear in the radius; NaN without a
        surface. An edge lies where they reach half of their step.
    image : callable, optional
        Returns linear radiance (rows, columns[, channels]); called only if there is a soft edge. If the surfaces differ
        in color, a pixel is assigned to the surface whose color is closer.

    Returns
    -------
    ndarray (pixels,)
        Flat indices of the pixels between two surfaces.
    ndarray (pixels,)
        For each of them, `radius` of the surface to which it is assigned.

    Notes
    -----
    The following are not found: edges between surfaces that differ by less than LEAST_STEP; steps without a pixel in
    between, as at hard edges and stairs; ramps; the limb of a sphere, as neighboring lines have no such edge; and edges
    of one or two pixels, one of which has a color that is no mixture of the two surfaces' colors.
    """
    pixels, values = _found(radius, stored, image)
    if not len(pixels):
        return pixels, values
    clean = radius.astype(np.float64)
    clean.flat[pixels] = values
    more, again = _found(clean, None, image)  # edges that become visible after the first ones are removed
    clean.flat[more] = again
    pixels = np.union1d(pixels, more)
    return pixels, np.clip(clean.flat[pixels], np.nanmin(radius), np.nanmax(radius))


def _found(radius: Array, stored: Array | None, image: Callable[[], NDArray[Any]] | None) -> tuple[Indices, Array]:
    """One pass of `assign_soft_edges`: indices of the pixels between two surfaces, and their new radii."""
    height, width = radius.shape
    shapes = [radius] if stored is None else [stored, radius]  # edges are symmetric in whichever was blurred
    stored = shapes[0]
    with np.errstate(invalid="ignore", divide="ignore"):  # for infinite and missing depths
        across, down = _steep(radius)
        rows = _soft_edges(radius, shapes, *across)
        columns = _soft_edges(radius.T, [shape.T for shape in shapes], *down)
    rows, columns = _between_surfaces(rows, columns, width)
    if not len(rows.line) + len(columns.line):
        return np.zeros(0, np.intp), np.zeros(0)
    light = None if image is None else image().reshape(height, width, -1)
    line, place, *row = _assigned(rows, stored, light)
    column_line, column_place, *column = _assigned(columns, stored.T, None if light is None else light.swapaxes(0, 1))
    pixel = np.concatenate([line * width + place, column_place * width + column_line])
    value, step, count = (np.concatenate(pair) for pair in zip(row, column, strict=True))
    order = np.lexsort((count, -np.abs(step), pixel))  # if two edges share a pixel, the larger wins, then the shorter
    pixel, at = np.unique(pixel[order], return_index=True)
    return pixel, value[order][at]


def _soft_edges(radius: Array, shapes: list[Array], line: Indices, column: Indices) -> _Edges:
    """Soft edges that rows cross in any of the maps `shapes`; line, column: of the steep steps, from `_steep`."""
    begins = range(0, max(len(line), 1), PLACES)
    parts = [_edges(radius, s, line[n : n + PLACES], column[n : n + PLACES]) for n in begins for s in shapes]
    joined = (np.concatenate([getattr(part, name) for part in parts]) for name in _Edges.__dataclass_fields__)
    return _supported(_Edges(*joined), radius.shape[1])


def steepest_step(radius: NDArray[Any]) -> float:
    """Largest difference of two neighbors of a row or column of a map (rows, columns); NaN if values are."""
    steps = [float(max(part.max(), -part.min())) for _, parts in _strips(radius) for part in parts if part.size]
    return max(steps, default=0.0)


def _strips(radius: NDArray[Any]) -> Iterator[tuple[int, tuple[NDArray[Any], NDArray[Any]]]]:
    """First rows of strips of a map, and in each the steps to the right and those down."""
    for top in range(0, len(radius), ROWS):
        strip = radius[top : top + ROWS + 1]
        yield top, (strip[:ROWS, 1:] - strip[:ROWS, :-1], strip[1:] - strip[:-1])


def _steep(radius: Array) -> tuple[tuple[Indices, Indices], tuple[Indices, Indices]]:
    """Lines, and positions in them, of the steps that are large enough to be the steepest step of an edge: for rows,
    and for columns.
    """
    ways: tuple[list[NDArray[np.intp]], ...] = ([np.zeros((2, 0), np.intp)], [np.zeros((2, 0), np.intp)])
    for top, parts in _strips(radius):
        for places, steps in zip(ways, parts, strict=True):
            place = np.flatnonzero(np.abs(steps) >= LEAST_STEEPEST)
            row, column = np.divmod(place, max(steps.shape[1], 1))
            places.append(np.stack([row + top, column]))
    (row, column), (down_row, down_column) = (np.concatenate(places, axis=1) for places in ways)
    order = np.argsort(down_column, kind="stable")
    return (row, column), (down_column[order], down_row[order])


def _edges(radius: Array, stored: Array, line: Indices, column: Indices) -> _Edges:
    """Soft edges whose steepest step is from pixel `column` to `column` + 1 of `line`."""
    near = _steps(stored, line, column, 2)
    near /= near[:, 2:3].copy()
    some = (np.abs(near[:, 1]) < 1) & (np.abs(near[:, 3]) <= 1) & (near >= -FLAT).all(axis=1)
    some &= (near[:, 1] > LEAST) | (near[:, 3] > LEAST)  # hard edges have one step
    some &= near.min(axis=1) <= RAMP
    line, column = line[some], column[some]
    window = _steps(stored, line, column, REACH)
    window /= window[:, REACH : REACH + 1].copy()
    before, after = _length(window[:, :REACH][:, ::-1]), _length(window[:, REACH + 1 :])
    n, count = np.arange(len(line)), before + after
    outer = np.maximum(window[n, REACH - np.maximum(before, 0)], window[n, REACH + np.maximum(after, 0)])
    inside = np.abs(np.arange(2 * REACH + 1) - REACH + 0.5 * (before - after)[:, None]) <= 0.5 * count[:, None]
    soft = (before >= 0) & (after >= 0) & (count >= 1) & (np.abs(before - after) <= 1 + 3 * np.minimum(before, after))
    soft &= (count == 1) | (outer <= TAPER)
    soft &= (column >= before + 1) & (column + after <= stored.shape[1] - 3)  # the map has two pixels of each surface
    soft &= (count < SHORT) | ((window * inside).sum(axis=1) <= FULL * (count + 1))
    line, first, count = line[soft], (column - before)[soft], count[soft]
    last = first + count + 1
    step = radius[line, last] - radius[line, first]
    begin, end = (_surface(radius, stored, line, *ends) for ends in ((first, last, -1), (last, first, 1)))
    edges = _Edges(line, first, count, step, begin[0], end[0], begin[1], end[1], begin[2], end[2])
    return edges[np.abs(edges.end - edges.begin) >= LEAST_STEP]


def _steps(stored: Array, line: Indices, column: Indices, reach: int) -> Array:
    """Steps (places, 2 reach + 1) up to `reach` before and after each place, 0 beyond the border."""
    at = column[:, None] + np.arange(-reach, reach + 1)
    inside = np.clip(at, 0, stored.shape[1] - 2)
    steps = stored[line[:, None], inside + 1] - stored[line[:, None], inside]
    return np.where(at == inside, steps, 0.0)


def _length(steps: Array) -> Indices:
    """Number of steps on one side of the steepest that are part of each edge; -1 if no flat surface follows them.

    steps: (edges, REACH), from the steepest outwards, in multiples of the steepest.
    """
    run = np.minimum.accumulate(steps > LEAST, axis=1).sum(axis=1)
    lengths = np.full(len(steps), -1)
    for n in range(LONGEST + 1):
        outside = steps[:, n : n + SURFACE - 1]
        flat = (np.abs(outside) <= FLAT).all(axis=1)
        ends = steps[:, n - 1] >= ENDS * outside.min(axis=1) if n else True
        lengths[flat & ends & (n <= run)] = n
    return np.where(run <= LONGEST, lengths, -1)


def _surface(
    radius: Array, stored: Array, line: Indices, place: Indices, other: Indices, way: int
) -> tuple[Array, Array, Indices]:
    """Blur radius of a surface next to an edge, its slope away from the edge, and the number of its pixels with another
    radius.

    place, other: columns of the last pixel of this and of the other surface; way: direction from the edge, 1 or -1.
    """
    at = line[:, None], np.clip(place[:, None] + way * np.arange(2 * SURFACE), 0, radius.shape[1] - 1)
    values, shape = radius[at], stored[at]
    changes = np.diff(values, axis=1)
    rising, falling = (changes > 0).all(axis=1), (changes < 0).all(axis=1)
    slope = np.where(rising, changes.min(axis=1), np.where(falling, changes.max(axis=1), 0.0))
    value = np.median(values[:, :SURFACE] - slope[:, None] * np.arange(SURFACE), axis=1)
    step = stored[line, place] - stored[line, other]
    level = np.median(shape[:, SURFACE:], axis=1)
    beyond = (shape[:, :SURFACE] - level[:, None]) / step[:, None]
    most, spread = beyond.max(axis=1), np.ptp(shape[:, SURFACE:], axis=1) / np.abs(step)
    over = np.where(beyond > OVER, np.arange(1, SURFACE + 1), 0).max(axis=1)
    over[(most > RINGING) | (spread > np.maximum(2 * OVER, SETTLED * most))] = 0
    level, mixed = np.median(values[:, SURFACE:], axis=1), (values[:, 0] - value) / (radius[line, other] - value)
    own = value, slope, (mixed > 0) & (mixed <= LEAST)  # the last step of an edge may be too small to be found
    return tuple(np.where(over > 0, *each) for each in zip((level, 0.0, over), own, strict=True))


def _supported(edges: _Edges, columns: int) -> _Edges:
    """Select edges that continue in the line above or below, up to two pixels to the side."""
    middle = edges.first + (edges.count + 1) // 2
    width = columns + 4
    supported = np.zeros(len(middle), np.bool_)
    for rising in (False, True):
        same = (edges.step > 0) == rising
        place = edges.line[same] * width + middle[same]
        near = [place + up * width + aside for up in (-1, 1) for aside in range(-2, 3)]
        supported[same] = np.isin(near, place).any(axis=0)
    return edges[supported]


def _between_surfaces(rows: _Edges, columns: _Edges, width: int) -> tuple[_Edges, _Edges]:
    """Remove edges whose surfaces have pixels that are inside a larger edge, in the same or the other direction."""

    def pixels(edges: _Edges, place: Indices) -> Indices:
        line = edges.line[:, None]
        return line * width + place if edges is rows else place * width + line

    inner = []
    for edges in (rows, columns):
        step = np.arange(1, int(edges.count.max(initial=0)) + 1)
        between = step <= edges.count[:, None]
        size = np.broadcast_to(np.abs(edges.step)[:, None], between.shape)
        inner.append((pixels(edges, edges.first[:, None] + step)[between], size[between]))
    pixel, size = (np.concatenate(pair) for pair in zip(*inner, strict=True))
    order = np.lexsort((-size, pixel))
    pixel, at = np.unique(pixel[order], return_index=True)
    size = np.append(size[order][at], 0.0)
    pixel = np.append(pixel, -1)
    selected = []
    for edges in (rows, columns):
        side, last = np.arange(SURFACE), edges.first + edges.count + 1
        own = np.hstack([pixels(edges, edges.first[:, None] - side), pixels(edges, last[:, None] + side)])
        at = np.searchsorted(pixel[:-1], own)
        larger = (pixel[at] == own) & (size[at] > LARGER * np.abs(edges.step)[:, None])
        selected.append(edges[~larger.any(axis=1)])
    return selected[0], selected[1]


def _assigned(
    edges: _Edges, stored: Array, image: NDArray[Any] | None
) -> tuple[Indices, Indices, Array, Array, Indices]:
    """Line, position in the line and new radius of each pixel to be changed, and the step and the count of its edge."""
    most = int(edges.count.max(initial=0))
    inner = np.arange(1, most + 1)
    between = inner <= edges.count[:, None]
    places = edges.first[:, None] + np.where(between, inner, 0)
    line, last = edges.line[:, None], edges.first + edges.count + 1
    own = stored[line, places]
    ends = stored[edges.line, edges.first], stored[edges.line, last]
    half = 0.5 * (ends[0] + ends[1])
    cut = (between & ((own > half[:, None]) != (ends[1] > ends[0])[:, None])).sum(axis=1)  # pixels of the first surface
    mixed = np.ones(len(edges.line), np.bool_)
    if image is not None:
        cut, mixed = _cut_by_color(image, edges, places, between, _half_way(stored, edges, cut, half))
    step = np.arange(1 - SURFACE, most + SURFACE + 1)
    chosen = (step > -edges.begin_over[:, None]) & (step <= (edges.count + edges.end_over)[:, None]) & mixed[:, None]
    first = edges.begin[:, None] - edges.begin_slope[:, None] * step
    second = edges.end[:, None] - edges.end_slope[:, None] * (edges.count[:, None] + 1 - step)
    value = np.where(step <= cut[:, None], first, second)
    place = edges.first[:, None] + step
    size = (np.broadcast_to(each[:, None], chosen.shape)[chosen] for each in (edges.step, edges.count))
    lines = np.broadcast_to(line, chosen.shape)
    inside = np.clip(place, 0, stored.shape[1] - 1)
    return lines[chosen], inside[chosen], value[chosen], *size


def _half_way(stored: Array, edges: _Edges, cut: Indices, half: Array) -> Array:
    """Place at which `stored` passes half of its step, as a fractional number of pixels of the first surface."""
    before = stored[edges.line, edges.first + cut]
    after = stored[edges.line, edges.first + cut + 1]
    step = np.where(after == before, 1.0, after - before)
    return cut + np.clip((half - before) / step, 0.0, 1.0) - 0.5


def _cut_by_color(
    image: NDArray[Any], edges: _Edges, places: Indices, between: NDArray[np.bool_], where: Array
) -> tuple[Indices, NDArray[np.bool_]]:
    """Likeliest number of pixels of the first surface in each edge, and a mask of the edges to be used.

    The mask excludes edges of one or two pixels if the color of one is no mixture of the two surfaces' colors. places:
    (edges, most), positions of pixels in their lines; between: (edges, most), mask of the pixels inside the edge;
    where: fractional number of pixels of the first surface, according to depth.
    """
    line, side = edges.line[:, None], np.arange(AROUND)
    last = edges.first + edges.count + 1
    ends = [np.clip(place, 0, image.shape[1] - 1) for place in (edges.first[:, None] - side, last[:, None] + side)]
    colors = [image[line, place].astype(np.float64) for place in ends]  # (edges, AROUND, channels)
    mean = [color[:, :SURFACE].mean(axis=1) for color in colors]
    floor = COLOR_NOISE**2 * np.maximum(*((each**2).sum(axis=1) for each in mean))
    spread = sum(color.var(axis=1).sum(axis=1) for color in colors) / 2 + np.maximum(floor, 1e-12)
    own = image[line, places].astype(np.float64)
    away = [((own - each[:, None]) ** 2).sum(axis=2) * between for each in mean]
    first, second = (each / (2.0 * spread[:, None]) for each in away)
    zero = np.zeros((len(first), 1))
    cost = np.hstack([zero, np.cumsum(first - second, axis=1)])  # (edges, 1 + most), by number of first-surface pixels
    number = np.arange(cost.shape[1])
    cost += (number - where[:, None]) ** 2 / (2.0 * SHIFT**2)
    cost[number > edges.count[:, None]] = np.inf
    across = mean[1] - mean[0]
    square = np.maximum((across**2).sum(axis=1), 1e-12)
    share = np.clip(((own - mean[0][:, None]) * across[:, None]).sum(axis=2) / square[:, None], 0.0, 1.0)
    off = ((own - mean[0][:, None] - share[..., None] * across[:, None]) ** 2).sum(axis=2)
    strange = (between & (off > MIXED**2 * spread[:, None])).any(axis=1)
    return cost.argmin(axis=1), ~(strange & (edges.count <= 2))
