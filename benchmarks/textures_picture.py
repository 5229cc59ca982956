"""docs/textures.png, how textures lie on surfaces: python -m benchmarks.textures_picture [-o FILE]"""

from __future__ import annotations

import argparse
import colorsys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import clsco
from clsco.frame.contact_sheet import contact_sheet, split_into_rows
from clsco.frame.notebook import codes_to_show
from clsco.frame.views import Picture

SIDE, CELL = 240, 64  # px
CAMERA = {"resolution": [SIDE, SIDE], "pixel_pitch": 5.12 / SIDE, "f_number": 4.0, "focus_distance": 265.0}
LIGHT = {"direction": [-0.7, 0.9, 1.0], "ambient": 0.3}
LAID = {"texture_mapping": "surface"}
BACK_DOWN = {"quaternion": [0.0, 0.0, 0.54, 0.84]}  # what is away from the camera turned down, what is up to the front
TILTED = [-25.0, -25.0, 0.0]  # seen from above, before and left of it
BEHIND = [-25.0, 155.0, 0.0]  # from below, behind and right of it
LETTERS = {"texture": "F", "texture_back": "B", "texture_left": "L", "texture_right": "R",
           "texture_top": "T", "texture_bottom": "G"}  # fmt: skip


def grid(columns: int, rows: int, hue: float | None = None, letters: str = "ABCDEFGH") -> Picture:
    """Squares with a letter for the column and a number for the row; of one hue, or one for each column."""
    image = Image.new("RGB", (CELL * columns, CELL * rows))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(34)
    for row in range(rows):
        for column in range(columns):
            shade = 0.95 if (row + column) % 2 else 0.7
            ink = colorsys.hsv_to_rgb(column / columns if hue is None else hue, 0.25 + 0.5 * row / rows, shade)
            x, y = CELL * column, CELL * row
            draw.rectangle((x, y, x + CELL - 1, y + CELL - 1), tuple(round(255 * part) for part in ink))
            label = f"{letters[column]}{row + 1}" if hue is None else letters
            draw.text((x + CELL / 2, y + CELL / 2), label, (25, 25, 25), font, "mm")
    return np.array(image)


def sky() -> NDArray[np.float32]:
    """Linear radiance, bluer above."""
    share = np.linspace(0.0, 1.0, SIDE)[:, None, None]
    colors = (1 - share) * np.array([0.16, 0.32, 0.62]) + share * np.array([0.75, 0.8, 0.85])
    return np.broadcast_to(colors, (SIDE, SIDE, 3)).astype(np.float32)


def objects() -> dict[str, dict[str, Any]]:
    """Objects in the picture, by label."""
    image, place = grid(8, 4), [0.0, 0.0, 280.0]
    sides = {key: grid(2, 2, k / 6, letter) for k, (key, letter) in enumerate(LETTERS.items())}
    around = LAID | {"texture": image, "rotation": TILTED, "center": place}
    box = around | sides | {"shape": "box", "size": [40.0, 34.0, 30.0]}
    cube = around | sides | {"shape": "sphere", "radius": 26.0, "texture_mapping": "cube"}
    saddle = around | {"shape": "quadric", "coefficients": [1, -0.35, 1, 0, 0, 0, 0, 0, 0, -150], "texture_size": 40.0}
    plane = LAID | {"shape": "plane", "distance": 285.0, "texture": image, "texture_size": 50.0}
    card = LAID | {"shape": "rectangle", "center": place, "size": [58.0, 58.0], "texture": grid(4, 4)}
    return {
        "plane": plane | {"rotation": [-65.0, 0.0, 0.0], "bounds": [[-90, 90], [-90, 40], [-1, 1]]},
        "cylinder": around | {"shape": "cylinder", "radius": 18.0, "bounds": [[-20, 20], [-24, 24], [-20, 20]]},
        "cone": LAID | {"shape": "cone", "half_angle": 32.0, "texture": image, "texture_size": 60.0,
                        "texture_angle": 180.0, "rotation": BACK_DOWN, "apex": [0.0, 26.0, 265.0]},
        "disc": around | {"shape": "disc", "radius": 28.0},
        "box": box,
        "box from behind and below": box | {"rotation": BEHIND},
        'sphere, "cube"': cube,
        "from behind and below": cube | {"rotation": BEHIND},
        "sphere, longitude and latitude": around | {"shape": "sphere", "radius": 26.0},
        "ellipsoid": around | {"shape": "ellipsoid", "semi_axes": [30.0, 17.0, 17.0]},
        'quadric, "triplanar"': saddle,
        "from behind: mirrored": saddle | {"rotation": [-25.0, 155.0, 0.0]},
        **{f'texture_wrap = "{wrap}"': card | {"texture_size": 24.0, "texture_wrap": wrap, "texture_angle": 10.0}
           for wrap in ("repeat", "mirror", "clamp", "none")},
    }  # fmt: skip


def picture() -> Picture:
    """The frames of all objects with their labels, (rows, columns, 3)."""
    behind = {"shape": "background", "texture": sky()}
    tiles = []
    for label, item in objects().items():
        scene = clsco.parse_scene({"camera": CAMERA, "light": LIGHT, "object": [item, behind]})
        tiles.append((codes_to_show(clsco.render_frame(scene, truth=()).color), label))
    return contact_sheet(split_into_rows(tiles), text=14)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=Path(__file__).parents[1] / "docs" / "textures.png")
    Image.fromarray(picture()).save(parser.parse_args().out, optimize=True)


if __name__ == "__main__":
    main()
