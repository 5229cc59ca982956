"""Error of textures on surfaces against the ray tracer, whose images on surfaces are continuous functions.

    python -m benchmarks.truth.surface_textures [--only NAME] [--size 192] [--frames 0,10,20,30,40,50]

A ball, a cylinder, a card, a cone, an ellipsoid and, from three sides, a ball again turn through 360 degrees in 60
frames, in front of the camera of the thesis, with R up to 5 px: six of the frames, with the shutter closed at once and
open for all of the interval. Then checkerboards at 80 degrees, on a card and on a plane that fills the view. PSNR
in dB, white = 1; the table goes to the terminal, and of all objects to benchmarks/results/surface_textures.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import clsco
from benchmarks.truth.traced import decibels, rms, traced
from clsco.inputs.textures import load_texture

ROOT = Path(__file__).resolve().parents[1]
FULL_SIZE = 512
NOISE = 4e-4
FRAMES = 60

LAID = {"texture_mapping": "surface"}
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0, "rotation": [20.0, 0.0, 10.0]}
TURNING: dict[str, dict[str, Any]] = {
    "ball": LAID | BALL,
    "cylinder": LAID | {"shape": "cylinder", "center": [0.0, 0.0, 280.0], "radius": 25.0},
    "card": LAID
    | {"shape": "rectangle", "center": [0.0, 0.0, 280.0], "size": [50.0, 40.0], "rotation": [10.0, 0.0, 0.0]},
    "cone": LAID
    | {"shape": "cone", "apex": [0.0, 25.0, 280.0], "half_angle": 30.0, "rotation": [-90.0, 0.0, 0.0]}
    | {"texture_size": 120.0, "bounds": [[-60.0, 60.0], [-60.0, 60.0], [0.0, 50.0]]},
    "ellipsoid": LAID | {"shape": "ellipsoid", "center": [0.0, 0.0, 280.0], "semi_axes": [36.0, 22.0, 26.0]},
    "ball, triplanar": BALL | {"texture_mapping": "triplanar", "texture_size": 100.0},
}
# Rows and columns of the bricks, about one texel per pixel in a frame of 192 x 192 px.
IMAGES = {"ball": (192, 384), "cylinder": (192, 320), "card": (128, 160), "cone": (192, 192), "ellipsoid": (192, 384)}
TILTED: dict[str, dict[str, Any]] = {
    "card at 80 deg": LAID
    | {"shape": "rectangle", "center": [0.0, 0.0, 262.0], "size": [60.0, 60.0], "rotation": [80.0, 0.0, 0.0]}
    | {"texture_repeats": 0.5},
    "plane at 80 deg": LAID | {"shape": "plane", "distance": 255.0, "slope_y": 5.67, "texture_size": 300.0},
}
APERTURES = {"card at 80 deg": (10.0, 1.0), "plane at 80 deg": (3.0, 1.0)}  # mm


def scene_of(
    item: dict[str, Any], image: Any, size: int, moving: bool, frame: int, aperture: float, samples: int = 4
) -> Any:
    """A frame of an object that turns by 6 degrees each second about y, alone: it begins where that frame does."""
    ratio = FULL_SIZE / size
    camera = {"resolution": [size, size], "pixel_pitch": 0.01 * ratio, "aperture_diameter": aperture * ratio}
    sequence = {"frames": frame + 1, "interval": 1.0, "shutter": 1.0 if moving else 1e-6}
    turning = {"motion": {"angular_velocity": [0.0, 360.0 / FRAMES, 0.0]}} if frame or moving else {}
    sequence |= {} if moving else {"samples": 1}
    objects = [item | turning | {"texture": image}]
    psf = {"silhouette_samples": samples}
    return clsco.parse_scene({"camera": camera, "psf": psf, "sequence": sequence, "object": objects})


def measured(
    item: dict[str, Any], image: Any, size: int, moving: bool, frame: int, aperture: float = 10.0, samples: int = 4
) -> float:
    """PSNR in dB of a frame."""
    scene = scene_of(item, image, size, moving, frame, aperture, samples)
    exact, _ = traced(scene, NOISE, ROOT.parent / "build" / "traced", frame, report=lambda _: None)
    return decibels(rms(clsco.render_frame(scene, frame, truth=()).color - exact))


def main() -> None:
    """Read the command line, measure, print and write."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--only", default="", metavar="NAME", help="objects whose name contains this")
    parser.add_argument("--size", type=int, default=192, metavar="N", help="frame of N x N px")
    parser.add_argument("--frames", default="0,10,20,30,40,50", help="of the turn, 0 to 59")
    options = parser.parse_args()
    frames = [int(frame) for frame in options.frames.split(",")]
    table = Table("object", "shutter", *(f"frame {frame}" for frame in frames))
    lines = [f"| object | shutter | {' | '.join(f'frame {n}' for n in frames)} |", "|---|---|" + "---|" * len(frames)]
    for name, item in TURNING.items():
        for moving in (False, True):
            if options.only not in name:
                continue
            image = np.asarray(load_texture("bricks", "srgb", IMAGES.get(name, (192, 192))).radiance)
            found = [f"{measured(item, image, options.size, moving, frame):.1f}" for frame in frames]
            shutter = "open" if moving else "closed"
            table.add_row(name, shutter, *found)
            lines.append(f"| {name} | {shutter} | {' | '.join(found)} |")
    squares = np.asarray(load_texture("checkerboard", "srgb", (256, 256)).radiance)
    for name, item in TILTED.items():
        if options.only in name:
            apertures = APERTURES[name]
            for samples in (4, 16):
                values = [measured(item, squares, options.size, False, 0, each, samples) for each in apertures]
                found = [f"{value:.1f}" for value in values]
                named = f"{name}, {samples} silhouette samples"
                table.add_row(named, "closed", *found)
                named += ", aperture " + "; ".join(f"{aperture:g} mm" for aperture in apertures)
                lines.append(f"| {named} | closed | {' | '.join(found)} |" + " |" * (len(frames) - 2))
    Console().print(table)
    if options.only:
        return
    (ROOT / "results").mkdir(exist_ok=True)
    text = f"# Textures on surfaces\n\nPSNR in dB against the ray tracer, {options.size} x {options.size} px.\n\n"
    (ROOT / "results" / "surface_textures.md").write_text(text + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
