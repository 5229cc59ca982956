"""The picture of `clsco psf`: point spread functions side by side, from near to far."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clsco.frame.contact_sheet import contact_sheet, split_into_rows
from clsco.reference.spreads import PsfStack

CELL, MOST_ACROSS = 144, 14
EMPTY = (12, 12, 16)


def sheet(stack: PsfStack) -> NDArray[np.uint8]:
    """Draw a stack with a row for each channel and place, and a column for each depth, all of the same scale in px."""
    channels, places, depths, side, _ = stack.weights.shape
    rows = []
    for channel, place in np.ndindex(channels, places):
        x, y = stack.at[place]
        where = f" at {x:g}, {y:g}" if places > 1 else ""
        tiles = []
        for depth in range(depths):
            weights, radius = stack.weights[channel, place, depth], stack.radius[channel, place, depth]
            distance = f"{stack.depth[depth]:.5g} mm" if np.isfinite(stack.depth[depth]) else "infinite"
            label = f"Z {distance}, R {radius:+.3g}{f', {stack.channels[channel]}' if channels > 1 else ''}{where}"
            tiles.append((_cell(weights), f"{label}\nw {weights.max():.2g}"))
        rows += split_into_rows(tiles, MOST_ACROSS)
    return contact_sheet(rows, f"{stack.name}; {side} x {side} px; each as bright as its largest weight, w", lines=2)


def _cell(weights: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A point spread function as a picture of CELL px a side, enlarged by a whole factor if there is room."""
    shown = np.round(255.0 * np.clip(weights / max(float(weights.max()), 1e-30), 0.0, 1.0)).astype(np.uint8)
    side = shown.shape[0]
    if side > CELL:  # the largest weight of each pixel of the picture, so that points are seen
        first = np.arange(CELL) * side // CELL
        shown = np.maximum.reduceat(np.maximum.reduceat(shown, first, axis=0), first, axis=1)
    times = CELL // shown.shape[0]
    grown = Image.fromarray(np.kron(shown, np.ones((times, times), np.uint8)))
    cell = Image.new("RGB", (CELL, CELL), EMPTY)
    cell.paste(grown, ((CELL - grown.width) // 2, (CELL - grown.height) // 2))
    return np.asarray(cell)
