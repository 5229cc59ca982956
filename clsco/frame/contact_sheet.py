"""Contact sheets: labeled pictures side by side in one picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clsco.frame.views import Picture

GAP = 8  # px around each picture
PAPER, INK = (250, 250, 248), (20, 20, 20)


def contact_sheet(
    rows: Sequence[Sequence[tuple[Picture, str]]], title: str = "", text: int = 12, lines: int = 1
) -> Picture:
    """Draw rows of pictures (rows, columns, 3), each with a label below it; all columns have the width of the widest.

    text: height of the text, px; lines: number of lines of a label.
    """
    from PIL import Image, ImageDraw, ImageFont

    line = 3 * text // 2
    width = max((tile.shape[1] for row in rows for tile, _ in row), default=1)
    heights = [max((len(tile) for tile, _ in row), default=1) for row in rows]
    top = GAP + (line if title else 0)
    across = max(map(len, rows), default=1)
    below = lines * line
    size = (GAP + across * (width + GAP), top + sum(height + below + GAP for height in heights))
    sheet = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(text)
    draw.text((GAP, GAP // 2), title, fill=INK, font=font)
    for row, height in zip(rows, heights, strict=True):
        for column, (tile, label) in enumerate(row):
            x = GAP + column * (width + GAP)
            sheet.paste(Image.fromarray(tile), (x, top))
            draw.text((x, top + height + 2), label, fill=INK, font=font)
        top += height + below + GAP
    return np.asarray(sheet)


def split_into_rows(tiles: Sequence[tuple[Picture, str]], across: int = 4) -> list[Sequence[tuple[Picture, str]]]:
    """Split pictures and labels into rows of `across`; the last row may be shorter."""
    return [tiles[start : start + across] for start in range(0, len(tiles), across)]
