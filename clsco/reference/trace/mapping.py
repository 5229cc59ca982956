"""Textures that lie on surfaces, filtered over the footprint of a pixel, in NumPy float64.

Coordinates are those of `clsco.optics.texture_mapping`; how the mean over a pixel is formed, and what detail is, stands
at the head of kernels/trace/mapping.clh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.constants import (
    CUBE_BORDER,
    MAP_CONE,
    MAP_CUBE,
    MAP_CYLINDER,
    MAP_LONGITUDE,
    MAP_TRIPLANAR,
    WRAP_CLAMP,
    WRAP_MIRROR,
    WRAP_REPEAT,
)
from clsco.inputs.mipmaps import SIDES, mipmap
from clsco.inputs.mipmaps import cube_side as side_of
from clsco.optics.lens import ray_step
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.texture_mapping import DETAILED_LEAST, DETAILED_MOST, TextureMap, texture_spread
from clsco.reference.common.geometry import (
    Array,
    Filter,
    canonical_gradient,
    mirror_index,
    surface_normal,
    turned,
    turned_back,
)
from clsco.scene.model import Camera, Psf

MOST_CELLS, CELL_TEXELS, LEAST_TEXELS = 8, 3, 2
MOST_TEXELS, MOST_BENT_TEXELS = MOST_CELLS * CELL_TEXELS, 64
BENT = 256.0
FARTHEST_TEXEL = 1e6
DETAILED_TEXELS = np.float32(0.54)
TINY = 1e-12
APART = 1.17
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MappedTexture:
    """An image on a surface.

    levels: of its mipmap, (sides, rows, columns, channels) float64; map: how it lies; spread: radius of the disc whose
    moments a PSF with R = 1 has, 0 where sources are no squares; texture_filter: between texels.
    """

    levels: tuple[Array, ...]
    map: TextureMap
    spread: float
    texture_filter: Filter


def mapped_texture(
    images: Sequence[NDArray[np.float32]], found: TextureMap, psf: Psf, texture_filter: Filter
) -> MappedTexture:
    """A `MappedTexture` of images (rows, columns, channels): one, or the six of a cube map."""
    levels = tuple(level.astype(np.float64) for level in mipmap(images))
    return MappedTexture(levels, found, texture_spread(psf), texture_filter)


@dataclass(frozen=True, eq=False)
class Mapped:
    """q of hits (n, 3) in the frame of a texture, and what it changes by per pixel to the right and down."""

    at: Array
    right: Array
    down: Array


@dataclass(frozen=True, eq=False)
class Texel:
    """Column and row (n,) in texels, with their edges at whole numbers, and side of a cube map."""

    column: Array
    row: Array
    side: Indices


def mapped_point(surface: PlacedSurface, found: TextureMap, camera: Camera, rays: Array, w: Array) -> Mapped:
    """Where hits of rays (n, 3) at inverse depths w (n,) in 1/mm are in the frame of a texture."""
    d = turned(surface.turn, rays)
    gradient = canonical_gradient(surface, d, w)
    n, facing = turned_back(surface.turn, gradient), (gradient * d).sum(axis=-1)
    each = np.where(facing != 0.0, -1.0 / np.where(facing != 0.0, facing, 1.0), 0.0)
    steps = []
    for axis, sign in ((0, 1.0), (1, -1.0)):
        change = np.eye(3)[axis] + rays * (n[..., axis] * each)[..., None]
        steps.append(turned(found.frame, turned(surface.own_turn, change * (sign * ray_step(camera) / w)[..., None])))
    own = surface.own_offset + turned(surface.own_turn, rays) / w[..., None]
    return Mapped(turned(found.frame, own), *steps)


def square_from_axis(q: Array) -> Array:
    """Square of the distance (n,) from the axis, never quite 0."""
    least = np.maximum(TINY * (q * q).sum(axis=-1), 1e-30)
    return np.asarray(np.maximum(q[..., 0] ** 2 + q[..., 2] ** 2, least))


def cube_side(q: Array) -> tuple[Indices, Array]:
    """Side of a cube that directions (n, 3) meet, and these in its axes: right, up and out."""
    side, _, _ = side_of(q)
    return side, on_side(q, side)


def on_side(q: Array, side: Indices) -> Array:
    """Vectors (n, 3) in the axes of sides (n,)."""
    axes = np.array([[axis for axis, _ in (right, up, out)] for out, right, up in SIDES])
    signs = np.array([[sign for _, sign in (right, up, out)] for out, right, up in SIDES])
    return np.asarray(np.take_along_axis(q, axes[side], -1) * signs[side])


def texels_of(found: TextureMap, x: Array, y: Array) -> tuple[Array, Array]:
    """Columns and rows of coordinates, or of their changes."""
    (a, b), (c, d) = found.scale
    return a * x + b * y, c * x + d * y


def wrapped_position(position: Array, count: int, wrap: int) -> Array:
    """Positions within one period of what repeats, and not far beyond what does not."""
    if wrap in (WRAP_REPEAT, WRAP_MIRROR):
        period = 2.0 * count if wrap == WRAP_MIRROR else float(count)
        position = position - period * np.floor(position / period)
    position = np.where(position < FARTHEST_TEXEL, position, FARTHEST_TEXEL)
    return np.asarray(np.maximum(position, -FARTHEST_TEXEL))


def texel_at(found: TextureMap, q: Array) -> Texel:
    """The texels at q (n, 3), before any wrapping."""
    x, y, side = q[..., 0], q[..., 1], np.zeros(q.shape[:-1], np.intp)
    angle = np.arctan2(x, q[..., 2])
    if found.kind == MAP_CYLINDER:
        x = angle
    elif found.kind == MAP_LONGITUDE:
        x, y = angle, np.arctan2(y, np.hypot(x, q[..., 2]))
    elif found.kind == MAP_CONE:
        length = np.sqrt((q * q).sum(axis=-1))
        x, y = length * np.sin(found.slant * angle), length * np.cos(found.slant * angle)
    elif found.kind == MAP_CUBE:
        side, on = cube_side(q)
        x, y = on[..., 0] / on[..., 2], on[..., 1] / on[..., 2]
    column, row = texels_of(found, x, y)
    return Texel(column + found.shift[0], row + found.shift[1], side)


def texel_change(found: TextureMap, q: Array, dq: Array) -> tuple[Array, Array]:
    """Change of column and row where q changes by dq, (n, 3)."""
    x, y = dq[..., 0], dq[..., 1]
    if found.kind in (MAP_CYLINDER, MAP_LONGITUDE, MAP_CONE):
        square = square_from_axis(q)
        x = (q[..., 2] * dq[..., 0] - q[..., 0] * dq[..., 2]) / square
        if found.kind == MAP_LONGITUDE:
            radius = np.sqrt(square)
            out = (q[..., 0] * dq[..., 0] + q[..., 2] * dq[..., 2]) / radius
            y = (radius * dq[..., 1] - q[..., 1] * out) / (square + q[..., 1] ** 2)
        if found.kind == MAP_CONE:
            length = np.sqrt(square + q[..., 1] ** 2)
            out = np.where(length > 0.0, (q * dq).sum(axis=-1) / np.where(length > 0.0, length, 1.0), 0.0)
            around = length * x * found.slant
            angle = found.slant * np.arctan2(q[..., 0], q[..., 2])
            x = out * np.sin(angle) + around * np.cos(angle)
            y = out * np.cos(angle) - around * np.sin(angle)
    if found.kind == MAP_CUBE:
        side, on = cube_side(q)
        d = on_side(dq, side)
        x, y = ((d[..., k] * on[..., 2] - on[..., k] * d[..., 2]) / on[..., 2] ** 2 for k in (0, 1))
    return texels_of(found, x, y)


def is_bent(found: TextureMap, point: Mapped) -> NDArray[np.bool_]:
    """Whether coordinates are far from linear within the footprints of pixels (n,)."""
    q, right, down = point.at, point.right, point.down
    if found.kind in (MAP_LONGITUDE, MAP_CONE):
        least = (q[..., 0] ** 2 + q[..., 2] ** 2) / BENT
        return np.asarray((least < (right * right).sum(axis=-1)) | (least < (down * down).sum(axis=-1)))
    if found.kind == MAP_CUBE:
        own, corners = cube_side(q)[0], [q + a * right + b * down for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
        return np.any([cube_side(corner)[0] != own for corner in corners], axis=0)
    return np.zeros(q.shape[:-1], dtype=bool)


def wrapped_index(i: Indices, count: int, wrap: int) -> Indices:
    """Indices of texels in what is stored of an axis, -1 for nothing."""
    if wrap == WRAP_REPEAT:
        return np.asarray(i % count)
    if wrap == WRAP_MIRROR:
        return np.asarray(mirror_index(i, count))
    if wrap == WRAP_CLAMP:
        return np.clip(i, 0, count - 1)
    return np.where((i >= 0) & (i < count), i, -1)


def add_texel(
    level: Array, found: TextureMap, texture_filter: Filter, at: tuple[Indices, Indices, Indices], y: Array, x: Array
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
        i = wrapped_index(row + a, rows, found.wrap_y)
        for b, along in enumerate(weights[1]):
            j = wrapped_index(column + b, columns, found.wrap_x)
            texel = np.where(((i < 0) | (j < 0))[..., None], 0.0, level[side, i, j])
            total += (across * along)[..., None] * texel
    return total


def nodes_of(square: Array) -> tuple[Indices, Indices]:
    """Nodes per cell, and cells, for squares (n,) of the number of texels along an axis of a pixel."""
    square = square / APART
    nodes = 1 + (square > 1.0 / 64.0).astype(np.intp) + (square > 1.0) + (square > 4.0)
    cells = np.ones(square.shape, np.intp)
    for count in range(1, MOST_CELLS):
        cells += square > CELL_TEXELS**2 * count**2
    return nodes, cells


def _offsets(nodes: int, cells: int) -> tuple[Array, Array]:
    """Nodes from -1/2 to 1/2, and their weights: those of Gauss and Legendre in each cell."""
    at, weights = np.polynomial.legendre.leggauss(nodes)
    places = (np.arange(cells)[:, None] + 0.5 + 0.5 * at) / cells - 0.5
    return places.ravel(), np.tile(0.5 * weights / cells, cells)


def mean_texture(
    texture: MappedTexture, point: Mapped, texel: Texel, changes: tuple[tuple[Array, Array], tuple[Array, Array]],
    bent: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Means (n, channels) of a texture over pixels.

    changes: of column and row per pixel to the right, and down. Validated against means of many samples.
    """
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
    result = np.empty((*across.shape, texture.levels[0].shape[3]))
    kinds = np.stack([level, nodes_x, cells_x, nodes_y, cells_y, bent.astype(np.intp)], axis=-1)
    for kind in np.unique(kinds.reshape(-1, 6), axis=0):
        here = (kinds == kind).all(axis=-1)
        result[here] = _mean_of_kind(texture, point, texel, changes, here, [int(n) for n in kind])
    return result


def _mean_of_kind(
    texture: MappedTexture, point: Mapped, texel: Texel, changes: tuple[tuple[Array, Array], tuple[Array, Array]],
    here: NDArray[np.bool_], kind: list[int],
) -> Array:  # fmt: skip
    """`mean_texture` of pixels `here`, which have one level and the same nodes."""
    level, nodes_x, cells_x, nodes_y, cells_y, bent = kind
    found, stored = texture.map, texture.levels[level]
    border = CUBE_BORDER if found.kind == MAP_CUBE else 0
    share_x = (stored.shape[2] - 2 * border) / found.columns
    share_y = (stored.shape[1] - 2 * border) / found.rows
    right, down = (tuple(c[here] * s for c, s in zip(change, (share_x, share_y), strict=True)) for change in changes)
    center = Texel(texel.column[here], texel.row[here], texel.side[here])
    total = np.zeros((int(here.sum()), stored.shape[3]))
    for b, weight_y in zip(*_offsets(nodes_y, cells_y), strict=True):
        for a, weight_x in zip(*_offsets(nodes_x, cells_x), strict=True):
            at = center
            if bent:
                at = texel_at(found, point.at[here] + a * point.right[here] + b * point.down[here])
            x = wrapped_position(at.column, found.columns, found.wrap_x) * share_x - 0.5
            y = wrapped_position(at.row, found.rows, found.wrap_y) * share_y - 0.5
            if not bent:
                x = x + a * right[0] + b * down[0]
                y = y + a * right[1] + b * down[1]
            i, j = np.floor(y), np.floor(x)
            place = (at.side, i.astype(np.intp) + border, j.astype(np.intp) + border)
            total += weight_y * weight_x * add_texel(stored, found, texture.texture_filter, place, y - i, x - j)
    return total


def blend_shares(normal: Array) -> Array:
    """Shares (n, 3) of the three images of a triplanar mapping, for unit normals (n, 3)."""
    above = np.maximum(normal**2 - 0.1, 0.0) ** 2
    return np.asarray(above / above.sum(axis=-1, keepdims=True))


def own_normal(surface: PlacedSurface, rays: Array, w: Array) -> Array:
    """Unit normals (n, 3) of hits in the object's own frame."""
    return turned(surface.own_turn, surface_normal(surface, rays, w))


def along_axis(q: Array, axis: int) -> Array:
    """Points or changes (n, 3) as seen along an axis."""
    return np.asarray(q[..., ((2, 1, 0), (0, 2, 1), (0, 1, 2))[axis]])


def sharpening(texture: MappedTexture, radius: Array) -> Array:
    """Shares c (n,) of their differences to neighbors that sources of signed radii in px take."""
    u = np.minimum(texture.spread * np.abs(radius), 1.0)
    return np.asarray(0.125 * u * (16.0 / (3.0 * np.pi) - u))


def is_detailed(texture: MappedTexture, texels: Array, radius: Array) -> NDArray[np.bool_]:
    """Whether pixels (n,) with so many texels, squared, and a signed radius in px need sub-pixel sources."""
    r = (texture.spread * np.abs(radius)).astype(np.float32)
    fine = texels.astype(np.float32) > DETAILED_TEXELS**2
    return np.asarray(fine & (r > np.float32(DETAILED_LEAST)) & (r < DETAILED_MOST))


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
        mean[here] += share * mean_texture(texture, seen, texel, changes, bent)
    return mean, texels


def texture_coordinates(texture: MappedTexture, surface: PlacedSurface, camera: Camera, rays: Array, w: Array) -> Array:
    """(right, up) from the lower left corner of the image (n, 2), in images; of a cube map in a row of its six."""
    found = texture.map
    at = mapped_point(surface, found, camera, rays, w).at
    if found.kind == MAP_TRIPLANAR:
        largest = np.argmax(np.abs(own_normal(surface, rays, w)), axis=-1)
        at = np.choose(largest[:, None], [along_axis(at, axis) for axis in range(3)])
    texel = texel_at(found, at)
    u, v = texel.column / found.columns, 1.0 - texel.row / found.rows
    return np.stack([(texel.side + u) / 6.0 if found.kind == MAP_CUBE else u, v], axis=-1)
