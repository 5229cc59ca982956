"""Images with something to remove, after figures 5.16 to 5.20 of the thesis, whose photographs are not available."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.images import read_image
from clsco.inputs.textures import bricks
from clsco.resources import folder

RED, ROPE = (208, 24, 32), (226, 150, 62)
Pair = tuple[NDArray[Any], NDArray[np.bool_]]


@dataclass(frozen=True)
class Removal:
    """An image, and the mask of the pixels to remove: `make` returns both."""

    title: str
    make: Callable[[], Pair]


def _letters() -> Pair:
    """Bricks with red letters over them."""
    from PIL import Image, ImageDraw, ImageFont

    rows, columns = 300, 400
    drawn = Image.new("L", (columns, rows))
    pen = ImageDraw.Draw(drawn)
    for place, words in (((24, 30), "These letters"), ((80, 120), "are not part"), ((36, 210), "of the wall.")):
        pen.text(place, words, 255, ImageFont.load_default(44))
    mask = np.asarray(drawn) >= 128
    image = np.repeat(bricks(rows, columns)[:, :, np.newaxis], 3, axis=2)
    image[mask] = RED
    return image, mask


def _rope() -> Pair:
    """A picture with a rope across it; the mask is a pixel wider than the rope."""
    from PIL import Image, ImageDraw

    image = read_image(_shipped("depth_map_image.png")).data.copy()
    rows, columns = image.shape[:2]
    x = np.arange(-8, columns + 8, 4)
    points = [(int(k), round(0.2 * rows + 0.5 * k + 26.0 * np.sin(k / 42.0))) for k in x]
    found = []
    for width in (5, 9):
        drawn = Image.new("L", (columns, rows))
        ImageDraw.Draw(drawn).line(points, 255, width, joint="curve")
        found.append(np.asarray(drawn) >= 128)
    image[found[0]] = ROPE
    return image, found[1]


def _scratches() -> Pair:
    """A photograph with scratches and text, of which the package has the mask."""
    return read_image(_shipped("damaged.png")).data, read_image(_shipped("damaged_mask.png")).data > 127


def _shipped(name: str) -> Path:
    return Path(str(folder("examples"))) / name


REMOVALS = {
    "red_letters": Removal("Red letters, as in figure 5.16", _letters),
    "rope": Removal("Rope, as in figure 5.19", _rope),
    "scratches": Removal("Scratched photograph", _scratches),
}
"""By name."""
