"""docs/overview.png, examples and the ground truth of one of them: python -m benchmarks.overview_picture [-o FILE]"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from PIL import Image

import clsco
from clsco.cli.sheets import demo_sheet

ROOT = Path(__file__).parents[1]
SHOWN = {
    "background": "balls before a background",
    "focus_pull": "focus pulled from a ball to a wall",
    "lit": "a box, a ball and a floor, lit",
    "wide_angle": "a wide lens: distortion and vignetting",
}
DETAILED = "camera_motion"


def middle_frame(name: str, **options: Any) -> clsco.Frame:
    """The middle one of an example's frames."""
    scene = clsco.load_scene(ROOT / "examples" / f"{name}.toml")
    return clsco.render_frame(scene, scene.sequence.frames // 2, **options)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "docs" / "overview.png")
    out = parser.parse_args().out
    shown = {words: middle_frame(name, truth=()) for name, words in SHOWN.items()}
    Image.fromarray(demo_sheet(shown, [[middle_frame(DETAILED)]])).save(out, optimize=True)


if __name__ == "__main__":
    main()
