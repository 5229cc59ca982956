"""Rolling shutters against Cycles: python -m benchmarks.truth.rolling_shutter --blender-python PYTHON [--samples N]

A card and a sphere, out of focus, that move while rows open from the top, each for a quarter of the time. Cycles tells
the time of a row by a share of the shutter, and takes the lower edge of a row for it: with S s, of which each row has
the share d, row i of n opens (i + 1) (1 - d) S / n s after the first moment. So `shutter` is d S, `readout` is
(n - 1) (1 - d) S / n, and `shutter_start` the time from row to row; half of it less, or more, leaves 10 dB less.

A PSNR is that of the mean of (x - a)(x - b), a and b being two pictures by Cycles with other seeds, whose noise is in
no such mean but for its scatter; noise is that of a against b. The same with all rows at once says what is not the
shutter's, and a global shutter against the rolling one how much there is to see.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco
from benchmarks.truth.cycles_meshes import Cycles
from benchmarks.truth.meshes import meshes_of
from clsco.inputs.textures import load_scene_textures

Array = NDArray[Any]
EXPOSED, ROWS, COLUMNS, POSES, THREADS = 0.25, 96, 128, 5, 2


def picture() -> Array:
    """Smooth waves (256, 256), which programs interpolate alike."""
    at = (np.arange(256) + 0.5) / 256
    return (0.5 + 0.2 * np.sin(16 * np.pi * at)[:, None] + 0.25 * np.sin(12 * np.pi * at)).astype(np.float32)


def scenes() -> dict[str, clsco.Scene]:
    """Scenes whose shutter is open for 1 s, for all rows."""
    camera = clsco.Camera(resolution=(COLUMNS, ROWS), pixel_pitch=0.05, focus_distance=250.0, aperture_diameter=14.0)
    motion = clsco.ObjectMotion(velocity=(36.0, 8.0, 0.0))
    shown: dict[str, Any] = {"texture": picture(), "texture_mapping": "surface", "motion": motion}
    card = clsco.Rectangle(center=(-10.0, -4.0, 300.0), size=(60.0, 46.0), **shown)
    ball = clsco.Sphere(center=(-12.0, -4.0, 300.0), radius=26.0, **shown)
    named: dict[str, clsco.Rectangle | clsco.Sphere] = {"card": card, "sphere": ball}
    return {name: clsco.Scene(camera=camera, objects=(item,)) for name, item in named.items()}


def rolling(scene: clsco.Scene) -> clsco.Scene:
    """The scene with the rolling shutter that Cycles has."""
    apart = (1.0 - EXPOSED) / ROWS
    return scene.replace("sequence", {"shutter": EXPOSED, "readout": (ROWS - 1) * apart, "shutter_start": apart})


def decibels(square: float) -> str:
    """PSNR of a mean square, of white."""
    return f"{-10.0 * math.log10(max(square, 1e-12)):.1f}"


def pictures(scene: clsco.Scene, python: Path, samples: int, exposed: float) -> tuple[Array, Array]:
    """Two pictures by Cycles with other seeds."""
    loaded, textures = load_scene_textures(scene)
    meshes = meshes_of(loaded, [texture.radiance for texture in textures], POSES)
    cycles = Cycles(python, scene.camera, meshes, THREADS, exposed)
    try:
        one, other = (cycles.render(samples, seed)[0].mean(axis=2) for seed in (1, 2))
    finally:
        cycles.close()
    return one, other


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blender-python", type=Path, required=True, help="Python that has the package bpy")
    parser.add_argument("--samples", type=int, default=1024, help="rays per pixel")
    given = parser.parse_args()
    print("| scene | rolling, dB | noise | all rows at once, dB | noise | global against rolling, dB |")
    print("|---|---|---|---|---|---|")
    for name, scene in scenes().items():
        found, in_turn = [name], pictures(scene, given.blender_python, given.samples, EXPOSED)
        at_once = pictures(scene, given.blender_python, given.samples, 1.0)
        plain = clsco.render_frame(scene, truth=()).color
        for image, (one, other) in ((clsco.render_frame(rolling(scene), truth=()).color, in_turn), (plain, at_once)):
            found += [decibels(np.mean((image - one) * (image - other))), decibels(np.mean((one - other) ** 2))]
        found.append(decibels(np.mean((plain - in_turn[0]) * (plain - in_turn[1]))))
        print(f"| {' | '.join(found)} |", flush=True)


if __name__ == "__main__":
    main()
