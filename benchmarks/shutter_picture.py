"""docs/shutter.png, a fan and a train with all rows open at once and one after another: python -m
benchmarks.shutter_picture [-o FILE]"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import clsco

ROOT = Path(__file__).parents[1]
NAMES, GAP, WHITE = ("rolling_fan", "rolling_train"), 6, 255


def row(name: str) -> NDArray[np.uint8]:
    """An example with a global shutter, and as it is, beside each other."""
    scene = clsco.load_scene(ROOT / "examples" / f"{name}.toml")
    scenes = (scene.replace("sequence.readout", 0.0), scene)
    pictures = [clsco.render_frame(each, truth=()).image() for each in scenes]
    gap = np.full((len(pictures[0]), GAP, 3), WHITE, np.uint8)
    return np.concatenate([pictures[0], gap, pictures[1]], axis=1)


def picture() -> NDArray[np.uint8]:
    """The examples below each other, as wide as the widest."""
    rows = [row(name) for name in NAMES]
    width, height = max(each.shape[1] for each in rows), sum(map(len, rows)) + GAP * (len(rows) - 1)
    found, top = np.full((height, width, 3), WHITE, np.uint8), 0
    for each in rows:
        left = (width - each.shape[1]) // 2
        found[top : top + len(each), left : left + each.shape[1]] = each
        top += len(each) + GAP
    return found


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "docs" / "shutter.png")
    Image.fromarray(picture()).quantize(64, dither=Image.Dither.NONE).save(parser.parse_args().out, optimize=True)


if __name__ == "__main__":
    main()
