"""Time of lenses that are not thin: CPU time of frames with a key of [lens], as multiples of that without it.

    python -m benchmarks.speed.aberrations [--width 1000] [--rounds 3]

By turns, and the best of the rounds: a plane in front of the focus with a texture in color.
"""

from __future__ import annotations

import argparse
from time import process_time
from typing import Any

import numpy as np

import clsco

KEYS: dict[str, dict[str, Any]] = {
    "axial": {"axial": [0.01, 0.0, -0.01]},
    "field_curvature and focus_surface": {"field_curvature": -0.001, "focus_surface": "sphere"},
    "vignetting": {"vignetting": "natural"},
    "distortion": {"distortion": (-0.25, 0.05, 0.0)},
    "distortion and tangential": {"distortion": (-0.25, 0.05, 0.0), "tangential": (0.002, -0.001)},
}
RADII = (6.0, 20.0)


def scene_of(width: int, radius: float, lens: dict[str, Any]) -> clsco.Scene:
    """A tilted plane whose blur is about `radius` px, in a color texture of noise."""
    image = np.random.default_rng(1).random((width, width, 3), dtype=np.float32)
    camera = clsco.Camera(resolution=(width, width), pixel_pitch=0.01)
    distance = 1.0 / (1.0 / camera.focused_distance - radius / 1e4)
    wall = clsco.Plane(distance=distance, slope_x=0.05, texture=image)
    return clsco.Scene(camera=camera, objects=(wall,), lens=clsco.Lens(**lens))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    for radius in RADII:
        scenes = {name: scene_of(given.width, radius, lens) for name, lens in {"none": {}, **KEYS}.items()}
        best = dict.fromkeys(scenes, np.inf)
        for turn in range(given.rounds + 1):  # the first one compiles
            for name, scene in scenes.items():
                start = process_time()
                clsco.render_frame(scene, truth=())
                best[name] = min(best[name], process_time() - start) if turn else np.inf
        pixels = given.width**2
        print(f"R {radius:g} px: {1e9 * best['none'] / pixels:.1f} ns per px without any")
        for name in KEYS:
            more = 1e9 * (best[name] - best["none"]) / pixels
            print(f"  {name}: {best[name] / best['none']:.2f} times, {more:+.1f} ns per px")


if __name__ == "__main__":
    main()
