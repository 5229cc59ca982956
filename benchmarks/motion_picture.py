"""docs/motion.png, a small ball along keyframes with each interpolation, and a focus pull: python -m
benchmarks.motion_picture [-o FILE]"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import clsco

ROOT = Path(__file__).parents[1]
COLUMNS, ROWS = 200, 150
PLACES = ((-9.0, -5.0), (-5.0, 5.0), (0.0, -4.0), (4.0, 5.0), (9.0, 1.0))  # mm
BRIGHTNESS = 12.0


def traced(interpolation: str) -> NDArray[np.float32]:
    """A second of exposure of a ball that goes through five keyframes."""
    keys = [{"time": k / 4, "position": [x, y, 0.0]} for k, (x, y) in enumerate(PLACES)]
    ball = {"shape": "sphere", "center": [0.0, 0.0, 260.0], "radius": 0.45, "texture": "#ffffff"}
    scene: dict[str, Any] = {
        "camera": {"resolution": [COLUMNS, ROWS], "pixel_pitch": 0.01, "focus_distance": 262.0},
        "object": [
            ball | {"motion": {"keyframe": keys, "interpolation": interpolation}},
            {"shape": "plane", "distance": 300.0, "texture": "#0a0a0a"},
        ],
    }
    return BRIGHTNESS * clsco.render_frame(clsco.parse_scene(scene), truth=()).color


def pulled() -> list[NDArray[np.float32]]:
    """Frames of examples/focus_pull.toml."""
    size = [f"camera.resolution=[{COLUMNS}, {ROWS}]", "camera.pixel_pitch=0.025", "sequence.shutter=0.05"]
    scene = clsco.load_scene(ROOT / "examples" / "focus_pull.toml", size)
    return [frame.color for frame in clsco.render(scene, truth=())]


def picture() -> NDArray[np.uint8]:
    """Interpolations above: step, linear, cubic, bspline; the focus pull below."""
    above = [traced(interpolation) for interpolation in ("step", "linear", "cubic", "bspline")]
    codes = np.clip(np.block([above, pulled()]), 0.0, 1.0) ** (1 / 2.2)
    return np.rint(255 * codes).astype(np.uint8)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "docs" / "motion.png")
    Image.fromarray(picture()).save(parser.parse_args().out, optimize=True)


if __name__ == "__main__":
    main()
