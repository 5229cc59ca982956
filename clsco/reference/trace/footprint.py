"""Textures on surfaces, filtered over the footprints of pixels, in NumPy float64.

How the mean over a pixel is formed, and what detail is, stands at the head of kernels/trace/footprint.clh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.constants import (
    APART,
    CELL_TEXELS,
    CUBE_BORDER,
    DETAILED_LEAST,
    DETAILED_MOST,
    DETAILED_TEXELS,
    FINE_MOST,
    FINE_TEXELS,
    FOOTPRINT_CELLS,
    LEAST_TEXELS,
    MAP_CUBE,
    MAP_TRIPLANAR,
    MOST_BENT_TEXELS,
    MOST_TEXELS,
    NEAR_FOCUS,
    WRAP_CLAMP,
    WRAP_MIRROR,
    WRAP_REPEAT,
)
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.texture_mapping import TextureMap
from clsco.reference.common.geometry import Array, Filter, mirror_index
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


def wrapped_index(i: Indices, count: int, wrap: int) -> Indices:
    """Indices of texels as they are stored along an axis, -1 for none."""
    if wrap == WRAP_REPEAT:
        return np.asarray(i % count)
    if wrap == WRAP_MIRROR:
        return np.asarray(mirror_index(i, count))
    if wrap == WRAP_CLAMP:
        return np.clip(i, 0, count - 1)
    return np.where((i >= 0) & (i < count), i, -1)


def add_texel(
    level: Array,
    texture_map: TextureMap,
    texture_filter: Filter,
    at: tuple[Indices, Indices, Indices],
    y: Array,
    x: Array,
) -> Array:
    """Values (n, channels) of a level (sides, rows, columns, channels) at places.

    at: side, row and column of texels; y, x: beyond their centers, 0 to 1. The last channel of nothing is `outside`.
    """
    side, row, column = at
    if texture_filter == "nearest":
        row, column = row + (y >= 0.5), column + (x >= 0.5)
        weights = [[np.ones(y.shape)], [np.ones(x.shape)]]
    elif texture_filter == "bilinear":
        weights = [[1.0 - y, y], [1.0 - x, x]]
    else:
        row, column = row - 1, column - 1
        weights = [
            [
                0.5 * t * (-1.0 + t * (2.0 - t)),
                1.0 + 0.5 * t * t * (3.0 * t - 5.0),
                0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
                0.5 * t * t * (t - 1.0),
            ]
            for t in (y, x)
        ]
    rows, columns = level.shape[1:3]
    total = np.zeros((*y.shape, level.shape[3]))
    for a, across in enumerate(weights[0]):
        i = wrapped_index(row + a, rows, texture_map.wrap_y)
        for b, along in enumerate(weights[1]):
            j = wrapped_index(column + b, columns, texture_map.wrap_x)
            texel = np.where(((i < 0) | (j < 0))[..., None], 0.0, level[side, i, j])
            total += (across * along)[..., None] * texel
    return total


def nodes_of(square: Array) -> tuple[Indices, Indices]:
    """Nodes per cell, and cells, for squares (n,) of the number of texels along an axis of a pixel."""
    square = square / APART
    nodes = 1 + (square > 1.0 / 64.0).astype(np.intp) + (square > 1.0) + (square > 4.0)
    cells = np.ones(square.shape, np.intp)
    for count in range(1, FOOTPRINT_CELLS):
        cells += square > CELL_TEXELS**2 * count**2
    return nodes, cells


def _offsets(nodes: int, cells: int, shift: float) -> tuple[Array, Array]:
    """Nodes from -1/2 to 1/2 and beyond by a shift, and their weights: those of Gauss and Legendre in each cell."""
    at, weights = np.polynomial.legendre.leggauss(nodes)
    places = (np.arange(cells)[:, None] + 0.5 + 0.5 * at) / cells - 0.5 + shift
    return places.ravel(), np.tile(0.5 * weights / cells, cells)


@dataclass(frozen=True, eq=False)
class Footprint:
    """Reads of a texture for n pixels or parts of them: kinds (n, 6): level, nodes and cells to the right, nodes and
    cells down, and whether it is bent; changes: of column and row from part to part, right and down."""

    kinds: Indices
    changes: tuple[tuple[Array, Array], tuple[Array, Array]]


def footprint_of(
    texture: MappedTexture, changes: tuple[tuple[Array, Array], tuple[Array, Array]], bent: NDArray[np.bool_]
) -> Footprint:
    """The level of the mipmap, and nodes in it, for changes of column and row."""
    (rc, rr), (dc, dr) = changes
    across, along = rc * rc + rr * rr, dc * dc + dr * dr
    narrow, both = 2.0 * (rc * dr - rr * dc) ** 2, across + along
    level = np.zeros(across.shape, np.intp)
    most = np.where(bent, MOST_BENT_TEXELS, MOST_TEXELS) ** 2
    for _ in texture.levels[1:]:
        each = 4.0**level
        more = ~(narrow < both * (4.0 * APART * LEAST_TEXELS**2 * each)) | (
            APART * most * each < np.maximum(across, along)
        )
        level += more & (level + 1 < len(texture.levels))
    (nodes_x, cells_x), (nodes_y, cells_y) = (nodes_of(square / 4.0**level) for square in (across, along))
    kinds = np.stack([level, nodes_x, cells_x, nodes_y, cells_y, bent.astype(np.intp)], axis=-1)
    return Footprint(kinds, changes)


def mean_texture(
    texture: MappedTexture, point: Mapped, texel: Texel, footprint: Footprint, aside: float = 0.0, below: float = 0.0
) -> Array:
    """Means (n, channels) of a texture over parts so many parts to the right and below those of footprints.

    Validated against means of many samples.
    """
    result = np.empty((len(footprint.kinds), texture.levels[0].shape[3]))
    for kind in np.unique(footprint.kinds, axis=0):
        here = (footprint.kinds == kind).all(axis=-1)
        result[here] = _mean_of_kind(texture, point, texel, footprint, here, (aside, below))
    return result


def _mean_of_kind(
    texture: MappedTexture, point: Mapped, texel: Texel, footprint: Footprint, here: NDArray[np.bool_],
    shift: tuple[float, float],
) -> Array:  # fmt: skip
    """`mean_texture` of pixels `here`, which have one level and the same nodes."""
    level, nodes_x, cells_x, nodes_y, cells_y, bent = (int(n) for n in footprint.kinds[here][0])
    texture_map, stored = texture.map, texture.levels[level]
    border = CUBE_BORDER if texture_map.kind == MAP_CUBE else 0
    share_x = (stored.shape[2] - 2 * border) / texture_map.columns
    share_y = (stored.shape[1] - 2 * border) / texture_map.rows
    right, down = (
        tuple(c[here] * s for c, s in zip(change, (share_x, share_y), strict=True)) for change in footprint.changes
    )
    center = Texel(texel.column[here], texel.row[here], texel.side[here])
    total = np.zeros((int(here.sum()), stored.shape[3]))
    for b, weight_y in zip(*_offsets(nodes_y, cells_y, shift[1]), strict=True):
        for a, weight_x in zip(*_offsets(nodes_x, cells_x, shift[0]), strict=True):
            at = center
            if bent:
                at = texel_at(texture_map, point.at[here] + a * point.right[here] + b * point.down[here])
            x = wrapped_position(at.column, texture_map.columns, texture_map.wrap_x) * share_x - 0.5
            y = wrapped_position(at.row, texture_map.rows, texture_map.wrap_y) * share_y - 0.5
            if not bent:
                x = x + a * right[0] + b * down[0]
                y = y + a * right[1] + b * down[1]
            i, j = np.floor(y), np.floor(x)
            place = (at.side, i.astype(np.intp) + border, j.astype(np.intp) + border)
            total += weight_y * weight_x * add_texel(stored, texture_map, texture.texture_filter, place, y - i, x - j)
    return total


def sharpening(texture: MappedTexture, radius: Array) -> Array:
    """Shares c (n,) of their differences to neighbors that sources of signed radii in px take."""
    u = np.minimum(texture.spread * np.abs(radius), 1.0)
    return np.asarray(0.125 * u * (16.0 / (3.0 * np.pi) - u))


def parts_of(texture: MappedTexture, texels: Array, radius: Array, samples: int) -> Indices:
    """Parts per axis of pixels (n,) with so many texels, squared, and a signed radius in px, 0 where one source is
    enough; samples: sub-pixel sources per axis."""
    r = (texture.spread * np.abs(radius)).astype(np.float32)
    texels = texels.astype(np.float32)
    finer = texels > np.float32(FINE_TEXELS) ** 2
    most = np.where(finer, np.float32(FINE_MOST), np.float32(DETAILED_MOST))
    detailed = (texels > np.float32(DETAILED_TEXELS) ** 2) & (r > np.float32(DETAILED_LEAST)) & (r < most)
    fine = finer | (r < np.float32(NEAR_FOCUS))
    many = 4 if samples % 4 == 0 else 3 if samples % 3 == 0 else samples
    return np.where(detailed, np.where(fine, many, 2 if samples % 2 == 0 else many), 0)


def surface_texture(
    texture: MappedTexture, surface: PlacedSurface, camera: Camera, rays: Array, w: Array, sources: int
) -> tuple[Array, Array]:
    """Means (n, channels) of the texture on a surface where rays (n, 3) hit it at inverse depths w (n,), and squares
    (n,) of the texels of the wider axes of their footprints; sources: per axis of a pixel."""
    point = mapped_point(surface, texture.map, camera, rays, w)
    point = Mapped(point.at, point.right / sources, point.down / sources)
    three = texture.map.kind == MAP_TRIPLANAR
    shares = blend_shares(own_normal(surface, rays, w)) if three else np.ones((len(w), 1))
    mean = np.zeros((len(w), texture.levels[0].shape[3]))
    texels = np.zeros(len(w))
    for axis in range(shares.shape[1]):
        here = shares[:, axis] > 0.0
        parts = (part[here] for part in (point.at, point.right, point.down))
        seen = Mapped(*(along_axis(part, axis) if three else part for part in parts))
        texel = texel_at(texture.map, seen.at)
        changes = texel_change(texture.map, seen.at, seen.right), texel_change(texture.map, seen.at, seen.down)
        texels[here] = np.maximum(texels[here], np.max([c * c + r * r for c, r in changes], axis=0))
        bent, share = is_bent(texture.map, seen), shares[here, axis, None]
        mean[here] += share * mean_texture(texture, seen, texel, footprint_of(texture, changes, bent))
    return mean, texels
