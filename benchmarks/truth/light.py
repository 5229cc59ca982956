"""Error of surfaces in a light, against the thin-lens ray tracer.

    python -m benchmarks.truth.light [--only NAME] [--size 512] [--noise 1e-4]

PSNR has the peak 1.0, white; field of view and blur radii in px are those of 512 px. Images are kept under build/.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import clsco
from benchmarks.truth.accuracy import BALL, FULL_SIZE, NOISE, ROOT
from benchmarks.truth.traced import decibels, rms, traced

FAR: dict[str, Any] = {"direction": [0.3, 0.8, 1.0], "ambient": 0.2}
NEAR: dict[str, Any] = {"position": [100.0, 200.0, 50.0], "ambient": 0.1}
BEHIND: dict[str, Any] = {"direction": [1.0, 0.5, -0.3]}
BOX = {"shape": "box", "center": [0.0, 0.0, 280.0], "size": [40.0, 30.0, 30.0], "rotation": [30.0, 40.0, 0.0]}
ROLLER = {
    "shape": "cylinder", "center": [0.0, 0.0, 280.0], "radius": 30.0, "axis": [0.3, 1.0, 0.2],
    "motion": {"velocity": [2.0, 1.0, 3.0], "angular_velocity": [0.0, 0.0, 10.0]},
}  # fmt: skip
# Light, object, texture.
SCENES: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "white sphere, far light": (FAR, BALL, "#ffffff"),
    "white sphere, far light behind it": (BEHIND, BALL, "#ffffff"),
    "sphere, near light": (NEAR, BALL, "bricks"),
    "box, far light": (FAR, BOX, "bricks"),
    "moving cylinder, near light": (NEAR, ROLLER, "bricks"),
}


def scene_of(name: str, size: int) -> clsco.Scene:
    """The scene `name`, size x size px."""
    light, item, texture = SCENES[name]
    ratio = FULL_SIZE / size
    camera = {"resolution": [size, size], "pixel_pitch": 0.01 * ratio, "aperture_diameter": 10.0 * ratio}
    return clsco.parse_scene({"camera": camera, "light": light, "object": [{**item, "texture": texture}]})


def psnr(name: str, size: int, noise: float, cache: Path | None) -> tuple[float, float]:
    """PSNR in dB of the first frame of the scene `name`, and that of the tracer's own noise."""
    scene = scene_of(name, size)
    image, error = traced(scene, noise, cache)
    return decibels(rms(clsco.render_frame(scene).color - image)), decibels(rms(error))


def main() -> None:
    """Read the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="NAME", help="scenes whose name contains this")
    parser.add_argument("--size", type=int, default=FULL_SIZE, metavar="N", help="frame of N x N px")
    parser.add_argument("--noise", type=float, default=NOISE, help="RMS noise of the traced images")
    options = parser.parse_args()
    for name in (name for name in SCENES if options.only in name):
        error, floor = psnr(name, options.size, options.noise, ROOT.parent / "build" / "traced")
        print(f"{name}: {error:.1f} dB, noise of the tracer {floor:.1f} dB", flush=True)


if __name__ == "__main__":
    main()
