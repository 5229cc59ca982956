"""Mipmaps: an image at full, half, a quarter ... of its size, for filters with large footprints (pure)."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

from clsco.constants import CUBE_BORDER
from clsco.inputs.resampling import resample_rows

Floats = NDArray[np.float32]
# Sides of a cube, in the order right, left, top, bottom, back, front. Each has three directions as (axis, sign): out of
# the cube, and, as seen from outside, right and up. Axes 0, 1, 2: right, up, towards the camera.
SIDES = (
    ((0, 1), (2, -1), (1, 1)),
    ((0, -1), (2, 1), (1, 1)),
    ((1, 1), (0, 1), (2, -1)),
    ((1, -1), (0, 1), (2, 1)),
    ((2, -1), (0, -1), (1, 1)),
    ((2, 1), (0, 1), (1, 1)),
)


def level_sizes(columns: int, rows: int) -> list[tuple[int, int]]:
    """Columns and rows of every level, down to one texel: each level has half the size of the previous, rounded up."""
    sizes = [(columns, rows)]
    while max(sizes[-1]) > 1:
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    return sizes


def mipmap_floats(columns: int, rows: int, channels: int, sides: int) -> int:
    """Number of floats in a mipmap; sides: 1, or 6 for a cube map."""
    border = 2 * CUBE_BORDER if sides > 1 else 0
    return sides * channels * sum((width + border) * (height + border) for width, height in level_sizes(columns, rows))


def mipmap(images: Sequence[Floats], out: Floats | None = None) -> list[Floats]:
    """All levels of one image (rows, columns, channels), or of the six images of a cube map in the order of `SIDES`.

    out: array of `mipmap_floats` floats to which the levels are written in order. Returns the levels, each (sides,
    rows, columns, channels). Each level is the previous one after a low-pass filter, a cubic two texels wide. Its
    second moment is 0, so that interpolation between texels does not widen the image. Sides of a cube have borders of
    CUBE_BORDER texels from their neighbors.
    """
    rows, columns, channels = images[0].shape
    if out is None:
        out = np.empty(mipmap_floats(columns, rows, channels, len(images)), np.float32)
    levels, border, begin = list[Floats](), 2 * CUBE_BORDER * (len(images) > 1), 0
    whole: Floats = np.empty(0, np.float32)
    for width, height in level_sizes(columns, rows):
        shape = (len(images), height + border, width + border, channels)
        level = out[begin : begin + prod(shape)].reshape(shape)
        begin += level.size
        last, whole = whole, np.empty((len(images), height, width, channels), np.float32) if border else level
        for side, image in enumerate(images):
            whole[side] = _shrunk(_shrunk(last[side], height, 0), width, 1) if levels else image
        if border:
            level[...] = bordered(whole)
        levels.append(level)
    return levels


def _shrunk(image: Floats, size: int, axis: int) -> Floats:
    """Reduce an image (rows, columns, channels) to `size` rows or columns, at least half as many as it has."""
    if image.shape[axis] == size:
        return image
    if axis == 1:
        return _turned(_shrunk(_turned(image), size, 0))
    return resample_rows(image, size, np.arange(size)).astype(np.float32)


def _turned(image: Floats) -> Floats:
    """An image with its rows and columns exchanged; copying whole texels is faster than copying their numbers."""
    texels = np.ascontiguousarray(image).view(f"V{image[0, 0].nbytes}")
    return np.ascontiguousarray(np.swapaxes(texels, 0, 1)).view(np.float32)


def side_point(side: int, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (..., 3) in the plane of a cube's side at coordinates x (right) and y (up), -1 to 1 on the side."""
    (out, sign), (right, right_sign), (up, up_sign) = SIDES[side]
    points = np.empty((*np.shape(x), 3))
    points[..., out], points[..., right], points[..., up] = sign, right_sign * x, up_sign * y
    return points


def cube_side(q: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Sides of a cube that directions (..., 3) point to, and coordinates on these sides; ties go to the first axis."""
    axis = np.argmax(np.abs(q), axis=-1)
    size = np.take_along_axis(q, axis[..., None], -1)[..., 0]
    # Right, top and front are the positive ends of the axes.
    side = np.where(axis < 2, 2 * axis + (size < 0), 5 - (size < 0))
    x, y = np.zeros(size.shape), np.zeros(size.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        for number, (_, (right, right_sign), (up, up_sign)) in enumerate(SIDES):
            here = side == number
            x = np.where(here, right_sign * q[..., right] / np.abs(size), x)
            y = np.where(here, up_sign * q[..., up] / np.abs(size), y)
    return side, x, y


def bordered(sides: Floats) -> Floats:
    """The sides of a cube map (6, rows, columns, channels), each extended by CUBE_BORDER texels of its neighbors."""
    _, rows, columns, channels = sides.shape
    i, j = (np.arange(-CUBE_BORDER, n + CUBE_BORDER) for n in (rows, columns))
    wider = np.empty((6, i.size, j.size, channels), np.float32)
    x, y = np.meshgrid((2 * j + 1) / columns - 1, 1 - (2 * i + 1) / rows)
    for side in range(6):
        number, right, up = cube_side(side_point(side, x, y))
        column, row = 0.5 * (right + 1) * columns - 0.5, 0.5 * (1 - up) * rows - 0.5
        left, top = np.floor(column), np.floor(row)
        total = np.zeros((*x.shape, channels))
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = np.abs(1 - a - (row - top)) * np.abs(1 - b - (column - left))
            at = (np.clip(top + a, 0, rows - 1).astype(np.intp), np.clip(left + b, 0, columns - 1).astype(np.intp))
            total += weight[..., None] * sides[number, at[0], at[1]]
        wider[side] = total
        inside = slice(CUBE_BORDER, -CUBE_BORDER)
        wider[side, inside, inside] = sides[side]
    return wider
