"""Mipmaps: an image and its copies at half, a quarter ... of its size, for filters of large footprints (pure)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clsco.constants import CUBE_BORDER
from clsco.inputs.resampling import resample_rows

Floats = NDArray[np.float32]
# For the sides of a cube in the order right, left, top, bottom, back, front: axis that points out of it with its sign,
# and what runs right and up on it as seen from outside, in a frame whose third axis points to the camera.
SIDES = (
    ((0, 1), (2, -1), (1, 1)),
    ((0, -1), (2, 1), (1, 1)),
    ((1, 1), (0, 1), (2, -1)),
    ((1, -1), (0, 1), (2, 1)),
    ((2, -1), (0, -1), (1, 1)),
    ((2, 1), (0, 1), (1, 1)),
)


def level_sizes(columns: int, rows: int) -> list[tuple[int, int]]:
    """Columns and rows of every level: each half of the one before, rounded up, down to one texel."""
    sizes = [(columns, rows)]
    while max(sizes[-1]) > 1:
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    return sizes


def mipmap_floats(columns: int, rows: int, channels: int, sides: int) -> int:
    """Floats of a mipmap of so many sides (1, or 6 of a cube map)."""
    border = 2 * CUBE_BORDER if sides > 1 else 0
    return sides * channels * sum((width + border) * (height + border) for width, height in level_sizes(columns, rows))


def mipmap(images: Sequence[Floats]) -> list[Floats]:
    """All levels of an image, or of the six of a cube map.

    Parameters
    ----------
    images : sequence of ndarray of float32, (rows, columns, channels)
        One, or six of one size in the order of `SIDES`.

    Returns
    -------
    list of ndarray of float32, (sides, rows, columns, channels)
        Each level is the one before without what its texels cannot hold, by a cubic as wide as two of them: of no
        second moment, so that what is interpolated between texels is no wider than the image. Around the sides of a
        cube map are CUBE_BORDER texels of their neighbors.
    """
    levels = [np.stack(images)]
    for columns, rows in level_sizes(images[0].shape[1], images[0].shape[0])[1:]:
        levels.append(_shrunk(_shrunk(levels[-1], rows, 1), columns, 2))
    return levels if len(images) == 1 else [bordered(level) for level in levels]


def _shrunk(images: Floats, size: int, axis: int) -> Floats:
    """Images (sides, rows, columns, channels) with `size` rows or columns, of which they have up to twice as many."""
    if images.shape[axis] == size:
        return images
    rows = np.moveaxis(images, axis, 0).astype(np.float64)
    return np.moveaxis(resample_rows(rows, size, np.arange(size)).astype(np.float32), 0, axis)


def side_point(side: int, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (..., 3) at coordinates from -1 to 1, right and up, on a side of a cube; beyond that on its plane."""
    (out, sign), (right, right_sign), (up, up_sign) = SIDES[side]
    points = np.empty((*np.shape(x), 3))
    points[..., out], points[..., right], points[..., up] = sign, right_sign * x, up_sign * y
    return points


def cube_side(q: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Side of a cube that directions (..., 3) meet, and the coordinates there; of equally near ones the first axis."""
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
    """The sides of a cube map (6, rows, columns, channels) with what is next to them, CUBE_BORDER texels wide."""
    _, rows, columns, channels = sides.shape
    i, j = (np.arange(-CUBE_BORDER, n + CUBE_BORDER) for n in (rows, columns))
    found = np.empty((6, i.size, j.size, channels), np.float32)
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
        found[side] = total
        inside = slice(CUBE_BORDER, -CUBE_BORDER)
        found[side, inside, inside] = sides[side]
    return found
