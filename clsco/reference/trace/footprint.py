"""Textures on surfaces, averaged over the footprints of pixels, in NumPy float64.

The head of kernels/trace/footprint.clh explains how the mean over a pixel is computed, and what "detail" means.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clsco.constants import (
    APART,
    BENT_CELLS,
    BENT_TEXELS,
    CELL_TEXELS,
    CUBE_BORDER,
    FOOTPRINT_CELLS,
    LEAST_TEXELS,
    MAP_CUBE,
    MAP_TRIPLANAR,
    MOST_BENT_TEXELS,
    MOST_CELL,
    MOST_SHEAR,
    MOST_TEXELS,
    NARROWEST,
    WRAP_CLAMP,
    WRAP_MIRROR,
    WRAP_REPEAT,
)
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.texture_mapping import TextureMap, cut_parts
from clsco.reference.common.geometry import Array, Filter, filter_weights, mirror_index
from clsco.reference.trace.mapping import (
    Indices,
    Mapped,
    MappedTexture,
    Texel,
    along_axis,
    blend_shares,
    is_bent,
    mapped_point,
    own_normal,
    texel_at,
    texel_change,
    wrapped_position,
)
from clsco.scene.model import Camera

GAUSS_PLACE = 0.5 / np.sqrt(3.0)  # distance from the middle of the two Gauss nodes, exact for the mean of a cubic


def wrapped_index(i: Indices, count: int, wrap: int) -> Indices:
    """Indices of stored texels along an axis for texel numbers `i`; -1 where there is no texel."""
    if wrap == WRAP_MIRROR:
        return mirror_index(i, count)
    inside = {WRAP_REPEAT: i % count, WRAP_CLAMP: np.clip(i, 0, count - 1)}
    return inside.get(wrap, np.where((i >= 0) & (i < count), i, -1))


@dataclass(frozen=True, eq=False)
class Taps:
    """Weights (n, taps) of the texels from number `first` (n,) on along an axis, for n intervals.

    mean: weights for the mean over the interval; slope: their derivatives by the position of the interval's middle, per
    texel.
    """

    first: Indices
    mean: Array
    slope: Array


def taps_of(middle: Array, width: Array, texture_filter: Filter) -> Taps:
    """Weights for means over intervals of `width` (n,) around `middle` (n,), in texels.

    The filter is a polynomial between texels, so two Gauss nodes give the exact mean over each piece.
    """
    low, high = middle - 0.5 * width, middle + 0.5 * width
    begin, last = np.floor(low), (np.floor(high) - np.floor(low)).astype(np.intp)
    reach = {"nearest": 1, "bilinear": 2, "bicubic": 4}[texture_filter]
    mean, slope = np.zeros((2, len(middle), int(last.max(initial=0)) + reach))
    for k in range(mean.shape[1] - reach + 1):
        start, end = np.maximum(low - begin - k, 0.0), np.minimum(high - begin - k, 1.0)
        length = np.maximum(end - start, 0.0)
        for aside in (-GAUSS_PLACE, GAUSS_PLACE):
            place = 0.5 * (start + end) + aside * length
            mean[:, k : k + reach] += (0.5 * length / width)[:, None] * filter_weights(place, texture_filter)
    texels, pixel = np.arange(reach), np.arange(len(middle))[:, None]
    slope[pixel, last[:, None] + texels] += filter_weights(high - begin - last, texture_filter) / width[:, None]
    slope[:, :reach] -= filter_weights(low - begin, texture_filter) / width[:, None]
    return Taps(begin.astype(np.intp) - (reach == 4), mean, slope)


def add_texels(level: Array, texture_map: TextureMap, side: Indices, rows: Taps, columns: Taps, skew: Array) -> Array:
    """Means (n, channels) over cells of a mipmap level (sides, rows, columns, channels).

    side: (n,), side on which each cell is; skew: (n,), covariance of columns and rows in a cell.
    """
    total = np.zeros((len(side), level.shape[3]))
    for a in range(rows.mean.shape[1]):
        i = wrapped_index(rows.first + a, level.shape[1], texture_map.wrap_y)
        for b in range(columns.mean.shape[1]):
            j = wrapped_index(columns.first + b, level.shape[2], texture_map.wrap_x)
            weight = rows.mean[:, a] * columns.mean[:, b] + skew * rows.slope[:, a] * columns.slope[:, b]
            there = (i >= 0) & (j >= 0)
            total += np.where(there, weight, 0.0)[:, None] * level[side, i, j]
    return total


def cells_of(square: Array, shear: Array, bent: NDArray[np.bool_]) -> Indices:
    """Number of cells (n,) into which an axis of a pixel's footprint is cut; even if bent, but 1 for a small footprint.

    square (n,): squared length of the axis in texels; shear (n,): product of the columns and rows that the axis spans.
    """
    widest = np.where(bent, BENT_TEXELS, CELL_TEXELS) ** 2
    enough = np.maximum(square / widest, np.where(bent, 0.0, np.abs(shear) / MOST_SHEAR)) / APART
    cells = np.ones(square.shape, np.intp)
    for count in range(1, BENT_CELLS):
        cells += (enough > count**2) & (bent | (count < FOOTPRINT_CELLS))
    return cells + (bent & (16.0 * enough > 1.0)) * (cells % 2)


def _places(cells: int, bent: bool) -> Array:
    """Middles (cells,) of an axis' cells relative to the middle of a part, in parts; if bent, Gauss nodes of pairs."""
    at = np.arange(cells)
    aside = (2.0 * GAUSS_PLACE - 0.5) * np.where(at % 2, 1.0, -1.0) * (bent and cells > 1)
    return np.asarray((at + 0.5 + aside) / cells - 0.5)


@dataclass(frozen=True, eq=False)
class Footprint:
    """Texture reads for n pixels or their parts.

    kinds (n, 4): mipmap level, number of cells to the right and down, and 1 if bent. changes: change of column and row
    in texels per part to the right, then per part down.
    """

    kinds: Indices
    changes: tuple[tuple[Array, Array], tuple[Array, Array]]


def footprint_of(
    texture: MappedTexture, changes: tuple[tuple[Array, Array], tuple[Array, Array]], bent: NDArray[np.bool_]
) -> Footprint:
    """Footprints of pixels: the mipmap level and the cells in it, from the changes of column and row."""
    (rc, rr), (dc, dr) = changes
    across, along = rc * rc + rr * rr, dc * dc + dr * dr
    narrow, total = 2.0 * (rc * dr - rr * dc) ** 2, across + along
    level = np.zeros(across.shape, np.intp)
    most = np.where(bent, MOST_BENT_TEXELS, MOST_TEXELS) ** 2
    for _ in texture.levels[1:]:
        scale = 4.0**level
        coarser = ~(narrow < total * (4.0 * APART * LEAST_TEXELS**2 * scale))
        coarser |= APART * most * scale < np.maximum(across, along)
        level += coarser & (level + 1 < len(texture.levels))
    cells_x, cells_y = (
        cells_of(square / 4.0**level, column * row / 4.0**level, bent)
        for square, (column, row) in zip((across, along), changes, strict=True)
    )
    return Footprint(np.stack([level, cells_x, cells_y, bent.astype(np.intp)], axis=-1), changes)


def mean_texture(
    texture: MappedTexture, point: Mapped, texel: Texel, footprint: Footprint, aside: float = 0.0, below: float = 0.0
) -> Array:
    """Means (n, channels) of a texture over parts of pixels.

    The parts are `aside` parts to the right of the footprints and `below` parts down.
    """
    result = np.zeros((len(footprint.kinds), texture.levels[0].shape[3]))
    for kind in np.unique(footprint.kinds, axis=0):
        selected = np.flatnonzero((footprint.kinds == kind).all(axis=-1))
        for part in _cell_means(texture, point, texel, footprint, selected, (aside, below)):
            result[selected] += part
    return result


def _cell_means(
    texture: MappedTexture, point: Mapped, texel: Texel, footprint: Footprint, selected: Indices,
    shift: tuple[float, float],
) -> Iterator[Array]:  # fmt: skip
    """The terms of `mean_texture`, one per cell, for pixels `selected`, which share one level and number of cells."""
    level, cells_x, cells_y, bent = footprint.kinds[selected[0]].tolist()
    texture_map, stored = texture.map, texture.levels[level]
    border = CUBE_BORDER if texture_map.kind == MAP_CUBE else 0
    share_x = (stored.shape[2] - 2 * border) / texture_map.columns
    share_y = (stored.shape[1] - 2 * border) / texture_map.rows
    right, down = ((x[selected] * share_x, y[selected] * share_y) for x, y in footprint.changes)
    center = Texel(texel.column[selected], texel.row[selected], texel.side[selected])
    places = 0.5 * (texture.texture_filter != "nearest")
    steps = [tuple(change / cells for change in side) for side, cells in ((right, cells_x), (down, cells_y))]
    steps = [(np.zeros_like(x), np.zeros_like(y)) if bent else (x, y) for x, y in steps]
    width_x, width_y = (np.clip(np.hypot(*side), 1.0 / NARROWEST, MOST_CELL) for side in zip(*steps, strict=True))
    most = width_x * width_y  # the skew is at most this, unless cells are clamped to MOST_CELL
    skew = np.clip(sum(x * y for x, y in steps), -most, most) / 12.0
    for b in _places(cells_y, bool(bent)) + shift[1]:
        for a in _places(cells_x, bool(bent)) + shift[0]:
            at = center
            if bent:
                at = texel_at(texture_map, point.at[selected] + a * point.right[selected] + b * point.down[selected])
            x = wrapped_position(at.column, texture_map.columns, texture_map.wrap_x) * share_x - places
            y = wrapped_position(at.row, texture_map.rows, texture_map.wrap_y) * share_y - places
            if not bent:
                x = x + a * right[0] + b * down[0]
                y = y + a * right[1] + b * down[1]
            rows, columns = (taps_of(p + border, n, texture.texture_filter) for p, n in ((y, width_y), (x, width_x)))
            yield add_texels(stored, texture_map, at.side, rows, columns, skew) / (cells_x * cells_y)


def sharpening(texture: MappedTexture, radius: Array) -> Array:
    """Sharpening coefficients c (n,) for signed radii in px: c times each difference to a neighbor is added."""
    u = np.minimum(texture.spread * np.abs(radius), 1.0)
    return np.asarray(0.125 * u * (16.0 / (3.0 * np.pi) - u))


def parts_of(texture: MappedTexture, texels: Array, radius: Array, samples: int) -> Indices:
    """Number of parts per axis for pixels (n,), 0 if one source is enough.

    texels: squared number of texels; radius: signed, px; samples: number of sub-pixel sources per axis.
    """
    spread = (texture.spread * np.abs(radius)).astype(np.float32)
    return cut_parts(texels.astype(np.float32), spread, samples, texture.least)


def surface_texture(
    texture: MappedTexture, surface: PlacedSurface, camera: Camera, rays: Array, w: Array, sources: int
) -> tuple[Array, Array]:
    """Means (n, channels) of the texture on a surface where rays (n, 3) hit it at inverse depths w (n,).

    Also returns the squared number (n,) of texels along the longer axis of each footprint. sources: number per axis of
    a pixel.
    """
    mean, texels = np.zeros((len(w), texture.levels[0].shape[3])), np.zeros(len(w))
    for mask, share, footprint, mean_of in blended_images(texture, surface, camera, rays, w, sources, 1):
        texels[mask] = np.maximum(texels[mask], np.max([c * c + r * r for c, r in footprint.changes], axis=0))
        mean[mask] += share[:, None] * mean_of()
    return mean, texels


def blended_images(
    texture: MappedTexture, surface: PlacedSurface, camera: Camera, rays: Array, w: Array, sources: int, parts: int
) -> Iterator[tuple[NDArray[np.bool_], Array, Footprint, Callable[..., Array]]]:
    """The images that a texture consists of at hits (n,): three for a triplanar mapping, else one.

    Yields for each image: a mask (n,) of the hits that show it; the share of the image at these hits; their footprints;
    and `mean_texture` as a function of `aside` and `below`. sources: per axis of a pixel; parts: per axis of a source.
    """
    point, three = mapped_point(surface, texture.map, camera, rays, w), texture.map.kind == MAP_TRIPLANAR
    shares = blend_shares(own_normal(surface, rays, w)) if three else np.ones((len(w), 1))
    for axis, share in enumerate(shares.T):
        mask = share > 0.0
        planes = (plane[mask] for plane in (point.at, point.right / sources, point.down / sources))
        mapped = Mapped(*(along_axis(plane, axis) if three else plane for plane in planes))
        bent = is_bent(texture.map, mapped)
        mapped = Mapped(mapped.at, mapped.right / parts, mapped.down / parts)
        changes = texel_change(texture.map, mapped.at, mapped.right), texel_change(texture.map, mapped.at, mapped.down)
        footprint = footprint_of(texture, changes, bent)
        mean_of = partial(mean_texture, texture, mapped, texel_at(texture.map, mapped.at), footprint)
        yield mask, share[mask], footprint, mean_of
