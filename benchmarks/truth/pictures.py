"""Pictures with depth against Blender: errors of `clsco.defocus` and of Blender's Defocus node.

    python -m benchmarks.truth.pictures DIR [--checkout PATH] [--scenes garden,table] [--blurs 12,25] [--write]

DIR holds what `blender_scenes.py` made; Blender is not needed. `--checkout` measures the clsco of another checkout,
`--write` writes benchmarks/results/pictures.md. Errors are PSNR in dB of the whole picture / within 12 px of depth
discontinuities, where R changes by more than 1 px / of the rest. A mean squared error is that of (x - a)(x - b), a and
b being two independent pictures by Cycles, so that it has no share of their noise.

Pictures are `hard`, by one ray per pixel, and `filtered`, by Blender's default filter with its depths; that one also
with 1/Z `averaged` over each pixel, and with this by a Gaussian of 1.5 px, `soft`. `keep` is soft_edges="keep"; `over`
lays the foreground over the rest, each blurred alone, `layers` gives both to one call, in versions that can; `node` is
Blender's Defocus node; `white` has the extremes of a picture of ones, by hard and by averaged depths.
"""

from __future__ import annotations

import argparse
import inspect
import math
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from benchmarks.tables import write_table

RESULTS = Path(__file__).resolve().parents[1] / "results" / "pictures.md"
Array = NDArray[Any]
BAND, SOFT, DISC, FINE = 12, 1.5, 128, 16  # px, px, px, points per pixel and axis


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--checkout", default="", help="measure the clsco of another checkout")
    parser.add_argument("--scenes", default="garden,fence,table")
    parser.add_argument("--blurs", default="5,12,25", help="largest |R| in px")
    parser.add_argument("--write", action="store_true")
    chosen = parser.parse_args()
    if chosen.checkout:
        sys.path.insert(0, chosen.checkout)
    defocus = import_module("clsco").defocus
    rows = []
    for scene in chosen.scenes.split(","):
        data = dict(np.load(chosen.folder / f"{scene}.npz", allow_pickle=False))
        for blur in (blur for blur in chosen.blurs.split(",") if f"truth_{blur}" in data):
            rows.append({"scene": scene, "R": blur, **dict(figures(defocus, data, blur))})
            print("\n".join(f"{name:>16} {value}" for name, value in rows[-1].items()), flush=True)
    discs = "; ".join(red_discs(defocus))
    print(discs)
    if chosen.write:
        write_table(RESULTS, f"`python -m benchmarks.truth.pictures`, 384 x 384 px. A red disc: {discs}", rows)


def figures(defocus: Any, data: Mapping[str, Array], blur: str) -> Iterator[tuple[str, str]]:
    """Errors of a scene with one aperture, by column."""

    def radius(name: str) -> Array:
        return np.asarray(data[f"blur_scale_{blur}"] * (data["focus"] - data[name]))

    def error(image: Array) -> str:
        squared = (image - first) * (image - second)
        return " / ".join(decibels(squared[region].mean()) for region in (band | ~band, band, ~band))

    hard, averaged = radius("inverse_depth"), radius("inverse_depth_averaged")
    first, second = data[f"truth_{blur}"].astype(float)
    steps = [np.abs(np.diff(hard, axis=axis, append=np.take(hard, [-1], axis))) > 1.0 for axis in (0, 1)]
    band = distance_transform_edt(~(steps[0] | steps[1])) <= BAND
    yield "noise of truth", decibels(np.mean((first - second) ** 2) / 4.0)
    yield "band", f"{100 * band.mean():.0f} %"
    picture, filtered = data["picture"], data["filtered"]
    options = inspect.signature(defocus).parameters
    yield "hard", error(defocus(picture, hard))
    yield "filtered", error(defocus(filtered, radius("inverse_depth_filtered")))
    yield "averaged", error(defocus(filtered, averaged))
    yield "soft", error(defocus(filtered, gaussian_filter(averaged, SOFT, mode="nearest")))
    if "soft_edges" in options:
        yield "hard, keep", error(defocus(picture, hard, soft_edges="keep"))
        yield "averaged, keep", error(defocus(filtered, averaged, soft_edges="keep"))
    covered = distance_transform_edt(data["front"][..., 3] == 0.0, return_distances=False, return_indices=True)
    radii = (radius("front_inverse_depth")[tuple(covered)], radius("back_inverse_depth"))
    for kind, comment in (("", ""), ("_filtered", ", filtered")):
        back = np.concatenate([data[f"back{kind}"], np.ones((*hard.shape, 1), np.float32)], axis=2)
        layers = list(zip((data[f"front{kind}"], back), radii, strict=True))
        near, far = (defocus(image, blur_radius) for image, blur_radius in layers)
        yield f"over{comment}", error(near[..., :3] + (1.0 - near[..., 3:]) * far[..., :3])
        if "layers" in options:
            yield f"layers{comment}", error(defocus(layers=layers)[..., :3])
        yield f"node{comment}", error(data[f"node{kind}_{blur}"])
    for name, blur_radius in (("white", hard), ("white, averaged", averaged)):
        white = defocus(np.ones(hard.shape, np.float32), blur_radius)
        yield name, f"{white.min():.4g} to {white.max():.4g}"


def decibels(squared: float) -> str:
    """PSNR of radiance 1."""
    return f"{-10.0 * math.log10(squared):.1f}" if squared > 0.0 else ""


def red_discs(defocus: Any) -> Iterator[str]:
    """Largest errors of a red disc before a gray wall, and numbers of pixels that are off by more than 0.02."""

    def inside(row: Array, column: Array) -> Array:
        return ((column - 63.3) ** 2 + (row - 64.2) ** 2 < 34.4**2) * 1.0

    fine = inside(*((np.mgrid[: DISC * FINE, : DISC * FINE] + 0.5) / FINE - 0.5))
    share, hard = fine.reshape(DISC, FINE, DISC, FINE).mean((1, 3)), inside(*np.mgrid[:DISC, :DISC])

    def painted(mask: Array) -> Array:
        return mask[..., None] * [0.8, 0.05, 0.05] + (1.0 - mask[..., None]) * [0.4, 0.45, 0.5]

    for name, near, far in (("sharp, wall of R 8", 0.0, 8.0), ("R -8, sharp wall", -8.0, 0.0)):
        truth = painted(defocus(share.astype(np.float32), np.full((DISC, DISC), near)) if near else share)
        for kind, mask in (("hard", hard), ("averaged", share)):
            off = np.abs(defocus(painted(share).astype(np.float32), mask * near + (1.0 - mask) * far) - truth).max(-1)
            yield f"{name}, {kind} depth: off by {off.max():.3f}, {(off > 0.02).sum()} px"


if __name__ == "__main__":
    main()
