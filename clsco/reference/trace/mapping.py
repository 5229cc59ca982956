"""Positions of surface points in their texture images, in NumPy float64.

Coordinates are those of `clsco.optics.texture_mapping`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.constants import MAP_CONE, MAP_CUBE, MAP_CYLINDER, MAP_LONGITUDE, MAP_TRIPLANAR, WRAP_MIRROR, WRAP_REPEAT
from clsco.inputs.mipmaps import SIDES, cube_side, mipmap
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.rays import ray_changes
from clsco.optics.texture_mapping import TextureMap, detail_least, texture_spread
from clsco.reference.common.geometry import Array, Filter, canonical_gradient, surface_normal, turned
from clsco.scene.model import Camera

BENT = 256.0  # squared distance from a pole, in pixels, within which coordinates are far from linear
FARTHEST_TEXEL = 1e6  # positions are clamped to this
TINY = 1e-12
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MappedTexture:
    """An image on a surface.

    levels: levels of the image's mipmap, (sides, rows, columns, channels) float64; map: mapping to the surface; spread:
    from `texture_spread`, px; least: from `detail_least`, px; texture_filter: interpolation between texels.
    """

    levels: tuple[Array, ...]
    map: TextureMap
    spread: float
    least: float
    texture_filter: Filter


def mapped_texture(
    images: Sequence[NDArray[np.float32]], texture_map: TextureMap, psf: PointSpread, texture_filter: Filter
) -> MappedTexture:
    """A `MappedTexture` from images (rows, columns, channels): a single image, or the six of a cube map."""
    levels = tuple(level.astype(np.float64) for level in mipmap(images))
    return MappedTexture(levels, texture_map, texture_spread(psf), detail_least(psf), texture_filter)


@dataclass(frozen=True, eq=False)
class Mapped:
    """Positions q (n, 3) of hits in the frame of a texture, and derivatives of q per pixel to the right and down."""

    at: Array
    right: Array
    down: Array


@dataclass(frozen=True, eq=False)
class Texel:
    """Column and row (n,) in texels, with texel edges at integers, and the side of a cube map."""

    column: Array
    row: Array
    side: Indices


def mapped_point(surface: PlacedSurface, texture_map: TextureMap, camera: Camera, rays: Array, w: Array) -> Mapped:
    """Points on rays (n, 3) at inverse depths w (n,) in 1/mm, in the frame of a texture."""
    d = turned(surface.turn, rays)
    gradient = canonical_gradient(surface, d, w)
    n, facing = turned(surface.turn.T, gradient), (gradient * d).sum(axis=-1)
    scale = np.where(facing != 0.0, -1.0 / np.where(facing != 0.0, facing, 1.0), 0.0)
    changes = [np.eye(3)[axis] + rays * (n[..., axis] * scale)[..., None] for axis in range(2)]
    along, aside, upwards = ray_changes(camera, rays[..., 0], rays[..., 1])
    steps = []
    for sign, shares in ((1.0, (along, aside)), (-1.0, (aside, upwards))):
        change = sum(c * (sign * share / w)[..., None] for c, share in zip(changes, shares, strict=True))
        steps.append(turned(texture_map.frame, turned(surface.own_turn, change)))
    own_points = surface.own_offset + turned(surface.own_turn, rays) / w[..., None]
    return Mapped(turned(texture_map.frame, own_points), *steps)


def on_side(q: Array, side: Indices) -> Array:
    """Vectors (n, 3) in the axes right, up and out of the cube sides `side` (n,)."""
    axes, signs = np.moveaxis(np.array(SIDES)[:, [1, 2, 0]], -1, 0)  # SIDES: out, right, up
    return np.asarray(np.take_along_axis(q, axes[side], -1) * signs[side])


def texels_of(texture_map: TextureMap, x: Array, y: Array) -> tuple[Array, Array]:
    """Columns and rows in texels from coordinates, or their changes from changes of coordinates."""
    (a, b), (c, d) = texture_map.scale
    return a * x + b * y, c * x + d * y


def wrapped_position(position: Array, count: int, wrap: int) -> Array:
    """Positions reduced to one period for repeating textures; all positions are clamped to FARTHEST_TEXEL."""
    if wrap in (WRAP_REPEAT, WRAP_MIRROR):
        period = 2.0 * count if wrap == WRAP_MIRROR else float(count)
        position = position - period * np.floor(position / period)
    return np.maximum(np.fmin(position, FARTHEST_TEXEL), -FARTHEST_TEXEL)


def texel_at(texture_map: TextureMap, q: Array) -> Texel:
    """Texel coordinates at q (n, 3), before any wrapping."""
    x, y, side = q[..., 0], q[..., 1], np.zeros(q.shape[:-1], np.intp)
    angle = np.arctan2(x, q[..., 2])
    if texture_map.kind == MAP_CYLINDER:
        x = angle
    elif texture_map.kind == MAP_LONGITUDE:
        x, y = angle, np.arctan2(y, np.hypot(x, q[..., 2]))
    elif texture_map.kind == MAP_CONE:
        length = np.sqrt((q * q).sum(axis=-1))
        x, y = length * np.sin(texture_map.slant * angle), length * np.cos(texture_map.slant * angle)
    elif texture_map.kind == MAP_CUBE:
        side = cube_side(q)[0]
        right, up, out = np.moveaxis(on_side(q, side), -1, 0)
        x, y = right / out, up / out
    column, row = texels_of(texture_map, x, y)
    return Texel(column + texture_map.shift[0], row + texture_map.shift[1], side)


def texel_change(texture_map: TextureMap, q: Array, dq: Array) -> tuple[Array, Array]:
    """Change of column and row for a change dq of q, (n, 3)."""
    x, y = dq[..., 0], dq[..., 1]
    if texture_map.kind in (MAP_CYLINDER, MAP_LONGITUDE, MAP_CONE):
        least = np.maximum(TINY * (q * q).sum(axis=-1), 1e-30)
        square = np.maximum(q[..., 0] ** 2 + q[..., 2] ** 2, least)  # from the axis
        x = (q[..., 2] * dq[..., 0] - q[..., 0] * dq[..., 2]) / square
        if texture_map.kind == MAP_LONGITUDE:
            radius = np.sqrt(square)
            out = (q[..., 0] * dq[..., 0] + q[..., 2] * dq[..., 2]) / radius
            y = (radius * dq[..., 1] - q[..., 1] * out) / (square + q[..., 1] ** 2)
        if texture_map.kind == MAP_CONE:
            length = np.sqrt(square + q[..., 1] ** 2)
            out = np.where(length > 0.0, (q * dq).sum(axis=-1) / np.where(length > 0.0, length, 1.0), 0.0)
            around = length * x * texture_map.slant
            angle = texture_map.slant * np.arctan2(q[..., 0], q[..., 2])
            x = out * np.sin(angle) + around * np.cos(angle)
            y = out * np.cos(angle) - around * np.sin(angle)
    if texture_map.kind == MAP_CUBE:
        on, d = (on_side(vectors, cube_side(q)[0]) for vectors in (q, dq))
        x, y = ((d[..., k] * on[..., 2] - on[..., k] * d[..., 2]) / on[..., 2] ** 2 for k in (0, 1))
    return texels_of(texture_map, x, y)


def is_bent(texture_map: TextureMap, point: Mapped) -> NDArray[np.bool_]:
    """Mask of pixels (n,) in whose footprints coordinates are far from linear."""
    q, right, down = point.at, point.right, point.down
    if texture_map.kind in (MAP_LONGITUDE, MAP_CONE):
        least = (q[..., 0] ** 2 + q[..., 2] ** 2) / BENT
        return np.asarray((least < (right * right).sum(axis=-1)) | (least < (down * down).sum(axis=-1)))
    if texture_map.kind == MAP_CUBE:
        side, corners = cube_side(q)[0], [q + a * right + b * down for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
        return np.any([cube_side(corner)[0] != side for corner in corners], axis=0)
    return np.zeros(q.shape[:-1], dtype=bool)


def blend_shares(normal: Array) -> Array:
    """Blending weights (n, 3) of the three images of a triplanar mapping, for unit normals (n, 3)."""
    above = np.maximum(normal**2 - 0.1, 0.0) ** 2
    return np.asarray(above / above.sum(axis=-1, keepdims=True))


def own_normal(surface: PlacedSurface, rays: Array, w: Array) -> Array:
    """Unit normals (n, 3) of hits in the object's own frame."""
    return turned(surface.own_turn, surface_normal(surface, rays, w))


def along_axis(q: Array, axis: int) -> Array:
    """Points or changes (n, 3) projected along an axis."""
    return np.asarray(q[..., ((2, 1, 0), (0, 2, 1), (0, 1, 2))[axis]])


def texture_coordinates(surface: PlacedSurface, texture: MappedTexture, camera: Camera, rays: Array, w: Array) -> Array:
    """Texture coordinates (n, 2), right and up from the lower left corner, in units of the image's size.

    For a cube map, "the image" is the row of its six images.
    """
    texture_map = texture.map
    at = mapped_point(surface, texture_map, camera, rays, w).at
    if texture_map.kind == MAP_TRIPLANAR:
        largest = np.argmax(np.abs(own_normal(surface, rays, w)), axis=-1)
        at = np.choose(largest[:, None], [along_axis(at, axis) for axis in range(3)])
    texel = texel_at(texture_map, at)
    u, v = texel.column / texture_map.columns, 1.0 - texel.row / texture_map.rows
    return np.stack([(texel.side + u) / 6.0 if texture_map.kind == MAP_CUBE else u, v], axis=-1)
