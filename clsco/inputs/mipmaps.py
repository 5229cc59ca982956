"""Mipmaps: an image at full, half, a quarter ... of its size, for filters with large footprints (pure)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

from clsco.constants import CUBE_BORDER
from clsco.inputs.resampling import AT_A_TIME, resample_rows

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
    if image.shape[axis] == 2 * size:
        return (_half_as_high if axis == 0 else _half_as_wide)(np.ascontiguousarray(image))
    rows = np.swapaxes(image, axis, 0).astype(np.float64)
    return np.swapaxes(resample_rows(rows, size, np.arange(size)).astype(np.float32), 0, axis)


# Weights of the cubic of `resample_rows` for halving an image: symmetric, and the same for all texels.
_DISTANCES = np.array([0.25, 0.75, 1.25, 1.75])
_TAPS = np.where(
    _DISTANCES < 1,
    (1.5 * _DISTANCES - 2.5) * _DISTANCES**2 + 1,
    ((2.5 - 0.5 * _DISTANCES) * _DISTANCES - 4) * _DISTANCES + 2,
)
_TAPS /= 2 * _TAPS.sum()


def _half_as_high(image: Floats) -> Floats:
    rows, width = image.shape[0] // 2, image[0].size
    flat, halved = image.reshape(2 * rows, width), np.empty((rows, width), np.float32)
    for begin, end in _parts(rows, width):
        taps = flat[np.clip(np.arange(2 * begin - 3, 2 * end + 3), 0, 2 * rows - 1)].astype(np.float64)
        halved[begin:end] = _halved([taps[k : k + 2 * (end - begin) - 1 : 2] for k in range(8)])
    return halved.reshape(rows, *image.shape[1:])


def _half_as_wide(image: Floats) -> Floats:
    rows, columns, channels = image.shape
    texels = image.reshape(rows, -1).view(f"V{image[0, 0].nbytes}")
    sources = np.clip(np.arange(-3, columns + 3), 0, columns - 1)
    halved = np.empty((rows, columns // 2 * channels), np.float32)
    for begin, end in _parts(rows, halved.shape[1]):
        # Even and odd texels in separate arrays, so that taps are slices.
        parts = (np.take(texels[begin:end], sources[k::2], axis=1) for k in (0, 1))
        halves = [part.view(np.float32).astype(np.float64) for part in parts]
        starts = (channels * (k // 2) for k in range(8))
        halved[begin:end] = _halved([halves[k % 2][:, at : at + halved.shape[1]] for k, at in enumerate(starts)])
    return halved.reshape(rows, columns // 2, channels)


def _parts(rows: int, width: int) -> Iterator[tuple[int, int]]:
    """Split rows of a given width into parts that fit the processor's cache."""
    step = max(1, AT_A_TIME // width)
    return ((begin, min(begin + step, rows)) for begin in range(0, rows, step))


def _halved(taps: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Weighted sum of eight taps."""
    total = np.zeros_like(taps[0])
    for k in (3, 2, 1, 0):
        total += _TAPS[3 - k] * (taps[k] + taps[7 - k])
    return total


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
