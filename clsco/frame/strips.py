"""Frames in horizontal strips: any size in bounded memory, with the bits of the whole frame."""

from __future__ import annotations

from dataclasses import dataclass

from clsco.records import Real, Struct, filled

# Rows that a work-item of `gather` owns: bands for several cores, and little overlap. It walks the sources that reach
# them in an order that counts from its first row, so strips of whole bands come out as they do in the whole frame.
BAND = 64


@dataclass(frozen=True)
class Strip:
    """`rows` rows of a frame from row `top` on, with as many `above` and `below` on the grid of their sources."""

    top: int
    rows: int
    above: int
    below: int

    @property
    def height(self) -> int:
        """Rows of the grid."""
        return self.above + self.rows + self.below

    @property
    def inside(self) -> slice:
        """Rows of the frame."""
        return slice(self.top, self.top + self.rows)


def cut(rows: int, tallest: int, guard: int, reach: int, step: int = 1) -> tuple[Strip, ...]:
    """Strips of at most `tallest` rows of a frame of `rows`; the first one is the tallest.

    tallest: a multiple of BAND, or all rows. guard: rows of sources before the first and after the last row of the
    frame; reach: so many rows away a source may matter; step: grids begin so many rows apart, or a multiple of it.
    """
    found = []
    for top in range(0, rows, tallest):
        end = min(top + tallest, rows)
        above, below = (min(max(guard, reach), left + guard) for left in (top, rows - end))
        found.append(Strip(top, end - top, above + (top + guard - above) % step, below))
    return tuple(found)


def frame_struct(
    rows: int, columns: int, guard: int, real: Real, strip: Strip | None = None, **optics: float
) -> Struct:
    """camera_t of a frame of rows x columns px in a guard band of `guard` px, with what of the lens is needed.

    strip: which of its rows, by default all of them.
    """
    part = strip or Strip(0, rows, guard, guard)
    size = {"rows": part.rows, "columns": columns, "frame_rows": rows, "top": part.top, "guard": guard}
    size |= {"above": part.above, "width": columns + 2 * guard, "height": part.height}
    return filled("camera_t", real, size | optics)
