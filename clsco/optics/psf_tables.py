"""Tables of PSF weights over the blur radius: piecewise cubics, in the layout that kernels read (float64, pure)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from math import ceil, floor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clsco.constants import POWERS, TAP_LANES, WIDE_LANES
from clsco.errors import SceneError
from clsco.optics.psf import (
    MINIMUM_BLUR,
    axis_weights,
    polygon_rows,
    psf_extent,
    reach,
    sampled_key,
    shape_of,
    subpixel_offsets,
    subpixel_weights,
    weights,
)
from clsco.scene.model import Psf

Array = NDArray[np.float64]
Widths = TypeVar("Widths", int, NDArray[np.int64])

# Intervals of the tables: so many per octave of the radius and an offset (`octaves_from`), so that they grow with it.
# The weight of a point source has a kink of order 3/2 where its circle touches a pixel's edge, first at R = 1/8 px, and
# that of a Gaussian a corner where its cut does; the area forms have these in every weight of a frame.
# tests/optics/test_psf.py bounds what interpolation adds to a PSF, tests/kernels/test_blur.py what it adds to a frame.
OFFSET, STEPS, AREA_STEPS = 0.125, 48, 128
GAUSSIAN_STEPS = 64  # a power of 2: octaves are divided where the corners are, up to an extent of 2 STEPS offsets
# A sampled Gaussian changes fastest at few taps: so many intervals per unit of dx^2 + dy^2 up to so many units.
FINE_STEPS, FINE_UNTIL = 16, 16
# Chebyshev points of [0, 1]: near the best cubic, and never on a jump of a sampled PSF.
NODES = 0.5 - 0.5 * np.cos((2 * np.arange(POWERS) + 1) * np.pi / 8)
TO_POWERS = np.linalg.inv(np.vander(NODES, POWERS, increasing=True))
# Sampled discs that reach at most so far, in px to both sides, are added up tap by tap: kernels/blur/cpu/near.clh.
NEAR = 7
LARGEST_TABLES = 2**30  # bytes
RUN = 16  # intervals whose weights are computed at once, of one half-width


@dataclass(frozen=True)
class PsfTable:
    """Weights over a range of blur radii as piecewise cubics, in the layout that the kernels read.

    A source of radius R has the coordinate u (see `table_coordinate`), interval floor(u) and position
    t = u - floor(u); its weight at (dx, dy) is c0 + t (c1 + t (c2 + t c3)).
    intervals: int32 (count, 2): start in `coefficients`, half-width in px.
    coefficients: float32, per interval rows of (POWERS, lanes): row |dy| = 0..half-width (a main table), or
    rows -half-width..half-width for each of the S/2 x S offsets of a sub-pixel source. Of a general shape all rows of
    either, for all S x S offsets.
    first: the interval that `intervals` begins with; count: how many there are, and of a signed shape so many again, of
    the negative radii, whose coordinates are larger by count. reach: largest half-width.
    taps, outlines: of a main table, else empty, as for a general shape. taps: the same weights once more, float32
    (taps, count / TAP_LANES, POWERS, WIDE_LANES): of the octant's taps a >= b >= 0 in the order of a (a + 1) / 2 + b
    or, of what is separable, of those along an axis, the coefficients of WIDE_LANES intervals from every TAP_LANES-th
    one on; zeros beyond the reach of an interval, and after the last one. outlines: int32, (count, reach + 1, 2), see
    `_outline`, but for what is separable. Of a sampled disc coefficients and taps have the one weight of each interval,
    and outlines the square roots of 0, 1, ... up to the last interval's number, rounded down.
    """

    first: int
    intervals: NDArray[np.int32]
    coefficients: NDArray[np.float32]
    reach: int
    count: int
    taps: NDArray[np.float32]
    outlines: NDArray[np.int32]


def sampled_steps(psf: Psf) -> tuple[int, int]:
    """Intervals per unit of dx^2 + dy^2 at first, and up to how many units; 1 per unit beyond (sampled PSFs)."""
    return (1, 0) if psf.model == "pillbox" else (FINE_STEPS, FINE_UNTIL)


def table_steps(psf: Psf, subpixel: bool) -> int:
    """Intervals per octave of a table that is indexed by the radius."""
    if psf.edge == "area" and not subpixel:
        return AREA_STEPS
    return GAUSSIAN_STEPS if psf.model == "gaussian" else STEPS


def octaves_from(psf: Psf) -> float:
    """Inverse of the offset of the radii of a table, 1 / px; a float32.

    For a Gaussian OFFSET, or less, of its extent: pixel edges are at multiples of 1 / (2 silhouette_samples) px from
    sub-pixel sources, and where the cut touches one an interval has to begin.
    """
    if psf.model == "pillbox":
        return 1.0 / OFFSET
    parts = 2 * psf.silhouette_samples
    return float(np.float32(float(psf_extent(psf, 1.0)) * parts * ceil(1.0 / (parts * OFFSET))))


def table_coordinate(psf: Psf, radius: Array, subpixel: bool = False) -> Array:
    """Coordinate u of a blur radius in px: its integer part names the interval of the table."""
    r = np.abs(np.asarray(radius, dtype=np.float64))
    if psf.edge == "sampled" and not subpixel:
        key = np.where(r < MINIMUM_BLUR, 0.0, sampled_key(psf) * r * r)
        steps, until = sampled_steps(psf)
        return np.where(key < until, key * steps, until * steps + (key - until))
    mantissa, exponent = np.frexp(r * octaves_from(psf) + 1.0)
    return np.asarray(table_steps(psf, subpixel) * (exponent - 1 + 2.0 * mantissa - 1.0))


def _table_radius(psf: Psf, coordinate: Array, subpixel: bool) -> Array:
    """Inverse of table_coordinate."""
    if psf.edge == "sampled" and not subpixel:
        return np.maximum(np.sqrt(_sampled_reach(psf, coordinate) / sampled_key(psf)), MINIMUM_BLUR)
    position = coordinate / table_steps(psf, subpixel)
    octave = np.floor(position)
    return np.asarray((2.0**octave * (1.0 + position - octave) - 1.0) / octaves_from(psf))


def _sampled_reach(psf: Psf, coordinate: Array) -> Array:
    """dx^2 + dy^2 up to which pixel centers are covered, from the coordinate of a sampled PSF."""
    steps, until = sampled_steps(psf)
    return np.where(coordinate < until * steps, coordinate / steps, until + coordinate - until * steps)


def _half_widths(psf: Psf, span: range, subpixel: bool) -> NDArray[np.int64]:
    """Half-widths in px of the rows of intervals, of which a sampled PSF has as many as R^2."""
    if psf.edge == "sampled" and not subpixel:
        return np.floor(np.sqrt(_sampled_reach(psf, np.array(span)))).astype(np.int64)
    radii = _table_radius(psf, np.array(span) + 1.0, subpixel)
    return np.array([reach(psf, radius, subpixel) for radius in radii.tolist()], np.int64)


def _half_width(psf: Psf, index: int, subpixel: bool) -> int:
    """Half-width in px of the rows of an interval."""
    return int(_half_widths(psf, range(index, index + 1), subpixel)[0])


def _runs(psf: Psf, span: range, subpixel: bool) -> Iterator[tuple[int, int, int]]:
    """Intervals of the same half-width in px, at most RUN at a time: number of the first, how many, half-width."""
    first = 0
    for half_width, of_same in groupby(_half_widths(psf, span, subpixel).tolist()):
        end = first + len(list(of_same))
        for start in range(first, end, RUN):
            yield start, min(RUN, end - start), half_width
        first = end


def _span(psf: Psf, smallest: float, largest: float, subpixel: bool) -> range:
    """Intervals that hold the |blur radii| from smallest to largest px, and those before them in their TAP_LANES.

    So windows of intervals begin at the same ones whatever the smallest radius is, on which the order of sums depends.
    """
    first, last = (floor(float(table_coordinate(psf, np.array(r), subpixel))) for r in (smallest, largest))
    return range(first // TAP_LANES * TAP_LANES, last + 1)


def is_near(psf: Psf, largest: float) -> bool:
    """Whether sampled discs up to `largest` px reach so little that each tap of a row of sources is added by itself."""
    return shape_of(psf).kind == "disc" and table_reach(psf, largest) <= NEAR


def psf_features(psf: Psf) -> dict[str, int]:
    """What programs are compiled for: the kind of a PSF; GENERAL is the number of edges of its lens mask."""
    shape = shape_of(psf)
    features = {"SAMPLED": shape.sampled, "DISC": shape.kind == "disc", "SEPARABLE": shape.kind == "separable"}
    return {name: int(value) for name, value in features.items()} | {"GENERAL": len(shape.mask)}


def table_reach(psf: Psf, largest: float, subpixel: bool = False) -> int:
    """Largest half-width in px of the rows of `psf_table` for radii up to `largest` px."""
    return _half_width(psf, _span(psf, largest, largest, subpixel)[-1], subpixel)


def table_sizes(psf: Psf, smallest: float, largest: float, subpixel: int = 0) -> dict[str, int]:
    """Bytes of each array of `psf_table` of the same arguments, by its name."""
    span = _span(psf, smallest, largest, subpixel > 0)
    if shape_of(psf).kind == "disc" and not subpixel:
        each = 4 * len(span)
        return {"intervals": 2 * each, "coefficients": each, "taps": each, "outlines": 4 * span.stop}
    widths = _half_widths(psf, span, subpixel > 0)
    widest, row = int(widths[-1]), 4 * POWERS * _lanes(widths)
    sizes = {"intervals": 8 * len(span), "taps": 0, "outlines": 0}
    of_taps = 4 * POWERS * WIDE_LANES * -(-len(span) // TAP_LANES)
    if shape_of(psf).kind == "general":
        coefficients = 2 * int((row * (2 * widths + 1) * max(subpixel, 1) ** 2).sum())
        return {"intervals": 16 * len(span), "coefficients": coefficients, "taps": 0, "outlines": 0}
    if subpixel:
        return sizes | {"coefficients": int((row * (2 * widths + 1) * subpixel * ((subpixel + 1) // 2)).sum())}
    if shape_of(psf).kind == "separable":
        return sizes | {"coefficients": int(row.sum()), "taps": of_taps * (widest + 1)}
    sizes |= {"taps": of_taps * _octant_taps(widest), "outlines": 8 * len(span) * (widest + 1)}
    return sizes | {"coefficients": int((row * (widths + 1)).sum())}


def table_bytes(psf: Psf, smallest: float, largest: float, subpixel: int = 0) -> int:
    """Size of `psf_table` of the same arguments."""
    return sum(table_sizes(psf, smallest, largest, subpixel).values())


def check_tables(psf: Psf, smallest: float, largest: float, silhouettes: int) -> None:
    """Raise SceneError where the tables for |blur radii| in [smallest, largest] px take more than LARGEST_TABLES."""
    size = table_bytes(psf, smallest, largest)
    size += table_bytes(psf, smallest, largest, silhouettes) if silhouettes else 0
    if size > LARGEST_TABLES:
        raise SceneError(
            f"psf: the tables of weights must take at most {LARGEST_TABLES >> 20} MiB; got {size >> 20} MiB for radii "
            f"up to {largest:.4g} px (fewer silhouette_samples, or a smaller aperture, take less)"
        )


@lru_cache(maxsize=8)
def psf_table(psf: Psf, smallest: float, largest: float, subpixel: int = 0) -> PsfTable:
    """Table for |blur radii| in [smallest, largest] px; subpixel > 0: for that many sub-pixel sources per axis."""
    fine = subpixel > 0
    span = _span(psf, smallest, largest, fine)
    if shape_of(psf).kind == "general":
        return _general_table(psf, span, subpixel)
    if shape_of(psf).kind == "disc" and not fine:
        return _disc_table(psf, span)
    if shape_of(psf).kind == "separable" and not fine:
        return _separable_table(psf, span)
    intervals, blocks, start = list[tuple[int, int]](), [], 0
    reach = _half_width(psf, span[-1], fine)
    taps = np.zeros((0 if fine else _octant_taps(reach), POWERS, len(span)), np.float32)
    outlines = np.zeros((0 if fine else len(span), reach + 1, 2), np.int32)
    outlines[..., 1] = -1
    for first, count, half_width in _runs(psf, span, fine):
        radii = _table_radius(psf, (span[first] + np.arange(count)[:, None] + NODES).ravel(), fine)
        values = _subpixel_rows(psf, radii, half_width, subpixel) if fine else _main_rows(psf, radii, half_width)
        found = np.tensordot(values.reshape(count, len(NODES), *values.shape[1:]), TO_POWERS, axes=(1, 1))
        for number, powers in enumerate(np.moveaxis(found, -1, 2), first):
            block = np.zeros((*powers.shape[:2], _lanes(half_width)), dtype=np.float32)
            block[:, :, : 2 * half_width + 1] = powers
            if not fine:
                a, b = np.tril_indices(half_width + 1)
                taps[: len(a), :, number] = block[b, :, half_width + a]
                outlines[number, : half_width + 1] = _outline(block[:, :, half_width : 2 * half_width + 1])
            intervals.append((start, half_width))
            blocks.append(block.ravel())
            start += block.size
    table = np.array(intervals, dtype=np.int32)
    return PsfTable(span.start, table, np.concatenate(blocks), reach, len(span), _windows(taps), outlines)


def _general_table(psf: Psf, span: range, samples: int) -> PsfTable:
    """Table of whole rows, for radii and then for negative ones, whose blur is mirrored in its center.

    samples: sub-pixel sources per axis, 0 for those of whole pixels.
    """
    fine, intervals, blocks, start = samples > 0, list[tuple[int, int]](), list[NDArray[np.float32]](), 0
    offsets = subpixel_offsets(samples) if fine else np.zeros(1)
    for sign in (1, -1):
        for first, count, half_width in _runs(psf, span, fine):
            radii = _table_radius(psf, (span[first] + np.arange(count)[:, None] + NODES).ravel(), fine)
            taps, tent = np.arange(-half_width, half_width + 1.0), psf.edge == "integrated" and not fine
            squares = [polygon_rows(psf, radii, taps - ox, taps - oy, tent) for oy in offsets for ox in offsets]
            if sign < 0:
                squares = [square[:, ::-1, ::-1] for square in reversed(squares)]
            values = np.concatenate(squares, axis=1)
            found = np.tensordot(values.reshape(count, len(NODES), *values.shape[1:]), TO_POWERS, axes=(1, 1))
            for powers in np.moveaxis(found, -1, 2):
                block = np.zeros((*powers.shape[:2], _lanes(half_width)), dtype=np.float32)
                block[:, :, : 2 * half_width + 1] = powers
                intervals.append((start, half_width))
                blocks.append(block.ravel())
                start += block.size
    table, none = np.array(intervals, dtype=np.int32), np.zeros(0, dtype=np.float32)
    widest = int(table[:, 1].max())
    return PsfTable(span.start, table, np.concatenate(blocks), widest, len(span), none, none.astype(np.int32))


def _disc_table(psf: Psf, span: range) -> PsfTable:
    """Table of a sampled disc: an interval for every whole number n that R^2 exceeds."""
    half_width = np.floor(np.sqrt(span)).astype(np.int32)
    intervals = np.stack([np.arange(len(span)), half_width], axis=1).astype(np.int32)
    center = np.zeros(1)
    each = weights(psf, center, center, _table_radius(psf, np.array(span) + 0.5, False)).astype(np.float32)
    roots = np.floor(np.sqrt(np.arange(span.stop))).astype(np.int32)
    return PsfTable(span.start, intervals, each, int(half_width[-1]), len(span), each, roots)


def _separable_table(psf: Psf, span: range) -> PsfTable:
    """Table of a Gaussian by one of its axes."""
    intervals, rows, start = list[tuple[int, int]](), [], 0
    reach = _half_width(psf, span[-1], False)
    sides = np.zeros((reach + 1, POWERS, len(span)), np.float32)
    for first, count, half_width in _runs(psf, span, False):
        radii = _table_radius(psf, span[first] + np.arange(count)[:, None] + NODES, False)
        offsets = np.arange(-half_width, half_width + 1.0)
        for number, powers in enumerate(TO_POWERS @ axis_weights(psf, offsets, radii[..., None]), first):
            block = np.zeros((POWERS, _lanes(half_width)), dtype=np.float32)
            block[:, : len(offsets)] = powers
            sides[: half_width + 1, :, number] = block[:, half_width : 2 * half_width + 1].T
            intervals.append((start, half_width))
            rows.append(block.ravel())
            start += block.size
    table, none = np.array(intervals, dtype=np.int32), np.zeros(0, dtype=np.int32)
    return PsfTable(span.start, table, np.concatenate(rows), reach, len(span), _windows(sides), none)


def _windows(taps: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coefficients (taps, powers, intervals) in windows of WIDE_LANES, TAP_LANES apart: axis 1 of four."""
    padded = np.pad(taps, ((0, 0), (0, 0), (0, -taps.shape[2] % TAP_LANES + WIDE_LANES - TAP_LANES)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, WIDE_LANES, axis=2)[:, :, ::TAP_LANES]
    return np.ascontiguousarray(windows.swapaxes(1, 2))


def _outline(block: NDArray[np.float32]) -> NDArray[np.int32]:
    """Where the weights of an interval are, and where they are all the same: int32 (half-width + 1, 2).

    block: coefficients (|dy|, powers, |dx|). Of the column |dx| = n: the first |dy| whose weight is not the one in the
    middle, where those of all columns nearer the middle are, too, and the last |dy| with a weight above 0.
    """
    same = (block == block[:1, :, :1]).all(axis=1)
    first = np.where(same.all(axis=0), len(same), same.argmin(axis=0))
    lit = (block != 0).any(axis=1)
    last = len(lit) - 1 - lit[::-1].argmax(axis=0)
    last = np.where(lit.any(axis=0), last, -1)
    return np.stack([np.minimum.accumulate(first), last], axis=1).astype(np.int32)


def _octant_taps(reach: int) -> int:
    """Taps a >= b >= 0 up to `reach` px along the axes."""
    return (reach + 1) * (reach + 2) // 2


def _lanes(half_width: Widths) -> Widths:
    """Floats of a row of weights: whole vectors."""
    return -(-(2 * half_width + 1) // TAP_LANES) * TAP_LANES


def _main_rows(psf: Psf, radii: Array, half_width: int) -> Array:
    """Weights (radii, |dy|, dx) of sources at pixel centers, computed once per octant."""
    low, high = np.triu_indices(half_width + 1)
    octant = weights(psf, low.astype(float), high.astype(float), radii[:, None])
    quadrant = np.empty((len(radii), half_width + 1, half_width + 1))
    quadrant[:, low, high] = quadrant[:, high, low] = octant
    return quadrant[:, :, np.abs(np.arange(-half_width, half_width + 1))]


def _subpixel_rows(psf: Psf, radii: Array, half_width: int, samples: int) -> Array:
    """Weights (radii, rows, dx) of point sources: for each offset oy >= 0 and each ox, rows dy = -half..half.

    Computed for 0 <= ox <= oy only: the others are the same, mirrored or with the axes swapped.
    """
    span = np.arange(-half_width, half_width + 1, dtype=float)
    offsets = subpixel_offsets(samples)[samples // 2 :]
    squares: dict[tuple[int, int], Array] = {}
    for j, oy in enumerate(offsets):
        for i, ox in enumerate(offsets[: j + 1]):
            dx, dy = (span - ox)[None, None, :], (span - oy)[None, :, None]
            squares[j, i] = subpixel_weights(psf, dx, dy, radii[:, None, None])
            squares[i, j] = squares[j, i].swapaxes(1, 2)
    columns = [abs(2 * k + 1 - samples) // 2 for k in range(samples)]
    rows = [
        squares[j, i][:, :, :: 1 if 2 * k + 1 >= samples else -1]
        for j in range(len(offsets))
        for k, i in enumerate(columns)
    ]
    return np.concatenate(rows, axis=1)
