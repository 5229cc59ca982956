"""Soft depth edges: the error of a picture by averaged, blurred, resampled and compressed depth maps.

    python -m benchmarks.truth.soft_depths [--textures plain,noise] [--size 160]

A disc before a wall, with the near, the far or both of them blurred (R -11 and 0, 0 and 11, -9.5 and 8.2 px), rendered
with visibility tests and traced at 8 x 8 points per pixel for an image and a depth map that average over each pixel.
RMS and largest error are those of `clsco.defocus` of the image by the depth map against the picture of the scene:
by the hard depth at the centers of pixels, by the soft depth as it is, and with each depth between the two surfaces
given to one of them. Figures go to the terminal and to benchmarks/results/soft_depths.md.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

import clsco
from benchmarks.tables import write_table
from clsco.optics.lens import blur_radius

RESULTS = Path(__file__).resolve().parents[1] / "results" / "soft_depths.md"
Array = NDArray[Any]
FINE = 8  # points per pixel and axis
NEAR, FAR = 150.0, 300.0  # mm
LENSES = {"near blurred": (300.0, 20.0), "far blurred": (150.0, 20.0), "both blurred": (205.0, 32.0)}  # focus, D
COLORS = ((0.8, 0.3, 0.1), (0.1, 0.4, 0.7))


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--textures", default="plain,check,noise", help="of disc and wall, separated by commas")
    parser.add_argument("--size", type=int, default=160, help="px")
    chosen = parser.parse_args()
    rows = []
    for name in chosen.textures.split(","):
        for lens in LENSES:
            for row in measured(name, lens, chosen.size):
                print(
                    "  ".join(f"{key} {value:.4g}" if isinstance(value, float) else value for key, value in row.items())
                )
                rows.append(row)
    write_table(RESULTS, f"`python -m benchmarks.truth.soft_depths`, {chosen.size} x {chosen.size} px", rows)


def measured(texture: str, lens: str, size: int) -> Iterator[dict[str, float | str]]:
    """Errors of a scene, by each kind of depth map."""
    truth = clsco.render_frame(scene(texture, lens, size, {"silhouette_samples": 16}), truth=()).color
    hard = clsco.render_frame(scene(texture, lens, size), truth=("depth",)).depth
    fine = clsco.render_frame(scene(texture, lens, size * FINE), truth=("depth", "sharp"))
    assert hard is not None
    assert fine.sharp is not None
    assert fine.depth is not None
    image = averaged(fine.sharp, FINE).astype(np.float32)
    camera = scene(texture, lens, size).camera
    exact, _ = error(image, blur_radius(camera, 1 / hard), truth, "keep")
    for way, depth in soft(fine.depth, hard):
        radius = blur_radius(camera, 1 / depth)
        before, largest = error(image, radius, truth, "keep")
        after, still = error(image, by_scene(texture, lens, size, depth, image), truth, "keep")
        yield {
            "textures": texture, "scene": lens, "depth": way, "RMS hard": exact, "RMS as it is": before,
            "RMS assigned": after, "times hard": after / exact, "largest as it is": largest, "largest assigned": still,
        }  # fmt: skip


def by_scene(texture: str, lens: str, size: int, depth: Array, image: Array) -> Array:
    """R of a scene of image and depth, which assigns soft edges."""
    item = {"shape": "depth_map", "texture": image, "depth": depth}
    given = scene(texture, lens, size).replace("object", [item])
    radius = clsco.render_frame(given, truth=("blur_radius",)).blur_radius
    assert radius is not None
    return radius


def error(image: Array, radius: Array, truth: Array, edges: Any) -> tuple[float, float]:
    """RMS and largest error."""
    off = clsco.defocus(image, radius, soft_edges=edges) - truth
    return float(np.sqrt((off**2).mean())), float(np.abs(off).max())


def scene(texture: str, lens: str, size: int, psf: dict[str, Any] | None = None) -> clsco.Scene:
    """The disc before the wall."""
    focus, aperture = LENSES[lens]
    camera = {
        "pixel_pitch": 9.6 / size, "resolution": (size, size), "focal_length": 20.0, "aperture_diameter": aperture,
        "focus_distance": focus,
    }  # fmt: skip
    disc = {"shape": "disc", "center": (0.7, -0.4, NEAR), "radius": 17.0, "texture": painted(texture, 0)}
    wall = {"shape": "plane", "distance": FAR, "texture": painted(texture, 1)}
    return clsco.parse_scene({"camera": camera, "psf": psf or {}, "object": [disc, wall]})


def painted(name: str, number: int) -> Array:
    """The texture of the disc, 0, or the wall, 1."""
    color = np.array(COLORS[number], np.float32)
    if name == "plain":
        return np.broadcast_to(color, (512, 512, 3)).copy()
    if name == "check":
        row, column = np.mgrid[:512, :512] // 20
        return np.where(((row + column) % 2 > 0)[..., None], color, 0.4 * color[::-1])
    rng, scales = np.random.default_rng(number), ((4, 0.25), (16, 0.4), (64, 0.35))
    planes = [share * np.kron(rng.random((512 // s, 512 // s, 3)), np.ones((s, s, 1))) for s, share in scales]
    return np.sum(planes, axis=0).astype(np.float32)


def averaged(image: Array, by: int) -> Array:
    """Means of by x by pixels."""
    rows, columns = (length // by for length in image.shape[:2])
    return np.asarray(image.reshape(rows, by, columns, by, *image.shape[2:]).mean((1, 3), dtype=np.float64))


def soft(fine: Array, hard: Array) -> Iterator[tuple[str, Array]]:
    """Depth maps in mm by their names."""
    yield "averaged", averaged(fine, FINE)
    yield "averaged 1/Z", 1 / averaged(1 / fine.astype(np.float64), FINE)
    for sigma in (0.7, 1.0, 2.0):
        yield f"blurred by {sigma:g} px", gaussian_filter(hard.astype(np.float64), sigma)
    yield "1/Z blurred by 2 px", 1 / gaussian_filter(1 / hard.astype(np.float64), 2.0)
    half, codes = averaged(hard, 2), np.rint(255 * (1 / hard - 0.0025) / 0.005).astype(np.uint8)
    small = np.rint(averaged(codes, 2)).astype(np.uint8)
    for name, how in (("bilinear", Image.Resampling.BILINEAR), ("bicubic", Image.Resampling.BICUBIC)):
        yield f"halved, {name}", enlarged(half.astype(np.float32), how)
        yield f"codes halved, {name}, then JPEG", decoded(jpeg(enlarged(small, how)))
        yield f"codes halved, JPEG, then {name}", decoded(enlarged(jpeg(small), how))
    yield "codes, JPEG", decoded(jpeg(codes))


def enlarged(image: Array, how: Image.Resampling) -> Array:
    """Twice the size."""
    return np.asarray(Image.fromarray(image).resize((2 * image.shape[1], 2 * image.shape[0]), how))


def jpeg(codes: Array) -> Array:
    """Compressed, quality 90."""
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=90)
    return np.asarray(Image.open(file))


def decoded(codes: Array) -> Array:
    """Depth in mm of codes of 1/Z."""
    return 1 / (codes.astype(np.float64) / 255 * 0.005 + 0.0025)


if __name__ == "__main__":
    main()
