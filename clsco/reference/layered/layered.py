"""Layered occlusion in NumPy float64: depth layers, each blurred with its coverage, laid over each other front to back.

The only input is the pinhole image: radiance and signed blur radius of each pixel of the padded grid (H, W). Of two
surfaces, the one with the smaller signed radius is nearer. A depth layer is a range of radii; layers are numbered from
1, the nearest; 0 means no surface. A sheet is a depth layer with radiance, radius and coverage in all pixels.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY, DISCONTINUITY_CLASSES, FUSED, LAYER_BIN, LAYER_TILE, MIXED_AROUND, OPAQUE
from clsco.optics.depth_layers import bins_of, layer_bounds, level_count, most_deep, reaches_of
from clsco.plan.methods import BlurSpec
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.common.geometry import Array
from clsco.reference.trace.trace import Sources

Mask = NDArray[np.bool_]
Labels = NDArray[np.uint8]
Integers = NDArray[np.int64]

NEIGHBORS = ((0, 1), (2, 1), (1, 0), (1, 2))  # of a pixel at (1, 1): above, below, left, right
MASK_WIDTH = 0.6  # px, standard deviation of the Gaussian of the shares of layers that the labels alone give
NOISE = 5.0  # weight of the surfaces' variance against the color of a mixed pixel
LEAST_DEVIATION = 0.02  # least standard deviation of a surface, as a share of its color
UNEVEN = 0.1  # px, least step of the radius that changes the brightness of an even surface
GAIN = 4.0  # steepness of a hidden outline
PULLED = 1 / 64  # weight of pulled radii beside known ones, so that a slanted surface goes on where it ends
FEWEST_TAPS = 4.8  # least taps in a quadrant of a disc
QUADRANTS = ((-1, -1), (1, -1), (-1, 1), (1, 1))  # signs of x and y on the lens


def _bin(coc: Array, low: float, bins: int) -> Integers:
    """Bin numbers of signed radii `coc`, px."""
    return np.clip(np.floor((coc - low) / LAYER_BIN), 0, bins - 1).astype(np.int64)


def find_discontinuities(coc: Array, valid: Mask, low: float, bins: int, far: int) -> Integers:
    """Find discontinuities of the radius: steps between two valid pixels of a line without a valid pixel between them.

    Lines are rows and columns. coc: (H, W) px; valid: (H, W); low (px), bins: from `bins_of`; far: largest distance of
    the two pixels, px. Entry (k, b) of the result (DISCONTINUITY_CLASSES, bins) is 1 + the largest bin of the near
    side, over the discontinuities larger than DISCONTINUITY 2^k px (class k) whose far side is in bin b; 0 if there is
    none.
    """
    latest = np.zeros((DISCONTINUITY_CLASSES, bins), dtype=np.int64)
    for radius, there in ((coc, valid), (coc.T, valid.T)):
        line, at = np.nonzero(there)
        value = radius[line, at]
        near, away = np.minimum(value[:-1], value[1:]), np.maximum(value[:-1], value[1:])
        pair = (line[1:] == line[:-1]) & (np.diff(at) <= far) & (away - near > DISCONTINUITY)
        near, away = near[pair], away[pair]
        size = np.clip(np.ceil(np.log2((away - near) / DISCONTINUITY)) - 1, 0, DISCONTINUITY_CLASSES - 1).astype(
            np.int64
        )
        np.maximum.at(latest, (size, _bin(away, low, bins)), _bin(near, low, bins) + 1)
    return latest


def label_depth_layers(coc: Array, valid: Mask, low: float, bins: int, bounds: list[int]) -> Labels:
    """Depth layer (H, W) of every pixel. bounds: from `layer_bounds`; other arguments as for `find_discontinuities`."""
    layer = 1 + np.searchsorted(np.asarray(bounds, np.int64), _bin(coc, low, bins), side="right")
    return np.where(valid, layer, 0).astype(np.uint8)


def find_edges(coc: Array, layer: Labels) -> tuple[Labels, Labels, Mask]:
    """Nearer and farther depth layer (H, W) of each pixel next to a discontinuity, 0 elsewhere; and a mask of edges.

    One of the two is the pixel's own layer, the other one that of a neighbor; of several, the one closest in number.
    Edges are also pixels next to one without a surface, and where sources do not add up to even light: where radii of
    neighbors differ by more than UNEVEN px, or the focus is between them.
    """
    rows, columns = layer.shape
    padded, radius = np.pad(layer, 1, mode="edge").astype(np.int64), np.pad(coc, 1, mode="edge")
    before, behind, edge = np.zeros(layer.shape, np.int64), np.full(layer.shape, 255), np.zeros(layer.shape, np.bool_)
    for i, j in NEIGHBORS:
        other, step = (plane[i : i + rows, j : j + columns] for plane in (padded, radius))
        step = np.where((other > 0) & (layer > 0), step - coc, 0.0)
        before = np.where((step < -DISCONTINUITY) & (other < layer), np.maximum(before, other), before)
        behind = np.where((step > DISCONTINUITY) & (other > layer), np.minimum(behind, other), behind)
        edge |= (other == 0) & (layer > 0)
        uneven = (np.abs(step) > UNEVEN) | ((coc < 0) != (coc + step < 0))
        edge |= uneven & (other > 0) & (layer > 0)
    near = np.where(before > 0, before, np.where(behind < 255, layer, 0)).astype(np.uint8)
    far = np.where(before > 0, layer, np.where(behind < 255, behind, 0)).astype(np.uint8)
    return near, far, edge | (near > 0)


def mark_tiles(reach: Integers, edge: Mask) -> Mask:
    """Mask (H, W) of the tiles for which edges matter: one is as near as a source that reaches the tile.

    reach: (H, W) px that each source reaches; edge: (H, W). Tiles have LAYER_TILE rows and columns; the distance of
    pixels is that of their rows or of their columns, whichever is larger.
    """
    padding = [(0, -n % LAYER_TILE) for n in reach.shape]
    far, edges = (
        np.pad(plane, padding, mode="edge")
        .reshape(-(-reach.shape[0] // LAYER_TILE), LAYER_TILE, -1, LAYER_TILE)
        .max(axis=(1, 3))
        for plane in (reach, edge)
    )
    rows, columns = np.indices(far.shape)

    def away(y: int, x: int) -> Integers:
        tiles = np.maximum(np.abs(rows - y), np.abs(columns - x))
        return np.maximum((tiles - 1) * LAYER_TILE + 1, 0)

    coming, marked = far.copy(), edges.copy()
    for y, x in np.argwhere(far >= 0):
        coming = np.where(away(y, x) <= far[y, x], np.maximum(coming, far[y, x]), coming)
    for y, x in np.argwhere(edges):
        marked |= away(y, x) <= coming
    whole = marked.repeat(LAYER_TILE, axis=0).repeat(LAYER_TILE, axis=1)
    return np.asarray(whole[: reach.shape[0], : reach.shape[1]])


def unmix(radiance: Array, layer: Labels, near: Labels, far: Labels) -> tuple[Array, Array, Array]:
    """Radiance (H, W, C) of the near and of the far surface, and share (H, W) of the near one, in pixels at edges.

    Only pixels with `near` > 0 are filled. The mean colors of both surfaces, from pixels up to MIXED_AROUND px away
    that are not at edges, give the share that explains the pixel's color best; the variances of the surfaces say how
    much that counts against the share of the near layer under a Gaussian of MASK_WIDTH px. What is left of the color
    is given to both surfaces, so that the pixel's color is kept, but not beyond the colors of their pixels.
    """
    place = np.nonzero(near > 0)
    colors, count = radiance[place], len(place[0])
    padded, clean = (np.pad(plane, MIXED_AROUND) for plane in (layer, np.where(near > 0, 0, layer)))
    light = np.pad(radiance, ((MIXED_AROUND, MIXED_AROUND), (MIXED_AROUND, MIXED_AROUND), (0, 0)))
    span = range(-MIXED_AROUND, MIXED_AROUND + 1)
    means, variances, masks, ranges, alone = [], [], [], [], np.zeros(count, np.bool_)
    for side in (near[place], far[place]):
        sums = np.zeros((2, count, 2 * radiance.shape[2] + 1))
        ends = np.stack([[colors, colors]] * 2)  # least and largest color, away from edges and of all
        mask = np.zeros(count)
        for dy in span:
            for dx in span:
                at = place[0] + dy + MIXED_AROUND, place[1] + dx + MIXED_AROUND
                weight = float((MIXED_AROUND + 1 - abs(dy)) * (MIXED_AROUND + 1 - abs(dx)))
                here = np.concatenate([light[at], light[at] ** 2, np.ones((count, 1))], axis=-1) * weight
                sums[0] += np.where((clean[at] == side)[:, None], here, 0.0)
                sums[1] += np.where((padded[at] == side)[:, None], here, 0.0)
                for way, labels in enumerate((clean, padded)):
                    there = np.where((labels[at] == side)[:, None], light[at], colors)
                    ends[way] = np.minimum(ends[way, 0], there), np.maximum(ends[way, 1], there)
                if max(abs(dy), abs(dx)) <= 2:
                    mask += np.exp(-0.5 * (dy * dy + dx * dx) / MASK_WIDTH**2) * (padded[at] == side)
        chosen = np.where(sums[0, :, -1:] > 0, sums[0], sums[1])  # thin things are all edge
        alone |= chosen[:, -1] == 0
        mean, square = np.split(chosen[:, :-1] / np.maximum(chosen[:, -1:], 1.0), 2, axis=1)
        means.append(mean)
        ranges.append(np.where(sums[0, :, -1:] > 0, ends[0], ends[1]))
        variances.append(np.maximum(square - mean**2, 0.0).sum(axis=1))
        masks.append(mask)
    difference = means[0] - means[1]
    least = LEAST_DEVIATION**2 * (0.1 + (colors**2).sum(axis=1))
    doubt = NOISE * (variances[0] + variances[1] + least)
    by_color = ((colors - means[1]) * difference).sum(axis=1)
    share = (by_color + doubt * masks[0] / (masks[0] + masks[1])) / ((difference**2).sum(axis=1) + doubt)
    share = np.where(alone, layer[place] == near[place], np.clip(share, 0.0, 1.0))[:, None]
    means = [np.where(alone[:, None], colors, mean) for mean in means]  # the color of the other surface is not known
    left = (colors - share * means[0] - (1.0 - share) * means[1]) / (share**2 + (1.0 - share) ** 2)
    out = np.zeros(radiance.shape), np.zeros(radiance.shape), np.zeros(layer.shape)
    parts = [mean + part * left for mean, part in zip(means, (share, 1.0 - share), strict=True)]
    lights = [np.clip(part, *ends) for part, ends in zip(parts, ranges, strict=True)]
    for plane, values in zip(out, (*lights, share[:, 0]), strict=True):
        plane[place] = values
    return out


def push(fine: Array) -> Array:
    """The next coarser level (ceil(H / 2), ceil(W / 2), C + 1): means of 2 x 2 pixels by their weights, then 0 or 1."""
    sums = np.concatenate([fine[..., :-1] * fine[..., -1:], fine[..., -1:]], axis=-1)
    sums = np.pad(sums, ((0, fine.shape[0] % 2), (0, fine.shape[1] % 2), (0, 0)))
    sums = sums[::2, ::2] + sums[::2, 1::2] + sums[1::2, ::2] + sums[1::2, 1::2]
    total = sums[..., -1:]
    return np.concatenate([sums[..., :-1] / np.where(total > 0, total, 1.0), (total > 0) * 1.0], axis=-1)


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


def pull(fine: Array, coarse: Array, pulled: float = 1.0) -> Array:
    """A level (H, W, C + 1) with its unknown pixels filled from the next coarser one. pulled: weight that these have
    beside known ones.
    """
    surrounding, exists = _around(coarse, fine.shape)
    return np.where(fine[..., -1:] > 0, fine, np.concatenate([surrounding, exists * pulled], axis=-1))


def _spread(values: Array, weight: Array, levels: int, pulled: float = 1.0) -> Array:
    """Values (H, W, C) where they are not known, by push-pull (Gortler et al. 1996); weight: (H, W), 0 for unknown."""
    pyramid = [np.concatenate([values, np.ones((*weight.shape, 1))], axis=-1) * (weight[..., None] > 0)]
    pyramid.append(push(np.concatenate([pyramid[0][..., :-1], weight[..., None]], axis=-1)))
    for _ in range(levels - 1):
        pyramid.append(push(pyramid[-1]))
    coarse = pyramid[-1]
    for fine in pyramid[-2::-1]:
        coarse = pull(fine, coarse, pulled)
    return coarse[..., :-1]


def take_sheet(
    radiance: Array, alpha: Array, coc: Array, layer: Labels, edges: tuple[Labels, Labels],
    parts: tuple[Array, Array, Array], which: int, levels: int,
) -> tuple[Array, Array]:  # fmt: skip
    """One sheet for the blur: radiance, coverage and ones (H, W, C + 2), radiance times coverage; and radius (H, W).

    radiance: not yet multiplied by alpha (H, W); edges, parts: from `find_edges` and `unmix`. The layer covers its own
    pixels, its share of mixed pixels, and behind nearer layers what its outline on both sides suggests; farther layers
    it leaves free. Its radiance and radius elsewhere are extrapolated. Where the pixel in front of it has nearly the
    same radius, the surface is the pixel's, except in mixed pixels, which show what is farther, too.
    """
    (near, far), (near_light, far_light, near_share) = edges, parts
    own, shared = layer == which, near == which
    share = np.where(shared, near_share, np.where(own, alpha, 0.0))
    light = np.where(shared[..., None], near_light, np.where((own & (far == which))[..., None], far_light, radiance))
    weight = np.asarray(own * alpha, dtype=np.float64)
    spread, extrapolated = _spread(light, weight, levels), _spread(coc[..., None], weight, levels, PULLED)[..., 0]
    visible, hidden = share > 0, (layer > 0) & (layer < which)
    outline = _spread(share[..., None], (~hidden).astype(np.float64), levels)
    coverage = np.where(hidden, np.clip(GAIN * (outline[..., 0] - 0.5) + 0.5, 0.0, 1.0), share)
    light = np.where(visible[..., None], light, spread)
    radius = np.where(own, coc, extrapolated)
    whole = (near != layer) & (alpha >= OPAQUE)
    same = hidden & whole & (np.abs(radius - coc) <= FUSED)
    light, radius = np.where(same[..., None], radiance, light), np.where(same, coc, radius)
    coverage = np.where(same, alpha, coverage)[..., None]
    return np.concatenate([light * coverage, coverage, np.ones_like(coverage)], axis=-1), radius


def composite(total: Array, room: Array, blurred: Array) -> tuple[Array, Array]:
    """Frame (m, n, C) and fraction of the lens (m, n) that is free, with one more sheet behind the previous ones.

    blurred: (m, n, C + 2), the blur of `take_sheet`. Both sums of a mean run over the whole sheet: even radiance stays
    even, and no sheet takes light from another.
    """
    reached = blurred[..., -1:] > 0
    mean = np.where(reached, blurred[..., :-1] / np.where(reached, blurred[..., -1:], 1.0), 0.0)
    return total + room[..., None] * mean[..., :-1], room * (1.0 - np.minimum(mean[..., -1], 1.0))


def composite_quadrants(total: Array, room: Array, blurred: Array, radius: Array) -> tuple[Array, Array]:
    """`composite` for each quadrant of the lens, so that what hides one side of it leaves the other side free.

    total: (m, n, C + 1), with the light of C = 1 last; room: (m, n, 4), of each quadrant; blurred: (4, m, n, C + 2), of
    its light; radius: (m, n) px of the sheet. A small disc has too few taps for quadrants.
    """
    joined = (np.pi * radius**2 < 4.0 * FEWEST_TAPS)[..., None]
    own = np.moveaxis(blurred[..., -1], 0, -1)
    ones, covered = own.sum(axis=-1, keepdims=True), blurred[..., -2].sum(axis=0)[..., None]
    reached = ones > 0.0
    whole, shares = np.where(reached, ones, 1.0), np.where(own > 0.0, own, 1.0)
    free = np.where(joined, (room * own).sum(axis=-1, keepdims=True) / whole, room) / whole
    share = np.where(joined | (own <= 0.0), covered / whole, np.moveaxis(blurred[..., -2], 0, -1) / shares)
    light = np.einsum("mnq,qmnc->mnc", free, blurred[..., :-1])
    return total + np.where(reached, light, 0.0), np.where(reached, room * (1.0 - np.minimum(share, 1.0)), room)


def layered(
    spec: BlurSpec, radiance: Array, coc: Array, valid: Mask, shape: tuple[int, int], guard: int
) -> tuple[Array, int]:
    """Defocused image (m, n, C) with occlusion derived from the pinhole image, and its number of depth layers.

    radiance: (H, W, C) on the padded grid, linear; coc: (H, W) signed blur radius in px; valid: (H, W) mask of
    surfaces; shape: (m, n) of the frame; guard: px; |coc| must not exceed `spec.largest`. Without a discontinuity, the
    image equals that of `blur.scatter`. Validated against the ray tracer and the closed form of an edge in front of a
    plane; a cut through a slanted plane leaves no seam, and constant brightness is preserved.
    """
    return spread_depth_layers(spec, radiance, coc, cluster(spec, coc, valid), shape, guard)


def over(
    spec: BlurSpec, layers: list[tuple[Array, Array]], shape: tuple[int, int], guard: int
) -> Array:  # fmt: skip
    """Defocused image (m, n, C + 1) of images with alpha (H, W, C + 1) that lie over each other; radii: (H, W).

    Colors are multiplied by alpha. The earlier images are nearer within a depth layer. Arguments as for `layered`.
    """
    low, bins = bins_of(spec.largest)
    gap = 2 * spec.psf.reach(spec.largest) + 1
    latest = np.max([find_discontinuities(coc, image[..., -1] > 0, low, bins, gap) for image, coc in layers], axis=0)
    bounds = layer_bounds(latest.astype(np.int32))
    images = []
    for image, coc in layers:
        alpha = image[..., -1]
        label = label_depth_layers(coc, alpha > 0, low, bins, bounds)
        images.append((image[..., :-1] / np.where(alpha > 0, alpha, 1.0)[..., None], alpha, coc, label))
    total, room = _lay(spec, images, shape, guard, np.ones(shape), lambda sources: sources)
    return np.concatenate([total, 1.0 - room[..., None]], axis=-1)


def cluster(spec: BlurSpec, coc: Array, valid: Mask) -> Labels:
    """Depth layers (H, W) of an image, from its radii. See `layered` for the arguments."""
    low, bins = bins_of(spec.largest)
    latest = find_discontinuities(coc, valid, low, bins, 2 * spec.psf.reach(spec.largest) + 1)
    return label_depth_layers(coc, valid, low, bins, layer_bounds(latest.astype(np.int32)))


def spread_depth_layers(
    spec: BlurSpec, radiance: Array, coc: Array, layer: Labels, shape: tuple[int, int], guard: int,
    rims: tuple[Callable[[Sources], Sources], Array] | None = None,
) -> tuple[Array, int]:  # fmt: skip
    """`layered` for given depth layers (H, W).

    rims: a function that lets rims cut the light of sources, and the fraction (m, n) of the light that passes them;
    None without rims.
    """
    behind_rims, most = rims or (lambda sources: sources, np.ones(shape))
    count, plain = int(layer.max(initial=0)), _blurred(spec, radiance, coc, layer > 0, shape, guard, behind_rims)
    if count <= 1:
        return plain, count
    _, _, edge = find_edges(coc, layer)
    marked = mark_tiles(np.where(layer > 0, reaches_of(spec.psf, coc), -1), edge)
    image = radiance, np.ones(coc.shape), coc, layer
    total, _ = _lay(spec, [image], shape, guard, most, behind_rims)
    frame = np.ix_(*(np.arange(guard, guard + n) for n in shape))
    return np.where(marked[frame][..., None], total, plain), count


def _blurred(
    spec: BlurSpec, value: Array, radius: Array, there: Mask, shape: tuple[int, int], guard: int,
    behind_rims: Callable[[Sources], Sources], quadrant: tuple[int, int] | None = None,
) -> Array:  # fmt: skip
    label, gradient = there.astype(np.uint8), prepare_sources(radius, there)
    sources = Sources(value, np.ones(radius.shape), label, radius, gradient, there)
    return scatter(spec, behind_rims(sources), None, shape, guard, quadrant)


def _lay(
    spec: BlurSpec, images: list[tuple[Array, Array, Array, Labels]], shape: tuple[int, int], guard: int, room: Array,
    behind_rims: Callable[[Sources], Sources],
) -> tuple[Array, Array]:  # fmt: skip
    """Light (m, n, C) of all sheets, and fraction (m, n) of the lens that they leave free; room: that before them.

    images: radiance, alpha, radius and depth layer of each pixel.
    """
    levels, splits = level_count(most_deep(spec.psf, spec.largest)), []
    for radiance, alpha, coc, layer in images:
        clear = np.where(alpha < OPAQUE, 0, layer).astype(np.uint8)
        near, far, _ = find_edges(coc, layer)
        near, far = np.where(clear > 0, near, 0).astype(np.uint8), np.where(clear > 0, far, 0).astype(np.uint8)
        splits.append(((near, far), unmix(radiance, clear, near, far)))
    quadrants = QUADRANTS if spec.cells > 1 else ()
    total = np.zeros((*shape, images[0][0].shape[2] + (spec.cells > 1)))
    room = np.repeat(room[..., None], len(quadrants), axis=-1) if quadrants else room
    for which in range(1, max(int(layer.max()) for *_, layer in images) + 1):
        for (radiance, alpha, coc, layer), (edges, parts) in zip(images, splits, strict=True):
            sheet, radius = take_sheet(radiance, alpha, coc, layer, edges, parts, which, levels)
            pixels = sheet, radius, np.ones(coc.shape, np.bool_), shape, guard, behind_rims
            if quadrants:
                blurred = np.stack([_blurred(spec, *pixels, quadrant) for quadrant in quadrants])
                inside = radius[guard : guard + shape[0], guard : guard + shape[1]]
                total, room = composite_quadrants(total, room, blurred, inside)
            else:
                total, room = composite(total, room, _blurred(spec, *pixels))
    if not quadrants:
        return total, room
    seen, left = total[..., -1:], room.mean(axis=-1, keepdims=True)
    scale = np.where(seen > 0.0, 1.0 / np.where(seen > 0.0, seen + left, 1.0), 0.0)
    return total[..., :-1] * scale, 1.0 - seen[..., 0] * scale[..., 0]
