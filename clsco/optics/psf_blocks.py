"""Blocks of PSF tables, of the same intervals in all tables, so that a weight has equal bits in all (float64, pure)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from clsco.constants import POWERS
from clsco.optics.point_spread import PointSpread, subpixel_offsets
from clsco.optics.psf_grid import NODES, TO_POWERS, block_intervals, half_widths, octant_taps, row_lanes, table_radius

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
OUTLINE, OUTLINE_RUN = 2, 4  # lengths of the last axis of outlines, without and with a run of equal weights
SAME = 1e-9  # weights that differ by a smaller fraction count as equal; those of wide blurs are exact to 1e-10
NONE = np.zeros(0, np.float32)
RUN = 16  # largest number of intervals of one half-width whose weights are computed at once


@dataclass(frozen=True, eq=False)
class WeightBlock:
    """Weights of `block_intervals` intervals of a table, see `clsco.optics.psf_tables.PsfTable`.

    widths: half-widths (count,) of the intervals, px. coefficients: those of all intervals, concatenated; negative:
    coefficients for negative radii of a signed shape, else empty. taps: coefficients by tap (taps, POWERS, count), for
    a main table (sources at pixel centers). outlines: for a main table, (count, half-width + 1, 2), see `_outline`; for
    that of a ring, (count, half-width + 1, 4), see `_ring_outline`; for that of a general shape, (count, 2 half-width +
    1, 4), see `_column_outline`.
    """

    widths: NDArray[np.int32]
    coefficients: Floats
    negative: Floats
    taps: Floats
    outlines: NDArray[np.int32]

    @property
    def nbytes(self) -> int:
        """Size in bytes of all arrays."""
        return sum(array.nbytes for array in vars(self).values())


def weight_block(psf: PointSpread, first: int, subpixel: int = 0) -> WeightBlock:
    """The block that begins at interval `first`, a multiple of `block_intervals`; subpixel: sub-pixel sources per axis,
    or 0.

    Weights at the radii of NODES determine a cubic in the position within an interval. A sampled disc has no blocks.
    """
    span = range(first, first + block_intervals(psf, subpixel > 0))
    if psf.layout == "general":
        return _general(psf, span, subpixel)
    if psf.layout == "separable" and not subpixel:
        return _separable(psf, span)
    return _symmetric(psf, span, subpixel)


def _symmetric(psf: PointSpread, span: range, subpixel: int) -> WeightBlock:
    fine, hollow, widths = subpixel > 0, int(psf.pupil.hollow), half_widths(psf, span, subpixel > 0)
    reach, coefficients = int(widths[-1]), list[Floats]()
    taps = np.zeros((0 if fine else octant_taps(reach) + hollow, POWERS, len(span)), np.float32)
    outlines = np.zeros((0 if fine else len(span), reach + 1, OUTLINE_RUN if hollow else OUTLINE), np.int32)
    outlines[..., 1] = -1
    for number, radii, half_width in _runs(psf, span, fine):
        values = _subpixel_rows(psf, radii, half_width, subpixel) if fine else _main_rows(psf, radii, half_width)
        for k, block in enumerate(_cubics(values, half_width), number):
            coefficients.append(block.ravel())
            if not fine:
                a, b = np.tril_indices(half_width + 1)
                taps[hollow : hollow + len(a), :, k] = block[b, :, half_width + a]
                right = block[:, :, half_width : 2 * half_width + 1]
                if hollow:
                    nodes = slice(len(NODES) * (k - number), len(NODES) * (k - number + 1))
                    is_open = _is_open(psf, values[nodes, :, half_width:], radii[nodes])
                    outlines[k, : half_width + 1] = _ring_outline(right, is_open)
                    if is_open.any():
                        dy, dx = np.argwhere(is_open)[0]
                        taps[0, :, k] = right[dy, :, dx]
                else:
                    outlines[k, : half_width + 1] = _outline(right)
    return WeightBlock(widths.astype(np.int32), np.concatenate(coefficients), NONE, taps, outlines)


def _general(psf: PointSpread, span: range, samples: int) -> WeightBlock:
    """Block of a general shape: whole rows, for positive and for negative radii as far as `PointSpread.most` includes
    them; unless the PSF is diffracted, the blur of -R is that of R mirrored in its center.
    """
    fine = samples > 0
    offsets, tent = subpixel_offsets(samples) if fine else np.zeros(1), psf.edge == "integrated" and not fine
    coefficients: tuple[list[Floats], ...] = ([], [])
    widths = half_widths(psf, span, fine).astype(np.int32)
    reach, by_columns = int(widths[-1]), psf.has_runs and not fine
    outlines = np.zeros((len(span) if by_columns else 0, 2 * reach + 1, OUTLINE_RUN), np.int32)
    outlines[..., 1] = -1
    for number, radii, half_width in _runs(psf, span, fine):
        taps = np.arange(-half_width, half_width + 1.0)
        squares, mirrored = (
            [psf.pupil.rows(sign * radii, taps - ox, taps - oy, tent) for oy in offsets for ox in offsets]
            if (sign == 1 and psf.most[1] >= 0.0) or (sign == -1 and psf.most[0] >= 0.0 and psf.diffracted)
            else []
            for sign in (1, -1)
        )
        if by_columns:
            columns = slice(reach - half_width, reach + half_width + 1)
            for k, nodes in enumerate(np.split(np.arange(len(radii)), len(radii) // len(NODES)), number):
                values = squares[0][nodes]
                outlines[k, columns] = _column_outline(values, _is_open(psf, values, radii[nodes]))
        if not psf.diffracted:  # the blur of -R is that of R, mirrored in its center
            mirrored = [square[:, ::-1, ::-1] for square in reversed(squares)]
        for blocks, square in zip(coefficients, (squares, mirrored), strict=True):
            blocks += [block.ravel() for block in _cubics(np.concatenate(square, axis=1), half_width)] if square else []
    positive, negative = (np.concatenate(blocks or [NONE]) for blocks in coefficients)
    return WeightBlock(widths, positive, negative, np.zeros((0, POWERS, 0), np.float32), outlines)


def _separable(psf: PointSpread, span: range) -> WeightBlock:
    """Block of a Gaussian, for one of its axes."""
    widths, rows = half_widths(psf, span, False), list[Floats]()
    sides = np.zeros((int(widths[-1]) + 1, POWERS, len(span)), np.float32)
    for number, radii, half_width in _runs(psf, span, False):
        offsets = np.arange(-half_width, half_width + 1.0)
        nodes = radii.reshape(-1, len(NODES))
        for k, powers in enumerate(TO_POWERS @ psf.axis_weights(offsets, nodes[..., None]), number):
            block = np.zeros((POWERS, row_lanes(half_width)), dtype=np.float32)
            block[:, : len(offsets)] = powers
            sides[: half_width + 1, :, k] = block[:, half_width : 2 * half_width + 1].T
            rows.append(block.ravel())
    outlines = np.zeros((0, 0, 2), np.int32)
    return WeightBlock(widths.astype(np.int32), np.concatenate(rows), NONE, sides, outlines)


def _runs(psf: PointSpread, span: range, subpixel: bool) -> Iterator[tuple[int, Array, int]]:
    """Runs of at most RUN intervals with the same half-width: index of the first, radii at NODES, half-width, px."""
    first = 0
    for half_width, members in groupby(half_widths(psf, span, subpixel).tolist()):
        end = first + len(list(members))
        for start in range(first, end, RUN):
            numbers = span[start] + np.arange(min(RUN, end - start))
            yield start, table_radius(psf, (numbers[:, None] + NODES).ravel(), subpixel), half_width
        first = end


def _cubics(values: Array, half_width: int) -> Iterator[Floats]:
    """Coefficients (rows, POWERS, lanes) of each interval, from values (nodes of all intervals, rows, dx)."""
    count = len(values) // len(NODES)
    coefficients = np.tensordot(values.reshape(count, len(NODES), *values.shape[1:]), TO_POWERS, axes=(1, 1))
    for powers in np.moveaxis(coefficients, -1, 2):
        block = np.zeros((*powers.shape[:2], row_lanes(half_width)), dtype=np.float32)
        block[:, :, : 2 * half_width + 1] = powers
        yield block


def _outline(block: Floats) -> NDArray[np.int32]:
    """Outline of an interval's weights, and of the part where they are all equal: int32 (half-width + 1, 2).

    block: coefficients (|dy|, powers, |dx|). For the column |dx| = n: the first |dy| at which the weight differs from
    the middle tap's, in this column or in one nearer the middle; and the last |dy| with a positive weight.
    """
    same = (block == block[:1, :, :1]).all(axis=1)
    first = np.where(same.all(axis=0), len(same), same.argmin(axis=0))
    return np.stack([np.minimum.accumulate(first), _last((block != 0).any(axis=1))], axis=1).astype(np.int32)


def _last(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Last row in which each column of a mask is True, -1 for none."""
    return np.where(mask.any(axis=0), len(mask) - 1 - mask[::-1].argmax(axis=0), -1)


def _is_open(psf: PointSpread, values: Array, radii: Array) -> NDArray[np.bool_]:
    """Mask (dy, dx) of taps that are fully covered at all radii of an interval; values: weights (radii, dy, dx)."""
    open_weight = 1.0 / (np.pi * psf.pupil.light * radii * radii)
    return np.asarray((np.abs(values / open_weight[:, None, None] - 1.0) < SAME).all(axis=0))


def _column_outline(values: Array, is_open: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Outline of an interval's weights for a general shape: int32 (columns, 4).

    values: weights (radii, dy, dx); is_open: mask (dy, dx) from `_is_open`. For each column: the first and the last dy
    with a positive weight; the first dy of its longest run of open taps, and the dy after its last one.
    """
    lit, count = np.asarray((values > 0.0).any(axis=0)), len(is_open)
    place, half_width = np.arange(count)[:, None], count // 2
    any_lit, first, last = lit.any(axis=0), lit.argmax(axis=0) - half_width, _last(lit) - half_width
    length = place - np.maximum.accumulate(np.where(is_open, -1, place), axis=0)
    most, stop = length.max(axis=0), length.argmax(axis=0) + 1 - half_width
    run = np.stack([stop - most, stop], axis=1) * (most > 0)[:, None]
    ends = np.stack([np.where(any_lit, first, 0), np.where(any_lit, last, -1)], axis=1)
    return np.concatenate([ends, run], axis=1).astype(np.int32)


def _ring_outline(block: Floats, is_open: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Outline of an interval's weights for a ring: int32 (half-width + 1, 4).

    block: coefficients (|dy|, powers, |dx|); is_open (|dy|, |dx|). For the column |dx| = n: the first and the last |dy|
    with a positive weight; the first |dy| of the taps fully inside the ring, and the |dy| after the last one.
    """
    lit, start = (block != 0).any(axis=1), np.where(is_open.any(axis=0), is_open.argmax(axis=0), len(block))
    return np.stack([lit.argmax(axis=0), _last(lit), start, _last(is_open) + 1], axis=1).astype(np.int32)


def _main_rows(psf: PointSpread, radii: Array, half_width: int) -> Array:
    """Weights (radii, |dy|, dx) of sources at pixel centers; only one octant is computed."""
    low, high = np.triu_indices(half_width + 1)
    octant = psf.weights(low.astype(float), high.astype(float), radii[:, None])
    quadrant = np.empty((len(radii), half_width + 1, half_width + 1))
    quadrant[:, low, high] = quadrant[:, high, low] = octant
    return quadrant[:, :, np.abs(np.arange(-half_width, half_width + 1))]


def _subpixel_rows(psf: PointSpread, radii: Array, half_width: int, samples: int) -> Array:
    """Weights (radii, rows, dx) of point sources: rows dy = -half..half, for each oy >= 0 and each ox in a pixel.

    Only offsets 0 <= ox <= oy are computed: mirroring or swapping the axes gives the others.
    """
    span = np.arange(-half_width, half_width + 1, dtype=float)
    offsets = subpixel_offsets(samples)[samples // 2 :]
    squares: dict[tuple[int, int], Array] = {}
    for j, oy in enumerate(offsets):
        for i, ox in enumerate(offsets[: j + 1]):
            dx, dy = (span - ox)[None, None, :], (span - oy)[None, :, None]
            squares[j, i] = psf.subpixel_weights(dx, dy, radii[:, None, None])
            squares[i, j] = squares[j, i].swapaxes(1, 2)
    columns = [abs(2 * k + 1 - samples) // 2 for k in range(samples)]
    rows = [
        squares[j, i][:, :, :: 1 if 2 * k + 1 >= samples else -1]
        for j in range(len(offsets))
        for k, i in enumerate(columns)
    ]
    return np.concatenate(rows, axis=1)
