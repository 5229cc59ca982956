"""Makes the files that depth_map.toml shows, an image and a 16-bit depth map of it: python examples/depth_map.py."""

from pathlib import Path

import numpy as np

import clsco
from clsco.files.images import write_png
from clsco.files.transfer import encode

FOLDER = Path(__file__).resolve().parent
SCENE = {
    "camera": {"resolution": [320, 320], "pixel_pitch": 0.016},
    "object": [
        {"name": "red", "shape": "sphere", "center": [-12, -7.2, 185], "radius": 8, "texture": "bricks"},
        {"name": "green", "shape": "ellipsoid", "center": [11, 6, 240], "semi_axes": [7, 13, 7], "texture": "bricks"},
        {"name": "blue", "shape": "sphere", "center": [-15, 16, 305], "radius": 13, "texture": "siemens_star"},
        {"name": "floor", "shape": "plane", "distance": 285, "slope_y": 6.5, "texture": "checkerboard"},
        {"name": "sky", "shape": "plane", "distance": 420, "texture": "checkerboard"},
    ],
}  # fmt: skip
TINTS = np.array([[1.0, 0.25, 0.15], [0.3, 0.8, 0.3], [0.25, 0.4, 1.0], [0.9, 0.75, 0.5], [0.55, 0.7, 0.9]])
STEP_MM = 0.01  # of the depth map's numbers


def main() -> None:
    (frame,) = clsco.render(clsco.parse_scene(SCENE), truth=("sharp", "depth", "object_id"))
    image = frame.sharp[..., None] * TINTS[frame.object_id]
    write_png(FOLDER / "depth_map_image.png", encode(image.astype(np.float32), 8, "srgb"))
    write_png(FOLDER / "depth_map_depth.png", np.rint(frame.depth / STEP_MM).astype(np.uint16))


if __name__ == "__main__":
    main()
