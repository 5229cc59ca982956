"""Contact sheets: small pictures side by side with labels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from clsco.frame.views import Picture

if TYPE_CHECKING:
    from clsco.data.record import Record

TILE = 200  # px, the longer side of a picture
GAP, LINE, ACROSS = 8, 18, 4
PAPER, INK = (250, 250, 248), (20, 20, 20)


def contact_sheet(tiles: Sequence[tuple[Picture, str]]) -> Picture:
    """Pictures (rows, columns, 3) with a label below each, as one."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = (max((tile.shape[axis] for tile, _ in tiles), default=1) for axis in (0, 1))
    rows = -(-len(tiles) // ACROSS)
    sheet = Image.new("RGB", (GAP + ACROSS * (width + GAP), GAP + rows * (height + LINE + GAP)), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for number, (tile, label) in enumerate(tiles):
        x, y = GAP + number % ACROSS * (width + GAP), GAP + number // ACROSS * (height + LINE + GAP)
        sheet.paste(Image.fromarray(tile), (x, y))
        draw.text((x, y + height + 2), label, fill=INK, font=font)
    return np.asarray(sheet)


def shrunk(codes: Picture) -> Picture:
    """A picture of at most TILE px a side, by its nearest pixels."""
    rows, columns = codes.shape[:2]
    scale = min(1.0, TILE / max(columns, rows))
    small = (max(1, round(rows * scale)), max(1, round(columns * scale)))
    row, column = ((np.arange(n) * m) // n for n, m in zip(small, (rows, columns), strict=True))
    return codes[row][:, column]


def record_sheet(records: Iterable[Record]) -> Picture:
    """Pictures of the images of samples: the first two of each, side by side."""
    tiles = []
    for record in records:
        names = list(record.pictures())[:2]
        pictures = [shrunk(record.image(name)) for name in names] or [np.full((TILE // 2, TILE // 2, 3), 128, np.uint8)]
        height = max(len(picture) for picture in pictures)
        padded = [np.pad(each, ((0, height - len(each)), (0, 0), (0, 0))) for each in pictures]
        label = " ".join(filter(None, (record.key, str(record.meta.get("split") or ""))))
        tiles.append((np.concatenate(padded, axis=1), label))
    return contact_sheet(tiles)
