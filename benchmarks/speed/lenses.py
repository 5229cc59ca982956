"""Time of a frame by the lens it is taken with, beside the plain disc: python -m benchmarks.speed.lenses [NAME ...]

ns of processor time per pixel of a frame of a plane that is tilted, with |R| from 0.8 to 1.2 times 6 px and 20 px, and
how many times the plain disc's that is, of lenses that separate colors the plain disc's in color; medians of
repetitions by turns, warm: tables, which take long to make of waves, are there.
"""

from __future__ import annotations

import argparse
import time
from statistics import median
from typing import Any

import numpy as np

import clsco
from benchmarks.lens_pictures import heart

SIDE, REPETITIONS = 448, 5
RADII = (6.0, 20.0)  # px
PLAIN, COLORED = "plain disc", "plain disc, in color"
ELLIPSES, COLORED_ELLIPSES = "distortion over 85 degrees, ellipses", "distortion over 85 degrees, in color"
BARREL, CURVED = {"distortion": [-0.25, 0.05, 0.0]}, {"field_curvature": -0.001, "focus_surface": "sphere"}
PENTAGON = {"shape": "polygon", "blades": 5, "rotation": 8.0}
# Sections of a scene file by the name of a row.
LENSES: dict[str, dict[str, Any]] = {
    PLAIN: {},
    "pentagon": {"aperture": PENTAGON},
    "pentagon, curved blades": {"aperture": PENTAGON | {"blade_curvature": 0.5}},
    "ring": {"aperture": {"shape": "ring", "obstruction": 0.4}},
    "squeeze of 2": {"aperture": {"squeeze": 2.0}},
    "image of a heart": {"aperture": {"shape": "image", "image": heart(128)}},
    "rim that cuts the corners": {"aperture": {"rim": [{"distance": 40.0, "diameter": 17.0}]}},
    "rim that cuts nothing": {"aperture": {"rim": [{"distance": 40.0, "diameter": 200.0}]}},
    "waves": {"psf": {"model": "wave"}},
    "waves, ring": {"psf": {"model": "wave"}, "aperture": {"shape": "ring", "obstruction": 0.4}},
    "waves, coma": {"psf": {"model": "wave", "zernike": {"3,1": 0.1}}},
    "vignetting": {"lens": {"vignetting": "natural"}},
    "field curvature, focus on a sphere": {"lens": CURVED},
    "distortion": {"lens": BARREL},
    ELLIPSES: {"lens": BARREL},
}
IN_COLOR: dict[str, dict[str, Any]] = {
    COLORED: {},
    "longitudinal color": {"lens": {"axial": [0.01, 0.0, -0.01]}},
    "lateral color": {"lens": {"lateral": [1.001, 1.0, 0.999]}},
    "waves, in color": {"psf": {"model": "wave"}},
    COLORED_ELLIPSES: {"lens": BARREL},
}
WIDE = {ELLIPSES: 4.0, COLORED_ELLIPSES: 4.0}  # times as large pixels and opening: the image is distorted visibly


def scene(sections: dict[str, Any], radius: float, to_color: bool = False, wide: float = 1.0) -> clsco.Scene:
    """A plane behind the focus, with |R| around a radius in px."""
    texture = np.random.default_rng(1).random((256, 256, 3), np.float32) if to_color else "bricks"
    focus, aperture, pitch, focal_length = 250.0, wide * 10.0, wide * 0.012, 20.0
    scale = focal_length * aperture / (2.0 * pitch)
    nearest, farthest = (1.0 / (1.0 / focus - part * radius / scale) for part in (0.8, 1.2))
    across = 0.5 * SIDE * pitch / focal_length  # slope of the last ray
    middle = 2.0 / (1.0 / nearest + 1.0 / farthest)
    slope = (1.0 - middle / farthest) / across
    camera = {
        "resolution": [SIDE, SIDE], "focal_length": focal_length, "focus_distance": focus, "pixel_pitch": pitch,
        "aperture_diameter": aperture, "normalization_distance": focal_length,
    }  # fmt: skip
    plane = {"shape": "plane", "distance": middle, "slope_x": slope, "texture": texture}
    return clsco.parse_scene({"camera": camera, "object": [plane], **sections})


def measured(names: list[str], radius: float) -> dict[str, float]:
    """ns per pixel of frames, by the name of the lens."""
    every = LENSES | IN_COLOR
    scenes = {name: scene(every[name], radius, name in IN_COLOR, WIDE.get(name, 1.0)) for name in names}
    spent: dict[str, list[float]] = {name: [] for name in names}
    live = clsco.Live()
    for turn in range(REPETITIONS + 1):
        for name, wanted in scenes.items():
            live.render(wanted, truth=())  # the lens before it may have left its tables
            before = time.process_time()
            live.render(wanted, truth=())
            if turn:
                spent[name].append(time.process_time() - before)
    return {name: 1e9 * median(times) / SIDE**2 for name, times in spent.items()}


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="rows, by default all", metavar="NAME")
    chosen = parser.parse_args().names or [*LENSES, *IN_COLOR]
    first = [COLORED] if set(chosen) & IN_COLOR.keys() else []
    names = list(dict.fromkeys((PLAIN, *(name for name in chosen if name in LENSES), *first, *chosen)))
    tables = [measured(names, radius) for radius in RADII]
    print("| lens | " + " | ".join(f"R {radius:g}, ns per px | times" for radius in RADII) + " |")
    print("|---" * (1 + 2 * len(RADII)) + "|")
    for name in names:
        beside = COLORED if name in IN_COLOR else PLAIN
        cells = [f"{found[name]:.1f} | {found[name] / found[beside]:.2f}" for found in tables]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
