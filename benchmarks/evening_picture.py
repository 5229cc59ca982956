"""docs/evening.jpg, the first example, and docs/evening_truth.jpg, what clsco knows of each of its pixels:

    python -m benchmarks.evening_picture

For the flow, the camera of the second picture moves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import clsco
from clsco.frame.contact_sheet import contact_sheet, split_into_rows
from clsco.frame.notebook import codes_to_show
from clsco.frame.views import Picture, flow_colors, viridis

ROOT = Path(__file__).parents[1]
LARGE = ("camera.resolution=[1152, 768]", "camera.pixel_pitch=0.03125")
MOVING = ("camera.motion.velocity=[60.0, 0.0, 200.0]", "sequence.interval=0.04", "sequence.shutter=0.001")
TRUTH = ("depth", "coc", "flow", "normal", "sharp", "object_id", "mask")
TILE = 372, 248  # px
NOTHING = 225  # gray where there is no surface
OBJECTS = ("#d9483b", "#e0a316", "#2a9d8f", "#d8557a", "#8a4b26", "#3a4468")


def truth_pictures(frame: Any) -> dict[str, Picture]:
    """Pictures of the outputs of a frame, by labels with their range."""
    seen = frame.mask
    near, far = (float(limit) for limit in (frame.depth[seen].min(), frame.depth[seen].max()))
    most = float(abs(frame.blur_radius).max())
    longest = float(np.linalg.norm(frame.flow[seen], axis=-1).max())
    colors = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in OBJECTS], np.uint8)
    depth = viridis(1 / np.where(seen, frame.depth, far), 1 / far, 1 / near)
    flow = flow_colors(frame.flow, longest)
    return {
        f"depth, {near:.0f} to {far:.0f} mm, and beyond": np.where(seen[..., None], depth, NOTHING).astype(np.uint8),
        f"blur radius R, up to {most:.0f} px": viridis(frame.blur_radius, -most, most),
        f"flow, up to {longest:.0f} px": np.where(seen[..., None], flow, NOTHING).astype(np.uint8),
        "masks of the objects": colors[frame.object_id % len(colors)],
        "normals": (127.5 * (1 + frame.normal * np.array([1, 1, -1]))).round().astype(np.uint8),
        "all in focus": codes_to_show(frame.sharp),
    }


def main() -> None:
    """Render and write both pictures."""
    evening = ROOT / "examples" / "evening.toml"
    picture = clsco.render_frame(clsco.load_scene(evening, LARGE), truth=()).image()
    frame = clsco.render_frame(clsco.load_scene(evening, MOVING), truth=TRUTH)
    tiles = [
        (np.asarray(Image.fromarray(image).resize(TILE, Image.Resampling.LANCZOS)), label)
        for label, image in truth_pictures(frame).items()
    ]
    for name, image in (("evening", picture), ("evening_truth", contact_sheet(split_into_rows(tiles, 3), text=14))):
        Image.fromarray(image).save(ROOT / "docs" / f"{name}.jpg", quality=88, optimize=True)


if __name__ == "__main__":
    main()
