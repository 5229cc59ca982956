"""Defocus: every source spreads its radiance over the pixels around it (2.25), in NumPy float64.

Sources are on the padded grid (H, W), with `guard` rows and columns around the frame (m, n). Offsets (dx, dy) are right
and down from a source to a pixel that it contributes to.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsco.constants import LEAST_OPENING
from clsco.optics.chords import chord_weights
from clsco.optics.point_spread import PointSpread, subpixel_offsets
from clsco.plan.methods import BlurSpec
from clsco.reference.common.geometry import Array, tilt_share, tilt_slope
from clsco.reference.common.visibility import Visibility
from clsco.reference.common.visibility_test import cell_visibility, cut_weights, tap_share
from clsco.reference.trace.trace import Sources, SubpixelSources

Shape = tuple[int, int]
BLOCK = 16384  # number of sources processed at a time, so that intermediate results stay in the cache
TINIEST_OFFSET = 1e-6  # px
OCCLUDED_BLOCK = 2048  # replaces BLOCK for sources with occluders, which need more memory


def prepare_sources(coc: Array, valid: NDArray[np.bool_]) -> Array:
    """Gradient (H, W, 2) of the blur radius in px per px, right and down, by finite differences.

    coc: (H, W) signed radius in px; valid: (H, W) mask of sources. Differences are central if both neighbors of a
    source are valid, one-sided if one is, and 0 otherwise. Used for forward-warped images and depth maps, which have no
    analytic surface.
    """

    def along(radius: Array, there: NDArray[np.bool_]) -> Array:
        padded, mask = np.pad(radius, ((0, 0), (1, 1))), np.pad(there, ((0, 0), (1, 1)))
        ahead, behind = mask[:, 2:], mask[:, :-2]
        high, low = np.where(ahead, padded[:, 2:], radius), np.where(behind, padded[:, :-2], radius)
        distance = ahead.astype(np.int64) + behind
        return np.where(there & (distance > 0), (high - low) / np.maximum(distance, 1), 0.0)

    return np.stack([along(coc, valid), along(coc.T, valid.T).T], axis=-1)


def tilt_factor(dx: ArrayLike, dy: ArrayLike, slope: Array, limb: ArrayLike = False) -> Array:
    """Weight 1 + l . grad R of the radiance that a tilted surface sends through lens point l = (dx, dy) / R.

    dx, dy: px, right and down; slope: grad R / R (..., 2) in 1/px, right and down, from `tilt_slope`; limb: see
    `tilt_share`. All arguments broadcast. The factor is never negative.
    """
    return tilt_share(1.0 + (np.asarray(dx) * slope[..., 0] + np.asarray(dy) * slope[..., 1]), limb)


def within_rim(psf: PointSpread, dx: ArrayLike, dy: ArrayLike, radius: ArrayLike) -> tuple[Array, Array]:
    """Offsets in px from sources to taps, for `tilt_factor`; with waves, clamped to the edge of the geometric blur."""
    dx, dy = np.asarray(dx, np.float64), np.asarray(dy, np.float64)
    if not psf.diffracted:
        return dx, dy
    rim = psf.extent * np.abs(radius)
    part = np.minimum(rim / np.maximum(np.hypot(dx, dy), TINIEST_OFFSET), 1.0)
    return np.asarray(part * dx), np.asarray(part * dy)


def place_weights(
    psf: PointSpread, dx: Array, dy: Array, radius: Array, place: NDArray[np.int64], subpixel: bool = False
) -> Array:
    """Weights (n,) of taps for sources at positions `place` (2, n), row and column in the frame, px.

    dx, dy: offset from the source to the tap, px, scalar or (n,); radius: (n,) signed, px; subpixel: True to use
    `PointSpread.subpixel_weights`, False to use `PointSpread.weights`. If the PSF varies over the frame, the weights of
    four grid positions are blended.
    """

    def weights(spread: PointSpread, which: NDArray[np.int64] | slice) -> Array:
        x, y = (offset if offset.ndim == 0 else offset[which] for offset in (np.asarray(dx), np.asarray(dy)))
        return (spread.subpixel_weights if subpixel else spread.weights)(x, y, radius[which])

    if psf.varying is None:
        return weights(psf, slice(None))
    numbers, shares = psf.varying.blend(place[1], place[0])
    blended = np.zeros(radius.shape)
    for number in np.unique(numbers):
        share = (shares * (numbers == number)).sum(axis=0)
        which = np.flatnonzero(share)
        if which.size:
            blended[which] += share[which] * weights(psf.places[number], which)
    return blended


def _equal_offsets(offset_limit: int, alone: bool) -> Iterator[tuple[int, int, set[tuple[int, int]]]]:
    """Offsets, each with the set of offsets of equal weight (changed signs, swapped axes); itself if `alone`."""
    if alone:
        span = range(-offset_limit, offset_limit + 1)
        yield from ((dx, dy, {(dx, dy)}) for dy in span for dx in span)
        return
    for b in range(offset_limit + 1):
        for a in range(b + 1):
            yield b, a, {(s * x, t * y) for x, y in ((a, b), (b, a)) for s in (1, -1) for t in (1, -1)}


def _group_by_radius(visibility: Visibility) -> list[tuple[NDArray[np.int64], Visibility, Array]]:
    """Groups of partly hidden sources with nearly equal radii, which have nearly the same taps.

    Each group has the numbers of its sources, the `Visibility` of these sources, and the result of `cell_visibility`.
    """
    hidden = np.flatnonzero(visibility.row >= 0)
    parts = _blocks(hidden, visibility.radius[visibility.row[hidden]], OCCLUDED_BLOCK)
    return [(part, group, cell_visibility(group)) for part in parts for group in [visibility.select(part)]]


def _blocks(numbers: NDArray[np.int64], radius: Array, size: int) -> list[NDArray[np.int64]]:
    """Numbers (n,) of sources with signed radii (n,), in blocks of similar |R|, which have nearly the same taps."""
    numbers = numbers[np.argsort(np.abs(radius), kind="stable")]
    return [numbers[start : start + size] for start in range(0, numbers.size, size)]


def _tap_shares(
    spec: BlurSpec, sources: Sources, there: NDArray[np.bool_], shape: Shape, guard: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]:
    """For every offset: numbers of sources and of the frame pixels that they reach, and fractions of their radiance.

    there: mask (H, W) of the sources to use. Pixels outside of the frame are left out.
    """
    radius, at = sources.radius.ravel(), np.flatnonzero(there)
    slope = tilt_slope(sources.gradient, sources.radius, spec.psf.diffracted).reshape(-1, 2)
    row, column = place = np.indices(there.shape).reshape(2, -1) - guard
    blocks = _blocks(at, radius[at], BLOCK)
    reaches = [spec.psf.reach(float(np.abs(radius[block[-1]]))) for block in blocks]
    groups = [] if sources.visibility is None else _group_by_radius(sources.visibility)
    shape_at = None if sources.shape is None else sources.shape.reshape(-1, 3)
    alone = spec.psf.signed or shape_at is not None
    if shape_at is not None and sources.widening is not None:
        slope = slope + sources.widening.reshape(-1, 2)
    for right, down, offsets in _equal_offsets(max(reaches, default=-1), alone):
        weight = np.zeros(there.size)
        for block, far in zip(blocks, reaches, strict=True):
            if far >= max(abs(right), abs(down)):
                offset = np.asarray(float(right)), np.asarray(float(down))
                if shape_at is None:
                    weight[block] = place_weights(spec.psf, *offset, radius[block], place[:, block])
                else:
                    disc_radius = np.maximum(np.abs(radius[block]), LEAST_OPENING)
                    weight[block] = chord_weights(*offset, disc_radius, shape_at[block])
        lit = np.flatnonzero(weight)
        for dx, dy in sorted(offsets):
            y, x = row[lit] + dy, column[lit] + dx
            inside = (y >= 0) & (y < shape[0]) & (x >= 0) & (x < shape[1])
            source, target = lit[inside], (y * shape[1] + x)[inside]
            if not source.size:
                continue
            share = weight[source]
            if spec.tilt:
                share = share * tilt_factor(*within_rim(spec.psf, dx, dy, radius[source]), slope[source])
            for hidden, visibility, cells in groups:
                at_source = np.minimum(np.searchsorted(source, hidden), source.size - 1)
                matches = source[at_source] == hidden
                if matches.any():
                    partial, hidden_weight = at_source[matches], weight[hidden]
                    cut = cut_weights(visibility, hidden_weight, dx, dy, spec.psf.edge == "area")
                    share[partial] *= cut[matches] / hidden_weight[matches]
                    share[partial] *= tap_share(visibility, cells, dx, dy)[matches]
            yield source, target, share


def _subpixel_tap_shares(
    spec: BlurSpec, sub: SubpixelSources, shape: Shape, guard: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]:
    """As `_tap_shares`, for blocks of sub-pixel sources and every offset.

    Sources are numbered in the order of `hit`; the fraction includes the source's weight 1/S^2. Pixels outside of the
    frame are left out.
    """
    samples, places = sub.hit.shape[1], np.nonzero(sub.hit)
    offset, size = subpixel_offsets(samples), BLOCK if sub.visibility is None else OCCLUDED_BLOCK
    for block in _blocks(np.arange(len(places[0])), sub.radius[sub.hit], size):
        p, i, j = at = tuple(indices[block] for indices in places)
        y, x, radius = offset[i], offset[j], sub.radius[at]
        slope = tilt_slope(sub.gradient[at], radius, spec.psf.diffracted)
        limb = False if sub.limb is None else sub.limb[at]
        if sub.widening is not None:
            slope = slope + sub.widening[at]
        far = spec.psf.reach(float(np.abs(radius).max()), subpixel=True)
        place = np.stack([sub.row[p], sub.column[p]]) - guard
        visibility = None if sub.visibility is None else sub.visibility.select(block)
        cells = np.empty(0) if visibility is None else cell_visibility(visibility)
        if visibility is not None:  # 0 where `tap_share` includes the tilt
            slope[np.flatnonzero(visibility.row >= 0)[visibility.lean.any(axis=-1)]] = 0.0
        for dy in range(-far, far + 1):
            for dx in range(-far, far + 1):
                row, column = sub.row[p] - guard + dy, sub.column[p] - guard + dx
                inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
                right, below = dx - x[inside], dy - y[inside]
                if sub.shape is None:
                    share = place_weights(spec.psf, right, below, radius[inside], place[:, inside], subpixel=True)
                else:
                    disc_radius = np.maximum(np.abs(radius[inside]), LEAST_OPENING)
                    share = chord_weights(right, below, disc_radius, sub.shape[p[inside]], point=True)
                if visibility is not None:
                    weight, hidden = np.zeros(p.size), visibility.row >= 0
                    weight[inside] = share
                    weight[hidden] = cut_weights(visibility, weight[hidden], dx, dy, True)
                    share = weight[inside]
                if spec.tilt:
                    share = share * tilt_factor(*within_rim(spec.psf, dx - x, dy - y, radius), slope, limb)[inside]
                if visibility is not None:
                    visible = np.ones(p.size)
                    visible[visibility.row >= 0] = tap_share(visibility, cells, dx, dy)
                    share = share * visible[inside]
                lit = share != 0.0
                target = (row * shape[1] + column)[inside][lit]
                yield block[inside][lit], target, share[lit] / samples**2


def _whole_sources(sources: Sources, sub: SubpixelSources | None) -> NDArray[np.bool_]:
    """Mask (H, W) of pixels that are one source themselves: they show a surface and have no sub-pixel sources."""
    mask = sources.lit.copy()
    if sub is not None:
        mask[sub.row, sub.column] = False
    return mask


def renormalize(
    spec: BlurSpec, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int
) -> tuple[Sources, SubpixelSources | None]:
    """Sources with their radiance scaled so that light lost outside of the frame is returned to it.

    Arguments as for `scatter`. The radiance is divided by the fraction of the source's PSF (with tilt) inside the
    frame, ignoring occluders; sources outside of the frame are dropped.
    """
    m, n = shape
    inside = np.zeros(sources.label.shape, dtype=bool)
    inside[guard : guard + m, guard : guard + n] = True
    mask = _whole_sources(sources, sub) & inside

    def scale_of(count: int, taps: Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]) -> Array:
        light = np.zeros(count)
        for source, _, share in taps:
            light[source] += share  # for a single offset, no source occurs twice
        return np.where(light > 0.0, 1.0 / np.where(light > 0.0, light, 1.0), 0.0)

    scale = scale_of(mask.size, _tap_shares(spec, replace(sources, visibility=None), mask, shape, guard))
    radiance = sources.radiance * scale.reshape(mask.shape)[..., None]
    sources = replace(sources, lit=sources.lit & inside, radiance=radiance)
    if sub is None:
        return sources, None
    sub = replace(sub, hit=sub.hit & inside[sub.row, sub.column][:, None, None])
    scale, radiance = np.zeros(sub.hit.shape), sub.radiance
    taps = _subpixel_tap_shares(spec, replace(sub, visibility=None), shape, guard)
    # Shares include 1/S^2; the divisor must be the share of the source's radiance alone.
    scale[sub.hit] = scale_of(int(sub.hit.sum()), taps) / sub.hit.shape[1] ** 2
    return sources, replace(sub, radiance=radiance * scale[..., None])


def scatter(spec: BlurSpec, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int) -> Array:
    """Defocused image (m, n, C): the sum over all sources of radiance x PSF x tilt.

    sources: on the padded grid (m + 2 guard, n + 2 guard); sub: sub-pixel sources, which replace the pixel's own
    source, or None; shape: (m, n) of the frame; guard: px. For border = "renormalize" see `renormalize`.
    """
    m, n = shape
    if spec.border == "renormalize":
        sources, sub = renormalize(spec, sources, sub, shape, guard)
    color = np.zeros((m * n, sources.radiance.shape[2]))
    radiance = sources.radiance.reshape(-1, color.shape[1])
    for source, target, share in _tap_shares(spec, sources, _whole_sources(sources, sub), shape, guard):
        color[target] += share[:, None] * radiance[source]  # for a single offset, no target occurs twice
    if sub is not None:
        radiance = sub.radiance[sub.hit]
        for source, target, share in _subpixel_tap_shares(spec, sub, shape, guard):
            np.add.at(color, target, share[:, None] * radiance[source])
    return color.reshape(m, n, -1)
