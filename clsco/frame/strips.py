"""Frames in horizontal strips: frames of any size in limited memory, with the same bits as in one piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Strip:
    """A strip of a frame: its first row, its number of rows, and the rows of its source grid above and below it."""

    top: int
    rows: int
    above: int
    below: int

    @property
    def height(self) -> int:
        """Rows of the source grid."""
        return self.above + self.rows + self.below

    @property
    def inside(self) -> slice:
        """Rows of the frame, as a slice."""
        return slice(self.top, self.top + self.rows)


def cut_strips(rows: int, tallest: int, guard: int, reach: int, step: int = 1) -> tuple[Strip, ...]:
    """Cut a frame of `rows` rows into strips; the first has the most rows, `tallest`, a multiple of BAND or `rows`.

    guard: rows of the guard band above and below the frame; reach: largest distance in rows at which a source may
    contribute to a pixel; step: source grids begin at multiples of this many rows.
    """
    tops = range(0, rows, tallest)
    return tuple(make_strip(rows, top, min(top + tallest, rows), guard, reach, step) for top in tops)


def make_strip(rows: int, top: int, end: int, guard: int, reach: int, step: int = 1) -> Strip:
    """The strip from row `top` to before row `end`. Its pixels have the same bits as in the whole frame if both are
    multiples of BAND, or `end` is `rows`.
    """
    above, below = (min(max(guard, reach), left + guard) for left in (top, rows - end))
    return Strip(top, end - top, above + (top + guard - above) % step, below)


def with_apron(
    plane: NDArray[Any], strip: Strip, guard: int, outside: Literal["symmetric", "constant"] = "symmetric"
) -> NDArray[Any]:
    """The part of an image (rows, columns[, channels]) on the source grid of a strip, (height, width[, channels]).

    guard: px of the apron beyond the image's border. The apron holds the mirror image, or 0 with outside = "constant".
    """
    begin, end = strip.top - strip.above, strip.top + strip.rows + strip.below
    first, last = max(begin, 0), min(end, len(plane))
    widths = [(first - begin, end - last), (guard, guard), (0, 0)][: plane.ndim]
    return np.pad(plane[first:last], widths, mode=outside) if guard else plane[first:last]


@dataclass(frozen=True)
class Grid:
    """Sizes in px for which buffers are allocated: a frame or its tallest strip, with the apron of its source grid."""

    rows: int
    columns: int
    guard: int
    channels: int
    height: int  # rows of the tallest source grid

    @classmethod
    def of(cls, strips: Sequence[Strip], columns: int, guard: int, channels: int) -> Self:
        """Sizes for the strips of a frame, the first of which is the tallest."""
        return cls(strips[0].rows, columns, guard, channels, max(strip.height for strip in strips))

    @classmethod
    def whole(cls, rows: int, columns: int, guard: int, channels: int) -> Self:
        """Sizes for a frame rendered in one piece."""
        return cls(rows, columns, guard, channels, rows + 2 * guard)

    @property
    def width(self) -> int:
        """Columns of the source grid."""
        return self.columns + 2 * self.guard

    @property
    def sources(self) -> int:
        """Pixels of the source grid."""
        return self.width * self.height
