"""Processor time of a frame with a texture on the surface, beside the same with a projected one.

    python benchmarks/speed/surface_textures.py [--size 512] [--repeats 7]

A ball and a card with the built-in bricks, in focus and with R up to 4 px: medians of interleaved repetitions, in ms.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import clsco

BALL: dict[str, Any] = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0}
CARD: dict[str, Any] = {"shape": "rectangle", "center": [0.0, 0.0, 265.0], "size": [60.0, 60.0]}
CARD |= {"rotation": [20.0, 40.0, 0.0]}
LAID = {"texture_mapping": "surface"}


def main() -> None:
    """Read the command line, measure, print."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    for name, item in (("ball", BALL), ("card", CARD)):
        for aperture in (0.01, 10.0):
            camera = {"resolution": [options.size] * 2, "aperture_diameter": aperture}
            scenes = [clsco.parse_scene({"camera": camera, "object": [item | keys]}) for keys in ({}, LAID)]
            spent: tuple[list[float], ...] = ([], [])
            for repeat in range(options.repeats + 1):
                for times, scene in zip(spent, scenes, strict=True):
                    began = time.process_time()
                    clsco.render_frame(scene, truth=())
                    if repeat:  # the first compiles
                        times.append(1e3 * (time.process_time() - began))
            projected, laid = (statistics.median(times) for times in spent)
            focus = "in focus" if aperture < 1 else "R up to 4 px"
            print(f"{name}, {focus}: projected {projected:.1f} ms, on the surface {laid:.1f} ms")


if __name__ == "__main__":
    main()
