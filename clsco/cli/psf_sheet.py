"""The picture of `clsco psf`: point spread functions side by side from near to far."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clsco.files.images import write_png
from clsco.reference.spreads import PsfStack

CELL, GAP, LINE, LEFT, MOST_ACROSS = 120, 10, 17, 110, 16
GROUND, TEXT, QUIET, EMPTY = (250, 250, 248), (20, 20, 20), (110, 110, 110), (12, 12, 16)
SIZE = 13


def sheet(stack: PsfStack) -> NDArray[np.uint8]:
    """Draw a stack: a row for each channel and place, and a column for each depth; returns (rows, columns, 3).

    Each is as bright as its largest weight, which is written below. All have the same scale.
    """
    channels, places, depths, side, _ = stack.weights.shape
    across = min(depths, MOST_ACROSS)
    lines = -(-depths // across)
    row_high = CELL + 2 * LINE + GAP
    width, high = LEFT + across * (CELL + GAP) + GAP, 2 * LINE + GAP + channels * places * lines * row_high
    picture = Image.new("RGB", (width, high + GAP), GROUND)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(SIZE)
    title = f"{stack.name}; {side} x {side} px; each as bright as its largest weight, w"
    draw.text((GAP, GAP), title, fill=TEXT, font=font)
    for row in range(channels * places * lines):
        (channel, place), line = divmod(row // lines, places), row % lines
        top = 2 * LINE + GAP + row * row_high
        x, y = stack.at[place]
        labels = ([] if channels == 1 else [stack.channels[channel]]) + [f"at {x:g}, {y:g}"]
        for number, label in enumerate(labels):
            draw.text((GAP, top + number * LINE), label, fill=TEXT, font=font)
        for column, depth in enumerate(range(depths)[line * across : (line + 1) * across]):
            weights = stack.weights[channel, place, depth]
            left = LEFT + column * (CELL + GAP)
            picture.paste(_cell(weights), (left, top))
            about = f"Z {stack.depth[depth]:.5g} mm" if np.isfinite(stack.depth[depth]) else "Z infinite"
            draw.text((left, top + CELL + 1), about, fill=TEXT, font=font)
            radius = f"R {stack.radius[channel, place, depth]:+.3g}, w {weights.max():.2g}"
            draw.text((left, top + CELL + LINE), radius, fill=QUIET, font=font)
    return np.asarray(picture)


def _cell(weights: NDArray[np.float32]) -> Image.Image:
    """A point spread function as a picture of CELL px a side, its pixels as several whole ones if there is room."""
    shown = np.round(255.0 * np.clip(weights / max(float(weights.max()), 1e-30), 0.0, 1.0)).astype(np.uint8)
    side = shown.shape[0]
    if side > CELL:  # the largest weight of each pixel of the picture, so that points are seen
        first = np.arange(CELL) * side // CELL
        shown = np.maximum.reduceat(np.maximum.reduceat(shown, first, axis=0), first, axis=1)
    times = CELL // shown.shape[0]
    grown = Image.fromarray(shown).resize((times * shown.shape[1],) * 2, Image.Resampling.NEAREST)
    cell = Image.new("RGB", (CELL, CELL), EMPTY)
    cell.paste(grown, ((CELL - grown.width) // 2, (CELL - grown.height) // 2))
    return cell


def write_sheet(path: Path, stack: PsfStack) -> None:
    """Write `sheet` as a PNG. Raises FileError where it cannot be written."""
    write_png(path, sheet(stack))
