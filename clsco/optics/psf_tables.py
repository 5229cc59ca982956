"""Tables of PSF weights over the blur radius, as piecewise cubics in the layout that kernels read (float64, pure)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf

import numpy as np
from numpy.typing import NDArray

from clsco.constants import POWERS, TAP_LANES, WIDE_LANES
from clsco.errors import SceneError
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_blocks import OUTLINE, OUTLINE_RUN, WeightBlock, weight_block
from clsco.optics.psf_grid import (
    block_intervals,
    half_width,
    half_widths,
    octant_taps,
    row_lanes,
    span_of,
    table_coordinate,
    table_radius,
)
from clsco.optics.ray_means import has_ray_means, ray_floats

Floats = NDArray[np.float32]
LARGEST_TABLES = 2**30  # bytes
SHARED_BYTES = 2**26  # largest table that is rounded to whole blocks, so that other ranges share it
Blocks = Callable[[PointSpread, int, int], WeightBlock]
"""Function like `weight_block`: takes a PSF, the first interval and sub-pixel sources per axis; returns the block."""
Join = Callable[[list[Floats]], Floats]
"""Function that concatenates arrays."""


@dataclass(frozen=True)
class PsfTable:
    """Weights for a range of blur radii as piecewise cubics, in the layout that kernels read.

    A source of radius R has the coordinate u (see `clsco.optics.psf_grid.table_coordinate`), interval floor(u) and
    position t = u - floor(u); its weight at (dx, dy) is c0 + t (c1 + t (c2 + t c3)). A main table is for sources at
    pixel centers; other tables are for S x S sub-pixel sources in each pixel.

    first, count: number of the first interval, and number of intervals. low, end: intervals of the radii that the table
    was made for, to which other radii are clamped. reach: largest half-width among these intervals.
    intervals: int32 (count, 2): start in `coefficients`, half-width in px. A signed shape has `count` more entries, for
    negative radii. Weights of either sign are stored up to `PointSpread.most`.
    coefficients: float32, rows of (POWERS, lanes) for each interval. A main table has rows |dy| = 0..half-width, or one
    row if separable. A table of sub-pixel sources has rows -half-width..half-width for S/2 x S of their offsets. For a
    general shape, either has rows -half-width..half-width, for all S x S offsets.
    taps: the same weights again for a main table, else empty: float32 (taps, count / TAP_LANES, POWERS, WIDE_LANES),
    in windows of WIDE_LANES intervals from every TAP_LANES-th interval on. Taps are a >= b >= 0 of an octant, in the
    order of a (a + 1) / 2 + b; for a separable shape, the taps along an axis; for a ring, preceded by the weight inside
    the ring. Coefficients are 0 beyond an interval's reach, and after the last interval.
    outlines: int32 (count, reach + 1, 2) for a main table, else empty, see `clsco.optics.psf_blocks._outline`; for a
    ring (.., 4), see `clsco.optics.psf_blocks._ring_outline`; empty for a separable shape.
    General shapes, unless spread by waves or aberrations: taps (.., POWERS, WIDE_LANES) hold for each window the weight
    of runs, then for all dx from the left the weights of all dy, as far as the window's widest interval reaches;
    outlines (.., 4) hold `_share_outlines` for each interval and dx, then for each window its start in taps and its
    number of dy. Sampled discs: coefficients and taps hold the one weight of each interval, and outlines the square
    roots of 0, 1, ... up to the last interval's number, rounded down.
    stride: coefficients per position of a field (`PointSpread.places`), whose coefficients are concatenated.
    place: cache key; a table for more radii replaces an earlier table with the same key.
    """

    first: int
    low: int
    end: int
    intervals: NDArray[np.int32]
    coefficients: Floats
    reach: int
    count: int
    taps: Floats
    outlines: NDArray[np.int32]
    stride: int = 0
    place: Hashable = None


def psf_features(psf: PointSpread) -> dict[str, int]:
    """Compile-time features of kernels for a PSF; EDGES is the number of straight edges of its pupil."""
    layouts = {name.upper(): int(psf.layout == name) for name in ("disc", "separable", "general")}
    features = layouts | {"SAMPLED": int(psf.sampled), "EDGES": len(psf.pupil.edges)}
    features |= {"RIMS": len(psf.rims), "WAVES": int(psf.diffracted), "RING": int(psf.pupil.hollow)}
    features |= {"CUT_CHORDS": psf.cut_by_chords * (2 if psf.edge == "area" else 1)}
    features |= {"BORDERS": int(psf.cut_by_chords and psf.pupil.borders is not None)}
    return features | {"FIELD": int(psf.varying is not None), "ELLIPSES": int(psf.stretched > 0.0)}


@lru_cache(maxsize=256)
def table_sizes(psf: PointSpread, smallest: float, largest: float, subpixel: int = 0) -> Mapping[str, int]:
    """Size in bytes of each array of `psf_table` with the same arguments, by name."""
    return span_sizes(psf, rounded_span(psf, smallest, largest, subpixel), subpixel)


def span_sizes(psf: PointSpread, span: range, subpixel: int) -> dict[str, int]:
    """Size in bytes of each array of `table_of` with the same arguments, by name."""
    if psf.layout == "disc" and not subpixel:
        size = 4 * len(span)
        return {"intervals": 2 * size, "coefficients": size, "taps": size, "outlines": 4 * span.stop}
    widths = half_widths(psf, span, subpixel > 0)
    widest, each = int(widths[-1]), 4 * _interval_size(psf, widths, subpixel)
    sizes = {"intervals": 8 * len(span), "taps": 0, "outlines": 0, "coefficients": int(each.sum())}
    if psf.layout == "general":
        counts = _counts(psf, span, subpixel)
        sizes["coefficients"] = len(psf.places) * sum(int(each[:count].sum()) for count in counts)
        sizes["intervals"] *= 2
        if psf.has_runs and not subpixel:
            sides = _window_sides(widths)
            sizes["taps"] = int(4 * POWERS * WIDE_LANES * (sides * sides + 1).sum())
            sizes["outlines"] = 4 * OUTLINE_RUN * (len(span) * (2 * widest + 1) + len(sides))
    elif not subpixel:
        sizes["taps"] = 4 * POWERS * WIDE_LANES * -(-len(span) // TAP_LANES) * _tap_count(psf, widest)
        if psf.layout == "symmetric":
            sizes["outlines"] = 4 * (OUTLINE_RUN if psf.pupil.hollow else OUTLINE) * len(span) * (widest + 1)
    return sizes


def table_bytes(psf: PointSpread, smallest: float, largest: float, subpixel: int = 0) -> int:
    """Size in bytes of `psf_table` with the same arguments."""
    return sum(table_sizes(psf, smallest, largest, subpixel).values())


def check_tables(psf: PointSpread, smallest: float, largest: float, silhouettes: int, occluded: bool) -> None:
    """Raise SceneError if tables for |blur radii| within [smallest, largest] px exceed LARGEST_TABLES.

    silhouettes: sub-pixel sources per axis, 0 for none; occluded: True to include ray means (`clsco.optics.ray_means`).
    """
    means = 4 * ray_floats(psf, largest) if occluded and has_ray_means(psf) else 0
    size = sum(table_bytes(psf, smallest, largest, subpixel) for subpixel in {0, silhouettes}) + means
    if size > LARGEST_TABLES:
        from clsco.optics.pupils.traced import Traced

        keys = {
            "fewer silhouette_samples": silhouettes > 0,
            'psf.occlusion = "none"': means > 0,
            "a larger psf.tail": psf.diffracted and not isinstance(psf.pupil, Traced),
            "less of psf.seidel": psf.varying is not None,
            "a smaller aperture": not psf.diffracted,
            "a smaller range of depths around the focus": psf.diffracted,
        }
        raise SceneError(
            f"psf: the tables of weights must take at most {LARGEST_TABLES >> 20} MiB; got {size >> 20} MiB for radii "
            f"up to {largest:.4g} px (what takes less: {', '.join(key for key, helps in keys.items() if helps)})"
        )


@lru_cache(maxsize=256)
def rounded_span(psf: PointSpread, smallest: float, largest: float, subpixel: int) -> range:
    """Intervals of a table for |blur radii| from smallest to largest px.

    Rounded to whole blocks (`block_intervals`), so that a few tables serve all ranges; not rounded for a sampled disc,
    nor if the blocks exceed SHARED_BYTES.
    """
    span = span_of(psf, smallest, largest, subpixel > 0)
    if psf.layout == "disc" and not subpixel:
        return span
    size = block_intervals(psf, subpixel > 0)
    rounded = range(span.start // size * size, -(-span.stop // size) * size)
    return rounded if sum(span_sizes(psf, rounded, subpixel).values()) <= SHARED_BYTES else span


def psf_table(
    psf: PointSpread, smallest: float, largest: float, subpixel: int = 0, blocks: Blocks = weight_block
) -> PsfTable:  # fmt: skip
    """Table for |blur radii| from smallest to largest px; subpixel: sub-pixel sources per axis, 0 for a main table."""
    span = rounded_span(psf, smallest, largest, subpixel)
    return narrow_table(table_of(psf, span, subpixel, blocks), psf, smallest, largest, subpixel > 0)


def narrow_table(table: PsfTable, psf: PointSpread, smallest: float, largest: float, subpixel: bool) -> PsfTable:
    """Table for fewer radii that shares the arrays of `table`."""
    span = span_of(psf, smallest, largest, subpixel)
    return replace(table, low=span.start, end=span.stop, reach=half_width(psf, span[-1], subpixel))


def table_of(
    psf: PointSpread, span: range, subpixel: int = 0, blocks: Blocks = weight_block, join: Join = np.concatenate
) -> PsfTable:  # fmt: skip
    """Table of a range of intervals, a multiple of TAP_LANES, see `psf_table`; join: concatenates coefficients."""
    if psf.layout == "disc" and not subpixel:
        return _disc_table(psf, span)
    size = block_intervals(psf, subpixel > 0)
    starts = range(span.start // size * size, span.stop, size)
    # Block by block: positions of a field that mirror each other share weights, which stay cached for a short time.
    by_start = [[_part(place, blocks, start, span, subpixel) for place in psf.places] for start in starts]
    parts = [of_places[0] for of_places in by_start]
    by_place = [
        [*(b.coefficients for b in blocks), *(b.negative for b in blocks)] for blocks in zip(*by_start, strict=True)
    ]
    coefficients = join([part for place in by_place for part in place if part.size])
    intervals = _intervals(psf, np.concatenate([block.widths for block in parts]), span, subpixel)
    if psf.has_runs and not subpixel:
        taps, outlines = _windows(parts)
    else:
        taps, outlines = _join_taps(parts), _join_outlines(parts, psf.has_runs)
    stride = coefficients.size // len(psf.places) if psf.varying is not None else 0
    reach = int(intervals[:, 1].max())
    return PsfTable(
        span.start, span.start, span.stop, intervals, coefficients, reach, len(span), taps, outlines, stride
    )  # fmt: skip


def _of_block(psf: PointSpread, start: int, subpixel: int) -> PointSpread:
    """The PSF for a block that begins with interval `start`: for each sign, `most` allows all radii or none."""
    if psf.most == (inf, inf):
        return psf
    least = float(table_radius(psf, np.array(start), subpixel > 0))
    negative, positive = (inf if least <= most else -1.0 for most in psf.most)
    return replace(psf, most=(negative, positive))


def _counts(psf: PointSpread, span: range, subpixel: int) -> tuple[int, int]:
    """Number of intervals of a signed shape's table that have weights, for positive and for negative radii."""
    size = block_intervals(psf, subpixel > 0)
    least = table_radius(psf, np.array(span) // size * size, subpixel > 0)
    negative, positive = (int((least <= most).sum()) for most in psf.most)
    return positive, negative


def _intervals(psf: PointSpread, widths: NDArray[np.int32], span: range, subpixel: int) -> NDArray[np.int32]:
    """Value of `PsfTable.intervals`. An interval without weights gets the entry of the last interval with weights of
    its sign, or else of the other sign.
    """
    counts = _counts(psf, span, subpixel) if psf.signed else (len(widths),)
    numbers = np.concatenate([np.arange(count) for count in counts])  # of stored intervals
    sizes = _interval_size(psf, widths.astype(np.int64), subpixel)[numbers]
    stored = np.stack([np.cumsum(sizes) - sizes, widths[numbers]], axis=1).astype(np.int32)
    signs = np.split(stored, np.cumsum(counts)[:-1])
    signs = [part if len(part) else signs[0] if len(signs[0]) else signs[1] for part in signs]
    return np.concatenate([part[np.minimum(np.arange(len(widths)), len(part) - 1)] for part in signs])


def _part(psf: PointSpread, blocks: Blocks, start: int, span: range, subpixel: int) -> WeightBlock:
    """The intervals in a span of the block that begins with interval `start`."""
    block = blocks(_of_block(psf, start, subpixel), start, subpixel)
    first, end = max(span.start - start, 0), min(span.stop - start, len(block.widths))
    if (first, end) == (0, len(block.widths)):
        return block
    sizes = np.cumsum(_interval_size(psf, block.widths.astype(np.int64), subpixel))
    selection = slice(int(sizes[first - 1]) if first else 0, int(sizes[end - 1]))
    widest, middle = int(block.widths[end - 1]), block.outlines.shape[1] // 2 if psf.has_runs else 0
    return WeightBlock(
        block.widths[first:end],
        block.coefficients[selection],
        block.negative[selection],
        block.taps[: _tap_count(psf, widest), :, first:end],
        block.outlines[first:end, max(middle - widest, 0) : middle + widest + 1],
    )


def _tap_count(psf: PointSpread, widest: int) -> int:
    return widest + 1 if psf.layout == "separable" else octant_taps(widest) + psf.pupil.hollow


def _interval_size(psf: PointSpread, widths: NDArray[np.int64], subpixel: int) -> NDArray[np.int64]:
    """Number of coefficients of intervals with these half-widths."""
    row, rows = POWERS * row_lanes(widths), 2 * widths + 1
    if psf.layout == "general":
        return row * rows * max(subpixel, 1) ** 2
    if subpixel:
        return row * rows * subpixel * ((subpixel + 1) // 2)
    return row if psf.layout == "separable" else row * (widths + 1)


def _join_taps(parts: list[WeightBlock]) -> Floats:
    """Coefficients (taps, windows, POWERS, WIDE_LANES) by tap; windows begin at every TAP_LANES-th interval.

    They are 0 beyond the taps of a block.
    """
    most, count = max(len(block.taps) for block in parts), sum(block.taps.shape[2] for block in parts)
    if not count:
        return np.zeros(0, np.float32)
    padded = -(-count // TAP_LANES) * TAP_LANES  # a table of few intervals fills no window otherwise
    joined, start = np.zeros((most, POWERS, padded + WIDE_LANES - TAP_LANES), np.float32), 0
    for block in parts:
        joined[: len(block.taps), :, start : start + block.taps.shape[2]] = block.taps
        start += block.taps.shape[2]
    windows = np.lib.stride_tricks.sliding_window_view(joined, WIDE_LANES, axis=2)[:, :, ::TAP_LANES]
    return np.ascontiguousarray(windows.swapaxes(1, 2))


def _window_sides(widths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of taps along an axis in each window of WIDE_LANES intervals, see `PsfTable`, for a general shape."""
    last = np.minimum(np.arange(0, len(widths), TAP_LANES) + WIDE_LANES, len(widths)) - 1
    return 2 * widths[last].astype(np.int64) + 1


def _windows(parts: list[WeightBlock]) -> tuple[Floats, NDArray[np.int32]]:
    """Coefficients by tap of windows of a general shape, and outlines followed by starts of windows, see `PsfTable`."""
    widths = np.concatenate([block.widths for block in parts]).astype(np.int64)
    sides, outlines = _window_sides(widths), _join_outlines(parts, has_runs=True)
    places = np.concatenate([[0], np.cumsum(sides * sides + 1)])
    taps = np.zeros((int(places[-1]), POWERS, WIDE_LANES), np.float32)
    intervals = (item for block in parts for item in _interval_taps(block))
    for k, (half, interval_taps) in enumerate(intervals):
        start, stop = outlines[k, :, 2:].T
        column = int((stop - start).argmax())
        is_open = start[column] < stop[column]
        open_tap = interval_taps[half + column - int(widths[-1]), half + start[column]] if is_open else 0.0
        for window in range(max(k // TAP_LANES - 1, 0), k // TAP_LANES + 1):
            side, lane = int(sides[window]), k - window * TAP_LANES
            window_taps = taps[places[window] + 1 : places[window + 1]].reshape(side, side, POWERS, WIDE_LANES)
            inside = slice(side // 2 - half, side // 2 + half + 1)
            window_taps[inside, inside, :, lane] = interval_taps
            taps[places[window], :, lane] = open_tap
    heads = np.zeros((len(sides), OUTLINE_RUN), np.int32)
    heads[:, 0], heads[:, 1] = places[:-1] * POWERS * WIDE_LANES, sides
    return taps, np.concatenate([_share_outlines(outlines).reshape(-1, OUTLINE_RUN), heads])


def _interval_taps(block: WeightBlock) -> Iterator[tuple[int, Floats]]:
    """Half-width and coefficients (dx, dy, POWERS) of each interval of a general shape."""
    start = 0
    for half in block.widths.tolist():
        side, lanes = 2 * half + 1, row_lanes(half)
        rows = block.coefficients[start : start + side * POWERS * lanes].reshape(side, POWERS, lanes)
        yield half, rows[..., :side].transpose(2, 0, 1)
        start += rows.size


def _share_outlines(outlines: NDArray[np.int32]) -> NDArray[np.int32]:
    """Outlines that are valid for WIDE_LANES intervals: for each interval, the union of lit taps over the WIDE_LANES
    intervals that end with it, and the intersection of runs over those that begin with it.
    """
    far = np.int32(2**30)
    dark, closed = outlines[..., 1] < outlines[..., 0], outlines[..., 3] <= outlines[..., 2]
    first, start = (np.where(none, far, outlines[..., k]) for none, k in ((dark, 0), (closed, 2)))
    last, stop = (np.where(none, -far, outlines[..., k]) for none, k in ((dark, 1), (closed, 3)))
    for step in (1, 2, 4, 8):
        first[step:], last[step:] = np.minimum(first[step:], first[:-step]), np.maximum(last[step:], last[:-step])
        start[:-step], stop[:-step] = np.maximum(start[:-step], start[step:]), np.minimum(stop[:-step], stop[step:])
    closed = stop <= start
    dark = first > last
    ends = np.where(dark, 0, first), np.where(dark, -1, last), np.where(closed, 0, start), np.where(closed, 0, stop)
    return np.stack(ends, axis=-1)


def _join_outlines(parts: list[WeightBlock], has_runs: bool) -> NDArray[np.int32]:
    """Outlines of all intervals, empty beyond those of a block; with `has_runs`, the middle column is dx = 0."""
    most = max(block.outlines.shape[1] for block in parts)
    if not most:
        return np.zeros(0, np.int32)
    numbers = parts[0].outlines.shape[2]
    joined, start = np.zeros((sum(len(block.outlines) for block in parts), most, numbers), np.int32), 0
    joined[..., 1] = -1
    for block in parts:
        count, columns, _ = block.outlines.shape
        beside = (most - columns) // 2 if has_runs else 0
        joined[start : start + count, beside : beside + columns] = block.outlines
        start += count
    return joined


def _disc_table(psf: PointSpread, span: range) -> PsfTable:
    """Table of a sampled disc: interval n is for R^2 from n to n + 1."""
    widths = np.floor(np.sqrt(span)).astype(np.int32)
    intervals = np.stack([np.arange(len(span)), widths], axis=1).astype(np.int32)
    center = np.zeros(1)
    weights = psf.weights(center, center, table_radius(psf, np.array(span) + 0.5, False)).astype(np.float32)
    roots = np.floor(np.sqrt(np.arange(span.stop))).astype(np.int32)
    return PsfTable(
        span.start, span.start, span.stop, intervals, weights, int(widths[-1]), len(span), weights, roots
    )  # fmt: skip


def table_weights(table: PsfTable, psf: PointSpread, radius: float) -> Floats:
    """Weights (2 h + 1, 2 h + 1) around a source at the center of the middle pixel, as a device reads them from a main
    table; h: half-width of the blur in px.

    table: for a range that includes |radius|; radius: signed blur radius, px.
    """
    coordinate = float(table_coordinate(psf, np.asarray(radius)))
    index = int(coordinate)
    number = index - table.first + (table.count if psf.signed and radius < 0.0 else 0)
    start, half = (int(value) for value in table.intervals[number])
    size = 2 * half + 1
    if psf.layout == "disc":
        across = np.abs(np.arange(-half, half + 1))
        ends = table.outlines[index - across**2]
        return np.where(across <= ends[:, None], table.coefficients[start], np.float32(0.0))
    rows = {"separable": 1, "symmetric": half + 1, "general": size}[psf.layout]
    lanes = row_lanes(half)
    cubics = table.coefficients[start : start + rows * POWERS * lanes].reshape(rows, POWERS, lanes)[..., :size]
    weights = np.tensordot((coordinate - index) ** np.arange(POWERS), cubics.astype(np.float64), axes=(0, 1))
    if psf.layout == "separable":
        weights = weights[0] * weights[0][:, None]
    elif psf.layout == "symmetric":
        weights = np.concatenate([weights[:0:-1], weights])
    return np.asarray(weights, np.float32)
