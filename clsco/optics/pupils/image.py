"""Pupil given by an image: exact areas of its cells by running sums (float64, pure)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.circle import disc_coverage
from clsco.optics.pupils.differences import Asymmetric
from clsco.optics.pupils.pupil import Array

MOST_CELLS = 512  # per side
TURNED_PARTS = 4  # samples per side of a cell, for an image that is rotated
KEPT = 4  # number of pupils whose running sums are cached


@dataclass(frozen=True)
class Image(Asymmetric):
    """Transmission that is constant in each cell of a square around the lens; create it with `image_pupil`.

    count: cells per side; digest: hash of the cells, which identifies pupils in reports and files; data: float32, row
    after row, row 0 on top; squeeze: height over width of the blur.
    """

    count: int
    digest: str
    data: bytes = field(repr=False)
    squeeze: float = 1.0

    has_plain_rim = False

    @property
    def label(self) -> str:
        return f"image of {self.count} x {self.count}"

    @property
    def light(self) -> float:
        return float(self.image.mean()) * 4.0 / (np.pi * self.squeeze)

    @property
    def amplitude(self) -> Image:
        return replace(self, digest=f"root of {self.digest}", data=np.sqrt(self.image).astype(np.float32).tobytes())

    @property
    def image(self) -> Array:
        """Transmission (count, count)."""
        return np.frombuffer(self.data, np.float32).reshape(self.count, self.count).astype(np.float64)

    @property
    def second_moment(self) -> float:
        cells, size = self.image, 2.0 / self.count
        at = (np.arange(self.count) + 0.5) * size - 1.0
        along_x, along_y = (float(cells.sum(axis=k) @ (at * at) / cells.sum()) + size * size / 12.0 for k in (0, 1))
        return 0.5 * (along_x / self.squeeze**2 + along_y)

    def transmission(self, x: Array, y: Array) -> Array:
        places = np.broadcast_arrays(x * self.squeeze, y)
        column, row = (np.floor(0.5 * self.count * (v + 1.0)).astype(np.int64) for v in places)
        inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < self.count)
        return np.where(inside, self.image[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)

    def running_integral(self, radius: Array, x: Array, y: Array, tent: bool) -> Array:
        """Integral for `grid_share`: a polynomial in each cell, plus the sums over all cells left of and above it."""
        scale = 0.5 * self.count / radius  # cells per px, down
        column, across = _cell(0.5 * self.count + x * (scale * self.squeeze), self.count)
        row, down = _cell(0.5 * self.count + y * scale, self.count)
        order = 2 if tent else 1
        sums, integral = _running_sums(self), np.zeros(np.broadcast_shapes(row.shape, column.shape, scale.shape))
        for i, factor_y in enumerate(_powers(down, order)):
            for j, factor_x in enumerate(_powers(across, order)):
                integral += sums[i][j][row, column] * (factor_y * factor_x)
        return np.asarray(integral / (sums[1][1][-1, -1] * (scale * scale * self.squeeze if tent else 1.0)))


def image_pupil(picture: Array, rotation: float = 0.0, squeeze: float = 1.0) -> Image:
    """Pupil from a picture (n, n) whose inscribed circle is the edge of the lens, with a largest transmission of 1.

    picture: transmission, not negative and positive somewhere in the circle, oriented as the blur of a far light, row 0
    on top; n at most MOST_CELLS. rotation: before the squeeze, deg, counter-clockwise.
    """
    picture, count = turned(picture, rotation), len(picture)
    at = np.arange(float(count)) + 0.5 - 0.5 * count
    inside = disc_coverage(at[None, :], at[:, None], np.asarray(0.5 * count), tent=False)
    cells = (picture * inside / (picture * inside).max()).astype(np.float32)
    data = cells.tobytes()
    return Image(count, hashlib.sha256(data).hexdigest()[:16], data, squeeze)


def turned(picture: Array, rotation: float) -> Array:
    """Square picture (n, n) rotated about its middle by `rotation` deg counter-clockwise; exact for right angles, else
    each cell is the mean of TURNED_PARTS^2 samples, dark beyond the picture.
    """
    quarters = rotation / 90.0
    if quarters.is_integer():
        return np.rot90(picture, int(quarters))
    count, angle = len(picture), np.deg2rad(rotation)
    at = (np.arange(float(count * TURNED_PARTS)) + 0.5) / TURNED_PARTS - 0.5 * count
    right = np.cos(angle) * at[None, :] - np.sin(angle) * at[:, None]
    down = np.sin(angle) * at[None, :] + np.cos(angle) * at[:, None]
    row, column = (np.floor(v + 0.5 * count).astype(np.int64) for v in (down, right))
    inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < count)
    values = np.where(inside, picture[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)
    return np.asarray(values.reshape(count, TURNED_PARTS, count, TURNED_PARTS).mean(axis=(1, 3)))


def _cell(at: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    """Cell of a position along an axis, and the distance from its start; cell `count` is empty and has no end."""
    clamped = np.maximum(at, 0.0)
    cell = np.minimum(clamped, count).astype(np.int64)
    return cell, clamped - cell


def _powers(t: Array, order: int) -> Sequence[Array | float]:
    """Integrals of 1 from 0 to t, iterated from `order` times down to zero times."""
    return (0.5 * t * t, t, 1.0) if order == 2 else (t, 1.0)


@lru_cache(maxsize=KEPT)
def _running_sums(pupil: Image) -> list[list[Array]]:
    """Running integrals (n + 1, n + 1) at the upper left corner of each cell; [i][j]: i times down, j times across.

    i and j are 0, 1 or 2; 0 is the value of the cell itself. An empty row and column of cells follow the last ones.
    """
    cells = np.pad(pupil.image, (0, 1))
    down = [cells, *_integrals(cells, axis=0)]
    return [[integral, *_integrals(integral, axis=1)] for integral in down]


def _integrals(cells: Array, axis: int) -> tuple[Array, Array]:
    """First and second integral along an axis at the beginning of each cell."""
    first = np.cumsum(cells, axis=axis) - cells
    means = first + 0.5 * cells
    return first, np.cumsum(means, axis=axis) - means
