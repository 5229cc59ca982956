"""Defocus: every source spreads its radiance over the pixels around it (2.25), in NumPy float64.

Sources are on the padded grid (H, W), with `guard` rows and columns around the frame (m, n). Offsets (dx, dy) are right
and down from a source to a pixel that it contributes to.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from typing import Any

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


@dataclass(frozen=True, eq=False)
class _LitSources:
    """N sources that emit light: pixels, or points in pixels.

    number (N,): index in an array of all pixels, or of all points. place (N, 2): row and column in the frame; x, y
    (N,): offset of a point from the middle of its pixel, px, 0 for pixels. radius (N,): px, signed. slope (N, 2) and
    limb: as for `tilt_factor`. shape (N, 3): as in `Sources`. part: share of its pixel's light.
    """

    number: NDArray[np.int64]
    place: NDArray[np.int64]
    x: Array | float
    y: Array | float
    radius: Array
    slope: Array
    limb: ArrayLike
    shape: Array | None
    visibility: Visibility | None
    points: bool = False
    part: float = 1.0

    def select(self, chosen: NDArray[np.int64]) -> _LitSources:
        """The sources with these indices."""
        arrays = {name: array[chosen] for name, array in vars(self).items() if isinstance(array, np.ndarray)}
        visibility = None if self.visibility is None else self.visibility.select(chosen)
        fields: dict[str, Any] = vars(self) | arrays | {"visibility": visibility}
        return _LitSources(**fields)


def _pixels(spec: BlurSpec, sources: Sources, there: NDArray[np.bool_], guard: int) -> _LitSources:
    """The pixels of a mask (H, W); their numbers are those of raveled arrays (H, W)."""
    number = np.flatnonzero(there)
    slope = tilt_slope(sources.gradient, sources.radius, spec.psf.diffracted)
    if sources.widening is not None:
        slope = slope + sources.widening
    shape = None if sources.shape is None else sources.shape[there]
    visibility = None if sources.visibility is None else sources.visibility.select(number)
    place = np.argwhere(there) - guard
    return _LitSources(number, place, 0.0, 0.0, sources.radius[there], slope[there], False, shape, visibility)


def _points(spec: BlurSpec, sub: SubpixelSources, guard: int) -> _LitSources:
    """The points with `hit`, numbered in this order."""
    samples, (p, i, j) = sub.hit.shape[1], np.nonzero(sub.hit)
    offset, radius = subpixel_offsets(samples), sub.radius[sub.hit]
    slope = tilt_slope(sub.gradient[sub.hit], radius, spec.psf.diffracted)
    if sub.widening is not None:
        slope = slope + sub.widening[sub.hit]
    if sub.visibility is not None:  # 0 where `tap_share` includes the tilt
        slope[np.flatnonzero(sub.visibility.row >= 0)[sub.visibility.lean.any(axis=-1)]] = 0.0
    place = np.stack([sub.row[p], sub.column[p]], axis=-1) - guard
    limb = np.zeros(p.shape, np.bool_) if sub.limb is None else sub.limb[sub.hit]
    shape = None if sub.shape is None else sub.shape[p]
    parts: dict[str, Any] = {"points": True, "part": 1.0 / samples**2}
    return _LitSources(
        np.arange(p.size), place, offset[j], offset[i], radius, slope, limb, shape, sub.visibility, **parts
    )


def _blocks(lit: _LitSources) -> Iterator[_LitSources]:
    """Blocks of sources of similar |R|, which have nearly the same taps; all in a block are partly hidden, or none."""
    hidden = np.zeros(lit.radius.shape, np.bool_) if lit.visibility is None else lit.visibility.row >= 0
    for chosen, size in ((~hidden, BLOCK), (hidden, OCCLUDED_BLOCK)):
        order = np.flatnonzero(chosen)
        order = order[np.argsort(np.abs(lit.radius[order]), kind="stable")]
        blocks = [lit.select(order[start : start + size]) for start in range(0, order.size, size)]
        yield from blocks if chosen is hidden else (replace(block, visibility=None) for block in blocks)


def _tap_shares(
    spec: BlurSpec, lit: _LitSources, shape: Shape, quadrant: Shape | None = None
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]:
    """For blocks of sources and every offset: numbers of sources and of the frame pixels that they reach, and fractions
    of their pixels' radiance. Pixels outside of the frame are left out. quadrant: as for `scatter`.
    """
    psf, equal = spec.psf, not (spec.psf.signed or lit.points or lit.shape is not None)
    for block in _blocks(lit):
        (row, column), visibility = block.place.T, block.visibility
        cells = np.empty(0) if visibility is None else cell_visibility(visibility)
        far = psf.reach(float(np.abs(block.radius[-1])), subpixel=lit.points)
        weights = partial(_weights, psf, block)
        latest = lru_cache(maxsize=1)(weights)
        # Offsets of equal weight, by changed signs and swapped axes, follow each other.
        for dx, dy in sorted(product(range(-far, far + 1), repeat=2), key=lambda offset: sorted(map(abs, offset))):
            y, x = row + dy, column + dx
            inside = (y >= 0) & (y < shape[0]) & (x >= 0) & (x < shape[1])
            share = latest(*sorted((abs(dx), abs(dy)))) if equal else weights(dx, dy)
            if visibility is not None:
                whole = cut_weights(visibility, share, dx, dy, lit.points or psf.edge == "area")
                share = np.asarray(whole * tap_share(visibility, cells, dx, dy))
            if spec.tilt:
                share = share * tilt_factor(
                    *within_rim(psf, dx - block.x, dy - block.y, block.radius), block.slope, block.limb
                )
            if quadrant is not None:
                share = share * _quadrant_share(quadrant, dx, dy, block.radius)
            reached = inside & (share != 0.0)
            yield block.number[reached], (y * shape[1] + x)[reached], share[reached] * lit.part


def _quadrant_share(quadrant: Shape, dx: int, dy: int, radius: Array) -> Array:
    """Share of light for taps (dx, dy) px from sources that goes through a quadrant of the lens."""
    side = np.where(radius < 0.0, -1.0, 1.0)
    across, down = np.sign(dx) * quadrant[0] * side, np.sign(dy) * quadrant[1] * side
    return np.asarray(0.25 * (1.0 + across) * (1.0 + down))


def _weights(psf: PointSpread, block: _LitSources, dx: int, dy: int) -> Array:
    """Weights (N,) of the tap (dx, dy) px from the middle of each source's pixel. If the PSF varies over the frame, the
    weights of four grid positions are blended.
    """
    right, down = np.asarray(dx - block.x), np.asarray(dy - block.y)
    if block.shape is not None:
        size = np.maximum(np.abs(block.radius), LEAST_OPENING)
        return chord_weights(right, down, size, block.shape, point=block.points)
    if psf.varying is None:
        return (psf.subpixel_weights if block.points else psf.weights)(right, down, block.radius)
    row, column = block.place.T
    numbers, shares = psf.varying.blend(column, row)
    blended = np.zeros(block.radius.shape)
    for number in np.unique(numbers):
        share = (shares * (numbers == number)).sum(axis=0)
        if (which := np.flatnonzero(share)).size:
            blended[which] += share[which] * _weights(psf.places[number], block.select(which), dx, dy)
    return blended


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

    def scale_of(lit: _LitSources, count: int) -> Array:
        light = np.zeros(count)
        for source, _, share in _tap_shares(spec, lit, shape):
            light[source] += share / lit.part  # for a single offset, no source occurs twice
        return np.where(light > 0.0, 1.0 / np.where(light > 0.0, light, 1.0), 0.0)

    scale = scale_of(_pixels(spec, replace(sources, visibility=None), mask, guard), mask.size)
    radiance = sources.radiance * scale.reshape(mask.shape)[..., None]
    sources = replace(sources, lit=sources.lit & inside, radiance=radiance)
    if sub is None:
        return sources, None
    sub = replace(sub, hit=sub.hit & inside[sub.row, sub.column][:, None, None])
    scale = np.zeros(sub.hit.shape)
    scale[sub.hit] = scale_of(_points(spec, replace(sub, visibility=None), guard), int(sub.hit.sum()))
    return sources, replace(sub, radiance=sub.radiance * scale[..., None])


def scatter(
    spec: BlurSpec, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int,
    quadrant: Shape | None = None,
) -> Array:  # fmt: skip
    """Defocused image (m, n, C): the sum over all sources of radiance x PSF x tilt.

    sources: on the padded grid (m + 2 guard, n + 2 guard); sub: sub-pixel sources, which replace the pixel's own
    source, or None; shape: (m, n) of the frame; guard: px. For border = "renormalize" see `renormalize`. quadrant: of
    the lens, whose light alone is added, by the signs of its x and y in the image of a positive radius; None for all.
    A pixel in the row or column of its source gets light through both sides.
    """
    m, n = shape
    if spec.border == "renormalize":
        sources, sub = renormalize(spec, sources, sub, shape, guard)
    color = np.zeros((m * n, sources.radiance.shape[2]))
    radiance = sources.radiance.reshape(-1, color.shape[1])
    lit = _pixels(spec, sources, _whole_sources(sources, sub), guard)
    for source, target, share in _tap_shares(spec, lit, shape, quadrant):
        color[target] += share[:, None] * radiance[source]  # for a single offset, no target occurs twice
    if sub is not None:
        radiance = sub.radiance[sub.hit]
        for source, target, share in _tap_shares(spec, _points(spec, sub, guard), shape):
            np.add.at(color, target, share[:, None] * radiance[source])
    return color.reshape(m, n, -1)
