"""Pupil given by an image, for what has no closed form: exact areas of its cells by running sums (float64, pure)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.circle import disc_coverage
from clsco.optics.pupils.differences import grid_share, share_at
from clsco.optics.pupils.pupil import Array, Pupil

MOST_CELLS = 512  # a side
KEPT = 4  # pupils, whose sums are kept


@dataclass(frozen=True)
class Image(Pupil):
    """Transmission that is constant in each cell of a square around the lens; made by `image_pupil`.

    Attributes
    ----------
    count : int
        Cells a side.
    digest : str
        Digest of the cells, which tells pupils apart in reports and files.
    data : bytes
        float32, row after row, row 0 on top.
    """

    count: int
    digest: str
    data: bytes = field(repr=False)

    symmetry = "none"

    @property
    def name(self) -> str:
        return f"image of {self.count} x {self.count}"

    @property
    def image(self) -> Array:
        """Transmission (count, count)."""
        return np.frombuffer(self.data, np.float32).reshape(self.count, self.count).astype(np.float64)

    @property
    def second_moment(self) -> float:
        cells, size = self.image, 2.0 / self.count
        at = (np.arange(self.count) + 0.5) * size - 1.0
        along_x, along_y = cells.sum(axis=0) @ (at * at), cells.sum(axis=1) @ (at * at)
        return float(0.5 * (along_x + along_y) / cells.sum() + size * size / 12.0)

    def transmission(self, x: Array, y: Array) -> Array:
        column, row = (np.floor(0.5 * self.count * (v + 1.0)).astype(np.int64) for v in np.broadcast_arrays(x, y))
        inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < self.count)
        return np.where(inside, self.image[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        return share_at(partial(self._share, tent=tent), dx, dy, radius, tent)

    def rows(self, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
        return grid_share(partial(self._running_integral, tent=tent), radii, dx, dy, tent)

    def _share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        turn = np.where(radius < 0.0, -1.0, 1.0)  # a negative radius mirrors the image in its center
        steps = ((-1.0, 1.0), (0.0, -2.0), (1.0, 1.0)) if tent else ((-0.5, -1.0), (0.5, 1.0))
        found = np.zeros(dx.shape)
        for y, factor_y in steps:
            for x, factor_x in steps:
                corner = self._running_integral(np.abs(radius), turn * dx + x, turn * dy + y, tent)
                found += factor_x * factor_y * corner
        beyond = np.maximum(np.abs(dx), np.abs(dy)) >= np.abs(radius) + 1.0  # where there is nothing but rounding
        return np.where(beyond, 0.0, np.maximum(found, 0.0))

    def _running_integral(self, radius: Array, x: Array, y: Array, tent: bool) -> Array:
        """Integral for `grid_share`: a polynomial in each cell, from the sums over all cells left of and above it."""
        scale = 0.5 * self.count / radius  # cells per px
        column, across = _cell(0.5 * self.count + x * scale, self.count)
        row, down = _cell(0.5 * self.count + y * scale, self.count)
        order = 2 if tent else 1
        sums, found = _running_sums(self), np.zeros(np.broadcast_shapes(row.shape, column.shape, scale.shape))
        for i, factor_y in enumerate(_powers(down, order)):
            for j, factor_x in enumerate(_powers(across, order)):
                found += sums[i][j][row, column] * (factor_y * factor_x)
        return np.asarray(found / (sums[1][1][-1, -1] * (scale * scale if tent else 1.0)))


def image_pupil(picture: Array) -> Image:
    """Pupil of a picture, whose inscribed circle is the rim of the lens.

    Parameters
    ----------
    picture : ndarray (n, n)
        Transmission, at least 0 and somewhere in the circle more; row 0 on top. It stands as the blur of a far light
        shows it. n at most MOST_CELLS.

    Returns
    -------
    Image
        Scaled to a largest transmission of 1; what lies outside of the circle is dark.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.pupils.image import image_pupil
    >>> half = np.zeros((64, 64))
    >>> half[:, 32:] = 1.0
    >>> image_pupil(half).name
    'image of 64 x 64'
    """
    count = len(picture)
    at = np.arange(float(count)) + 0.5 - 0.5 * count
    inside = disc_coverage(at[None, :], at[:, None], np.asarray(0.5 * count), tent=False)
    cells = (picture * inside / (picture * inside).max()).astype(np.float32)
    data = cells.tobytes()
    return Image(count, hashlib.sha256(data).hexdigest()[:16], data)


def _cell(at: Array, count: int) -> tuple[NDArray[np.int64], Array]:
    """Cell of a place along an axis, and the place in it; beyond the last cell, where nothing is, any distance."""
    held = np.maximum(at, 0.0)
    cell = np.minimum(held, count).astype(np.int64)
    return cell, held - cell


def _powers(t: Array, order: int) -> Sequence[Array | float]:
    """Integrals of 1 from 0 to t, `order` times to none at all."""
    return (0.5 * t * t, t, 1.0) if order == 2 else (t, 1.0)


@lru_cache(maxsize=KEPT)
def _running_sums(pupil: Image) -> list[list[Array]]:
    """Sums at the upper left corner of each cell and of an empty one after the last, by how often they are integrated
    down (0, 1, 2) and across."""
    cells = np.pad(pupil.image, (0, 1))
    down = [cells, *_integrals(cells, axis=0)]
    return [[each, *_integrals(each, axis=1)] for each in down]


def _integrals(cells: Array, axis: int) -> tuple[Array, Array]:
    """First and second integral along an axis at the beginning of each cell."""
    first = np.cumsum(cells, axis=axis) - cells
    each = first + 0.5 * cells
    return first, np.cumsum(each, axis=axis) - each
