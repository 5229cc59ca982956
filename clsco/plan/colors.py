"""Passes that blur the colors of a frame separately, and join them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from clsco.frame.strips import Grid
from clsco.plan.buffers import SHARED
from clsco.plan.passes import Parameters, Pass

COLORS = ("red", "green", "blue")
JOINED: Parameters = (("colors", "each blurred by itself"),)


def color_passes(passes: Sequence[Iterable[Pass]], grid: Grid) -> Iterator[Pass]:
    """The passes that blur each color separately and copy it to its channel of the joined plane.

    passes: those of red, green and blue, each up to the blurred plane; grid: has the channels of the joined plane.
    """
    sizes = {"colors": 4 * grid.channels * grid.rows * grid.columns}
    for color, (name, steps) in enumerate(zip(COLORS, passes, strict=True)):
        for step in steps:
            buffers = {key if key in SHARED else f"{name} {key}": size for key, size in step.buffers.items()}
            yield replace(step, buffers=buffers, color=color)
        inputs, last = ("plane", "colors") if color else ("plane",), name == COLORS[-1]
        yield Pass("join colors", JOINED, sizes, inputs, ("plane" if last else "colors",), color=color)
