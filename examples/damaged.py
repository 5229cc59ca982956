"""Makes damaged.png and damaged_mask.png: python examples/damaged.py, with scikit-image for the photograph.

It is NASA's portrait of Eileen Collins, in the public domain, in 256 colors, with scratches and text over it.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from skimage.data import astronaut

from clsco.files.images import write_png

FOLDER = Path(__file__).resolve().parent
SCRATCHES = (
    ((12, 40), (290, 210), 3), ((40, 295), (150, 5), 4), ((0, 236), (299, 262), 2), ((210, 0), (262, 299), 3),
    ((100, 120), (250, 60), 2), ((270, 30), (299, 120), 6),
)  # fmt: skip
TEXT = ((18, 86), "Each letter is a hole"), ((60, 196), "in the photograph.")


def main() -> None:
    image = astronaut()[:300, 70:370].copy()
    drawn = Image.new("L", (300, 300))
    pen = ImageDraw.Draw(drawn)
    for begin, end, width in SCRATCHES:
        pen.line([begin, end], 255, width)
    for place, words in TEXT:
        pen.text(place, words, 255, ImageFont.load_default(25))
    missing = np.asarray(drawn) >= 128
    image[missing] = 255
    Image.fromarray(image).quantize(256, dither=Image.Dither.NONE).save(FOLDER / "damaged.png", optimize=True)
    write_png(FOLDER / "damaged_mask.png", np.where(missing, 255, 0).astype(np.uint8))


if __name__ == "__main__":
    main()
