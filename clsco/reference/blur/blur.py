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
OCCLUDED_BLOCK = 2048  # the same number for sources with occluders, which need more memory


def prepare_sources(coc: Array, valid: NDArray[np.bool_]) -> Array:
    """Gradient (H, W, 2) of the blur radius in px per px, right and down, by finite differences.

    coc: (H, W) signed radius in px; valid: (H, W) mask of sources. Central differences if both neighbors are valid,
    one-sided if one is, else 0. For forward-warped images and depth maps, which have no analytic surface.
    """

    def along(radius: Array, there: NDArray[np.bool_]) -> Array:
        ahead, behind = np.zeros_like(there), np.zeros_like(there)
        ahead[:, :-1] = there[:, 1:]
        behind[:, 1:] = there[:, :-1]
        high, low = radius.copy(), radius.copy()
        high[:, :-1] = np.where(ahead[:, :-1], radius[:, 1:], radius[:, :-1])
        low[:, 1:] = np.where(behind[:, 1:], radius[:, :-1], radius[:, 1:])
        distance = ahead.astype(np.int64) + behind
        return np.where(there & (distance > 0), (high - low) / np.maximum(distance, 1), 0.0)

    return np.stack([along(coc, valid), along(coc.T, valid.T).T], axis=-1)


def tilt_factor(dx: ArrayLike, dy: ArrayLike, slope: Array, limb: ArrayLike = False) -> Array:
    """Weight 1 + l . grad R of the radiance that a tilted surface sends through lens point l = (dx, dy) / R.

    dx, dy: px, right and down; slope: grad R / R (..., 2) in 1/px, right and down, from `tilt_slope`; limb: as for
    `tilt_share`. They broadcast. The factor is never negative.
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
    psf: PointSpread, dx: Array, dy: Array, radius: Array, place: NDArray[np.int64],
    subpixel: bool = False,
) -> Array:  # fmt: skip
    """Weights (n,) of taps for sources at positions `place` (2, n), row and column in the frame, px.

    dx, dy: px, scalar or (n,); radius: (n,) signed, px; subpixel: True for `PointSpread.subpixel_weights`, else
    `PointSpread.weights`. Weights that vary over the frame are blended from four grid positions.
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
    """Offsets, each with the set of offsets of equal weight (changed signs, swapped axes); only itself if `alone`."""
    if alone:
        span = range(-offset_limit, offset_limit + 1)
        yield from ((dx, dy, {(dx, dy)}) for dy in span for dx in span)
        return
    for b in range(offset_limit + 1):
        for a in range(b + 1):
            yield b, a, {(s * x, t * y) for x, y in ((a, b), (b, a)) for s in (1, -1) for t in (1, -1)}


def _group_by_radius(visibility: Visibility) -> list[tuple[NDArray[np.int64], Visibility, Array]]:
    """Groups of partly hidden sources that have nearly equal radii, and so equal taps.

    For each group: numbers of the sources, their part of `visibility`, and their `cell_visibility`.
    """
    hidden = np.flatnonzero(visibility.row >= 0)
    hidden = hidden[np.argsort(np.abs(visibility.radius[visibility.row[hidden]]), kind="stable")]
    parts = [hidden[start : start + OCCLUDED_BLOCK] for start in range(0, hidden.size, OCCLUDED_BLOCK)]
    return [(part, group, cell_visibility(group)) for part in parts for group in [visibility.select(part)]]


def _tap_shares(
    spec: BlurSpec, sources: Sources, there: NDArray[np.bool_], shape: Shape, guard: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]:
    """For every offset: source numbers, frame pixel numbers, and the fraction of radiance that each pixel receives.

    there: mask (H, W) of the sources to use. Targets outside of the frame are left out.
    """
    size, waves = np.abs(sources.radius).ravel(), spec.psf.diffracted
    slope = tilt_slope(sources.gradient, sources.radius, waves).reshape(-1, 2)
    signed = sources.radius.ravel()
    place = np.stack([axis.ravel() - guard for axis in np.indices(there.shape)])
    row, column = place
    at = np.flatnonzero(there)
    at = at[np.argsort(size[at], kind="stable")]  # so that the sources of a block have nearly the same taps
    blocks = [at[start : start + BLOCK] for start in range(0, at.size, BLOCK)]
    reaches = [spec.psf.reach(float(size[block[-1]])) for block in blocks]
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
                    weight[block] = place_weights(spec.psf, *offset, signed[block], place[:, block])
                else:
                    disc_radius = np.maximum(size[block], LEAST_OPENING)
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
                share = share * tilt_factor(*within_rim(spec.psf, dx, dy, signed[source]), slope[source])
            for hidden, visibility, cells in groups:
                at_source = np.minimum(np.searchsorted(source, hidden), source.size - 1)
                matches = source[at_source] == hidden
                if matches.any():
                    partial, point = at_source[matches], spec.psf.edge == "area"
                    hidden_weight = weight[hidden]
                    cut = cut_weights(visibility, hidden_weight, dx, dy, point)
                    share[partial] *= cut[matches] / hidden_weight[matches]
                    share[partial] *= tap_share(visibility, cells, dx, dy)[matches]
            yield source, target, share


def _subpixel_tap_shares(
    spec: BlurSpec, sub: SubpixelSources, shape: Shape, guard: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]:
    """For blocks of sub-pixel sources and every offset: source numbers, frame pixel numbers, fraction of radiance.

    Sources are numbered in the order of `hit`; the fraction includes the source's weight 1/S^2. Targets outside of the
    frame are left out.
    """
    samples = sub.hit.shape[1]
    pixel, i, j = np.nonzero(sub.hit)
    offset = subpixel_offsets(samples)
    order = np.argsort(np.abs(sub.radius[sub.hit]), kind="stable")  # so that the sources of a block have the same taps
    size = BLOCK if sub.visibility is None else OCCLUDED_BLOCK
    for start in range(0, pixel.size, size):
        block = order[start : start + size]
        p, y, x = pixel[block], offset[i[block]], offset[j[block]]
        radius = sub.radius[sub.hit][block]
        slope = tilt_slope(sub.gradient[sub.hit][block], radius, spec.psf.diffracted)
        limb = False if sub.limb is None else sub.limb[sub.hit][block]
        if sub.widening is not None:
            slope = slope + sub.widening[sub.hit][block]
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
    """Mask (H, W) of pixels with their own source: a surface, and no sub-pixel sources."""
    mask = sources.lit.copy()
    if sub is not None:
        mask[sub.row, sub.column] = False
    return mask


def renormalize(
    spec: BlurSpec, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int
) -> tuple[Sources, SubpixelSources | None]:
    """Sources with their radiance scaled so that light lost outside of the frame is returned to it.

    Arguments as for `scatter`. The radiance is divided by the fraction of the source's PSF (with tilt) inside the
    frame, ignoring occluders; sources outside of the frame are dropped. Validated: the sum over the image equals the
    sum of radiance in the frame.
    """
    m, n = shape
    inside = np.zeros(sources.label.shape, dtype=bool)
    inside[guard : guard + m, guard : guard + n] = True
    mask = _whole_sources(sources, sub) & inside
    light: Array = np.zeros(mask.size)
    for source, _, share in _tap_shares(spec, replace(sources, visibility=None), mask, shape, guard):
        light[source] += share
    light = light.reshape(mask.shape)
    scale = np.where(light > 0.0, 1.0 / np.where(light > 0.0, light, 1.0), 0.0)
    sources = replace(sources, lit=sources.lit & inside, radiance=sources.radiance * scale[..., None])
    if sub is None:
        return sources, None
    sub = replace(sub, hit=sub.hit & inside[sub.row, sub.column][:, None, None])
    light_sub = np.zeros(int(sub.hit.sum()))
    for source, _, share in _subpixel_tap_shares(spec, replace(sub, visibility=None), shape, guard):
        np.add.at(light_sub, source, share)
    # Shares include 1/S^2; the divisor must be the share of the source's radiance alone.
    light_sub *= sub.hit.shape[1] ** 2
    scale_sub = np.zeros(sub.hit.shape)
    scale_sub[sub.hit] = np.where(light_sub > 0.0, 1.0 / np.where(light_sub > 0.0, light_sub, 1.0), 0.0)
    return sources, replace(sub, radiance=sub.radiance * scale_sub[..., None])


def scatter(spec: BlurSpec, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int) -> Array:
    """Defocused image (m, n, C): the sum over all sources of radiance x PSF x tilt.

    sources: on the padded grid (m + 2 guard, n + 2 guard); sub: sub-pixel sources that replace the source of their
    pixel, or None; shape: (m, n) of the frame; guard: px. For border = "renormalize" see `renormalize`. Weights are
    `PointSpread.weights`, and `subpixel_weights` for sub-pixel sources. Validated: energy is conserved, the image of a
    constant frontal plane is constant, the result is linear, and equals direct sums.
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
