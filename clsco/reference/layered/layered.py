"""Layered occlusion in NumPy float64: depth layers, each blurred with its coverage, composited front to back.

The only input is the pinhole image: radiance and signed blur radius of each pixel of the padded grid (H, W). Of two
surfaces, the one with the smaller signed radius is nearer. A depth layer is a range of radii; layers are numbered from
1, the nearest; 0 means no surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY, DISCONTINUITY_CLASSES, LAYER_BIN, NO_SEED
from clsco.optics.depth_layers import bins_of, depth_of_hidden, layer_bounds, level_count
from clsco.plan.methods import BlurSpec
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.common.geometry import Array
from clsco.reference.trace.trace import Sources

Mask = NDArray[np.bool_]
Labels = NDArray[np.uint8]
Integers = NDArray[np.int64]

NEVER = 1 << 24  # an index beyond the last pixel of any frame
TENT = (0.125, 0.375, 0.375, 0.125)  # weights of a coarse pixel for 4 fine pixels per axis
GROWTH = 4.0  # a coarse pixel counts as fully known once 1 / GROWTH of its tent is known


def _bin(coc: Array, low: float, bins: int) -> Integers:
    """Bin numbers of signed radii `coc`, px."""
    return np.clip(np.floor((coc - low) / LAYER_BIN), 0, bins - 1).astype(np.int64)


def find_discontinuities(coc: Array, valid: Mask, low: float, bins: int, far: int) -> tuple[Integers, int]:
    """Find discontinuities of the radius: steps between two valid pixels of a line without a valid pixel between them.

    Lines are rows and columns. coc: (H, W) px; valid: (H, W); low (px), bins: from `bins_of`; far: largest distance of
    the two pixels, px. Returns an array (DISCONTINUITY_CLASSES, bins), and the largest sum of the two |radii| at a
    discontinuity in px, rounded up. Entry (k, b) of the array is 1 + the largest bin of the near side, over the
    discontinuities larger than DISCONTINUITY 2^k px (class k) whose far side is in bin b; 0 if there is none.
    """
    latest, largest_sum = np.zeros((DISCONTINUITY_CLASSES, bins), dtype=np.int64), 0
    for radius, there in ((coc, valid), (coc.T, valid.T)):
        line, at = np.nonzero(there)
        value = radius[line, at]
        near, away = np.minimum(value[:-1], value[1:]), np.maximum(value[:-1], value[1:])
        pair = (line[1:] == line[:-1]) & (np.diff(at) <= far) & (away - near > DISCONTINUITY)
        near, away = near[pair], away[pair]
        largest_sum = max(largest_sum, int(np.ceil(np.abs(near) + np.abs(away)).max(initial=0)))
        size = np.clip(np.ceil(np.log2((away - near) / DISCONTINUITY)) - 1, 0, DISCONTINUITY_CLASSES - 1).astype(
            np.int64
        )
        np.maximum.at(latest, (size, _bin(away, low, bins)), _bin(near, low, bins) + 1)
    return latest, largest_sum


def label_depth_layers(coc: Array, valid: Mask, low: float, bins: int, bounds: list[int]) -> Labels:
    """Depth layer (H, W) of every pixel. bounds: from `layer_bounds`; other arguments as for `find_discontinuities`."""
    layer = 1 + np.searchsorted(np.asarray(bounds, np.int64), _bin(coc, low, bins), side="right")
    return np.where(valid, layer, 0).astype(np.uint8)


def seed_hidden(coc: Array, layer: Labels) -> Labels:
    """The depth layer (H, W) that is extrapolated behind a pixel at an edge, 0 elsewhere.

    It is the nearest of the layers that the pixel's four neighbors show behind a discontinuity.
    """
    padded, radius = np.pad(layer, 1), np.pad(coc, 1)
    seed = np.zeros_like(layer)
    rows, columns = layer.shape
    for i, j in ((0, 1), (2, 1), (1, 0), (1, 2)):
        near = (slice(i, i + rows), slice(j, j + columns))
        behind = (layer > 0) & (padded[near] > layer) & (radius[near] - coc > DISCONTINUITY)
        seed = np.where(behind & ((seed == 0) | (padded[near] < seed)), padded[near], seed)
    return seed


def column_seeds(seed: Labels) -> Integers:
    """Row offsets (H, W) to the nearest seed in the same column, the upper one of two; NO_SEED if there is none."""
    rows = np.arange(len(seed))[:, None]
    above = np.maximum.accumulate(np.where(seed > 0, rows, -NEVER), axis=0) - rows
    below = np.minimum.accumulate(np.where(seed > 0, rows, NEVER)[::-1], axis=0)[::-1] - rows
    offset = np.where(below < -above, below, above)
    return np.where(np.abs(offset) < NO_SEED, offset, NO_SEED)


def reach_hidden(layer: Labels, seed: Labels, offset: Integers, deep: int) -> tuple[Labels, Mask]:
    """The depth layer (H, W) extrapolated behind each pixel, 0 for none; and a mask (H, W) of pixels near edges.

    It is the layer of the pixel's nearest seed, if that is behind the pixel's own layer. offset: (H, W) from
    `column_seeds`; deep: largest distance of a seed, px. Of seeds at the same distance, the one in the nearest column
    is used; of two such columns, the left one. Pixels up to 2 `deep` px from an edge, in rows and in columns, count as
    near: sources farther away do not reach pixels where the hidden surface may be visible.
    """
    columns, wide = layer.shape[1], 2 * deep
    best, labels = np.full(layer.shape, deep * deep + 1), np.zeros_like(layer)
    edge = np.zeros(layer.shape, dtype=bool)
    padded = np.pad(offset, ((0, 0), (wide, wide)), constant_values=NO_SEED)
    row, column = np.indices(layer.shape)
    for dx in sorted(range(-wide, wide + 1), key=lambda d: (abs(d), d)):
        dy = padded[:, wide + dx : wide + dx + columns]
        edge |= np.abs(dy) <= wide
        nearer = dx * dx + dy * dy < best
        label = seed[np.where(nearer, row + dy, 0), np.clip(column + dx, 0, columns - 1)]
        best, labels = np.where(nearer, dx * dx + dy * dy, best), np.where(nearer, label, labels)
    return np.where((layer > 0) & (labels > layer), labels, 0).astype(np.uint8), edge


def open_depth_layer(radiance: Array, coc: Array, layer: Labels, which: int) -> Array:
    """Finest level (H, W, C + 2) of a pyramid: radiance and radius of one depth layer, and 1 where they are known."""
    known = layer == which
    return np.concatenate([radiance, coc[..., None], known[..., None]], axis=-1) * known[..., None]


def push(fine: Array, last: bool = False) -> Array:
    """The next coarser level (ceil(H / 2), ceil(W / 2), C + 2): means of known pixels, weighted by a 4 x 4 tent.

    last: True for the coarsest level, where partly known pixels are normalized.
    """
    rows, columns = -(-fine.shape[0] // 2), -(-fine.shape[1] // 2)
    known = fine[..., -1:]
    sums = np.concatenate([fine[..., :-1] * known, known], axis=-1)
    sums = np.pad(sums, ((1, 2), (1, 2), (0, 0)))
    sums = np.sum([weight * sums[i : i + 2 * rows : 2] for i, weight in enumerate(TENT)], axis=0)
    sums = np.sum([weight * sums[:, i : i + 2 * columns : 2] for i, weight in enumerate(TENT)], axis=0)
    total = sums[..., -1:]
    return np.concatenate(
        [
            np.where(total > 0, sums[..., :-1] / np.where(total > 0, total, 1.0), 0.0),
            np.where(total > 0, 1.0, 0.0) if last else np.minimum(GROWTH * total, 1.0),
        ],
        axis=-1,
    )


def _between(coarse: Array, count: int, axis: int) -> Array:
    """Bilinear interpolation of a coarse level at `count` fine pixels along an axis."""
    position = np.arange(count)
    near = position // 2
    far = np.clip(np.where(position % 2, near + 1, near - 1), 0, coarse.shape[axis] - 1)
    return np.asarray(0.75 * np.take(coarse, near, axis) + 0.25 * np.take(coarse, far, axis))


def _around(coarse: Array, shape: tuple[int, ...]) -> tuple[Array, Mask]:
    """Means (H, W, C + 1) of a coarser level around each pixel of a finer level, and a mask of pixels that have one."""
    known = coarse[..., -1:]
    sums = _between(_between(np.concatenate([coarse[..., :-1] * known, known], axis=-1), shape[0], 0), shape[1], 1)
    share = sums[..., -1:]
    return np.where(share > 0, sums[..., :-1] / np.where(share > 0, share, 1.0), 0.0), share > 0


def pull(fine: Array, coarse: Array) -> Array:
    """A level (H, W, C + 2) with its unknown and partly known pixels filled from the next coarser one."""
    known = fine[..., -1:]
    surrounding, exists = _around(coarse, fine.shape)
    values = np.where(exists, known * fine[..., :-1] + (1.0 - known) * surrounding, fine[..., :-1])
    return np.concatenate([values, np.where((known > 0) | exists, 1.0, 0.0)], axis=-1)


def take_depth_layer(
    radiance: Array, coc: Array, layer: Labels, hidden: Labels, coarse: Array, which: int
) -> tuple[Array, Array, Mask]:
    """One depth layer for the blur: radiance with coverage (H, W, C + 1), radius (H, W), and mask of its pixels (H, W).

    coarse: the second level of the layer's pyramid, already filled, from which the hidden part is interpolated.
    """
    behind, _ = _around(coarse, layer.shape)
    visible, extended = layer == which, hidden == which
    mask = visible | extended
    light = np.where(visible[..., None], radiance, behind[..., :-1])
    value = np.concatenate([light, np.ones((*layer.shape, 1))], axis=-1) * mask[..., None]
    return value, np.where(visible, coc, np.where(extended, behind[..., -1], 0.0)), mask


def keep_sources(sources: Sources, edge: Mask, near_edges: bool) -> Sources:
    """Keep only the sources near edges if `near_edges`, else only the others; edge: (H, W) from `reach_hidden`."""
    return replace(sources, lit=sources.lit & (edge == near_edges))


def composite(total: Array, covered: Array, blurred: Array, most: Array | float = 1.0) -> tuple[Array, Array]:
    """Frame (m, n, C) and coverage so far (m, n), with one more depth layer composited behind the previous ones.

    blurred: (m, n, C + 1), irradiance and coverage of the layer; most (m, n): fraction of the light that passes rims.
    The layer is weighted by the coverage that nearer layers leave. Where two layers cut a continuous surface, their
    coverages sum to the coverage of the whole, so that no light is lost.
    """
    coverage = blurred[..., -1]
    visible = np.maximum(np.minimum(coverage, np.maximum(coverage, most) - covered), 0.0)
    share = np.where(visible < coverage, visible / np.where(visible < coverage, coverage, 1.0), 1.0)
    return total + share[..., None] * blurred[..., :-1], covered + visible


def extend_depth_layer(
    radiance: Array, coc: Array, layer: Labels, hidden: Labels, which: int, deep: int
) -> tuple[Array, Array, Mask]:
    """One depth layer extended by its hidden part; see `take_depth_layer` for the result.

    Push-pull over a pyramid (Gortler et al. 1996). It has just enough levels that each pixel depends on pixels up to
    deep + 1 px away, because hidden pixels are no farther from their layer. So strips of a frame need only nearby rows.
    """
    levels, count = [open_depth_layer(radiance, coc, layer, which)], level_count(deep)
    for level in range(1, count + 1):
        levels.append(push(levels[-1], last=level == count))
    coarse = levels[-1]
    for fine in levels[-2:0:-1]:
        coarse = pull(fine, coarse)
    return take_depth_layer(radiance, coc, layer, hidden, coarse, which)


def layered(
    spec: BlurSpec, radiance: Array, coc: Array, valid: Mask, shape: tuple[int, int], guard: int
) -> tuple[Array, int]:
    """Defocused image (m, n, C) with occlusion derived from the pinhole image, and its number of depth layers.

    radiance: (H, W, C) on the padded grid, linear; coc: (H, W) signed blur radius in px; valid: (H, W) mask of
    surfaces; shape: (m, n) of the frame; guard: px; |coc| must not exceed `spec.largest`. Without a discontinuity, the
    image equals that of `blur.scatter`. Validated against the ray tracer and the closed form of an edge in front of a
    plane; a cut through a slanted plane leaves no seam, and constant brightness is preserved.
    """
    labels, deep = cluster(spec, coc, valid)
    return spread_depth_layers(spec, radiance, coc, labels, shape, guard, deep)


def cluster(spec: BlurSpec, coc: Array, valid: Mask) -> tuple[Labels, int]:
    """Depth layers (H, W) of an image, from its radii, and the width in px of the strip behind an edge that may be
    visible.

    See `layered` for the arguments.
    """
    low, bins = bins_of(spec.largest)
    latest, largest_sum = find_discontinuities(coc, valid, low, bins, 2 * spec.psf.reach(spec.largest) + 1)
    labels = label_depth_layers(coc, valid, low, bins, layer_bounds(latest.astype(np.int32)))
    return labels, depth_of_hidden(spec.psf, largest_sum)


def spread_depth_layers(
    spec: BlurSpec, radiance: Array, coc: Array, layer: Labels, shape: tuple[int, int], guard: int, deep: int,
    rims: tuple[Callable[[Sources], Sources], Array] | None = None,
) -> tuple[Array, int]:  # fmt: skip
    """`layered` for given depth layers (H, W), which are extrapolated up to `deep` px behind an edge.

    rims: a function that lets rims cut the light of sources, and the argument `most` of `composite`; None without rims.
    """
    behind_rims, most = rims or (lambda sources: sources, 1.0)

    def blurred_sum(value: Array, radius: Array, there: Mask, near_edges: bool) -> Array:
        label, gradient = there.astype(np.uint8), prepare_sources(radius, there)
        sources = Sources(value, np.ones(coc.shape), label, radius, gradient, there)
        return scatter(spec, keep_sources(behind_rims(sources), edge, near_edges), None, shape, guard)

    count, seed = int(layer.max(initial=0)), seed_hidden(coc, layer)
    hidden, edge = reach_hidden(layer, seed, column_seeds(seed), deep)
    total, covered = blurred_sum(radiance, coc, layer > 0, near_edges=False), np.zeros(shape)
    for which in range(1, count + 1):
        blurred = blurred_sum(*extend_depth_layer(radiance, coc, layer, hidden, which, deep), near_edges=True)
        total, covered = composite(total, covered, blurred, most)
    return total, count
