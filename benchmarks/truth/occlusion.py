"""Blurred edges of near things before far ones: error and cost of each psf.occlusion, against the ray tracer.

    python -m benchmarks.truth.occlusion [--only NAME] [--mode NAME] [--size 512] [--engine device|reference]

The scenes are examples/occlusion_*.toml, and examples/sphere.toml, where nothing overlaps. Each is traced to two
independent pictures a and b (kept under build/) and rendered in each mode; figures go to the terminal and to
benchmarks/results/occlusion.json and occlusion.md. A mean squared error is that of (x - a)(x - b), so that it has no
share of their noise, and at least its standard error; PSNR has the peak 1.0, white. An occlusion edge runs between
neighboring pixel centers with different visible objects, or depths that differ by more than 2 %, at any of nine times
in the exposure. The cost is the time of the device's passes without ground truth, the least of some repetitions that
take turns with other modes.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy import ndimage

import clsco
from benchmarks.truth.traced import decibels, pinhole_view, rms, traced, update
from clsco.files.images import write_png
from clsco.files.transfer import encode

ROOT = Path(__file__).resolve().parents[1]
FULL_SIZE = 512
EXAMPLES = {
    "near_sphere": "occlusion_near_sphere",
    "sharp_near": "occlusion_sharp_near",
    "sharp_far": "occlusion_sharp_far",
    "three": "occlusion_three",
    "ground": "occlusion_ground",
    "interpenetrating": "occlusion_interpenetrating",
    "passing": "occlusion_passing",
    "card": "occlusion_card",
    "wire": "occlusion_wire",
    "tube": "occlusion_tube",
    "alone": "sphere",
}
MODES = ("none", "layered", "visibility")
EDGE_PX = 32
DEPTH_STEP = 0.02
NOISE = 2e-3  # of one traced picture
TIME_SAMPLES = 9
REPETITIONS = 3
ERROR_GAIN = 10.0  # of the pictures of errors, about gray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Render = Callable[[Any], Iterable[Any]]


@dataclass(frozen=True)
class Figures:
    """PSNR in dB, whole frame and near the edges; largest error; seconds of the passes of one frame."""

    psnr: float
    psnr_edges: float
    largest: float
    seconds: float


@dataclass(frozen=True)
class Judged:
    """The truth of a scene: two traced images, the pixels near its edges, and the RMS noise of one, also there."""

    image: Array
    other: Array
    edges: Mask
    noise: float
    noise_edges: float


def scene_of(name: str, mode: str, size: int) -> Any:
    """The scene `name` in a mode, size x size px; field of view and blur radii in px as at 512 px."""
    ratio = FULL_SIZE / size
    settings = (
        f"camera.resolution=[{size}, {size}]",
        f"camera.pixel_pitch={0.01 * ratio}",
        f"camera.aperture_diameter={10.0 * ratio}",
        f"psf.occlusion={mode}",
    )
    return clsco.load_scene(ROOT.parent / "examples" / f"{EXAMPLES[name]}.toml", settings)


def near_edges(objects: NDArray[np.int64], depth: Array, px: int = EDGE_PX) -> Mask:
    """Pixels within `px` px, by row and column, of one beside an occlusion edge at any time sample.

    `objects`, `depth`: (times, rows, columns), as of `pinhole_view`.
    """
    inverse = 1 / depth
    beside = np.zeros(objects.shape, np.bool_)
    for axis in (1, 2):
        first, second = (np.s_[:, :-1], np.s_[:, 1:]) if axis == 1 else (np.s_[:, :, :-1], np.s_[:, :, 1:])
        step = abs(inverse[second] - inverse[first]) > DEPTH_STEP * np.maximum(inverse[second], inverse[first])
        edge = step | (objects[second] != objects[first])
        beside[first] |= edge
        beside[second] |= edge
    return np.asarray(ndimage.maximum_filter(beside.any(axis=0), size=2 * px + 1))


def judge(name: str, size: int, noise: float, cache: Path | None) -> Judged:
    """Trace the scene `name`, size x size px, to the RMS `noise`."""
    scene = scene_of(name, "none", size)
    (image, error), (other, _) = (traced(scene, noise, cache, seed=seed) for seed in range(2))
    edges = near_edges(*pinhole_view(scene, np.linspace(0.0, 1.0, TIME_SAMPLES if scene.moves else 1).tolist()))
    return Judged(image, other, edges, rms(error), rms(error[edges]))


def render_modes(scenes: Mapping[str, Any], render: Render, repetitions: int) -> dict[str, tuple[Array, float, str]]:
    """First frame of each scene, in turns: the image, least seconds in the device's passes, and the device.

    Without a device (the reference) the seconds are those of the whole call.
    """
    found: dict[str, tuple[Array, float, str]] = {}
    for _ in range(repetitions):
        for mode, scene in scenes.items():
            began = time.perf_counter()
            frame = next(iter(render(scene)))
            passes = frame.metadata.get("seconds")
            seconds = sum(passes.values()) if passes else time.perf_counter() - began
            least = min(seconds, found[mode][1] if mode in found else math.inf)
            found[mode] = np.asarray(frame.color, float), least, frame.metadata.get("device", "NumPy")
    return found


def compare(image: Array, judged: Judged, seconds: float) -> Figures:
    """Figures of a rendered image (rows, columns[, channels]), linear."""
    squares = (image - judged.image) * (image - judged.other)
    parts = squares, squares[judged.edges]
    whole, edges = (decibels(math.sqrt(max(part.mean(), part.std() / math.sqrt(part.size)))) for part in parts)
    return Figures(whole, edges, float(abs(image - 0.5 * (judged.image + judged.other)).max()), seconds)


def picture(judged: Judged, images: Sequence[Array]) -> NDArray[Any]:
    """The traced image and, for each of `images`, it above its error, as sRGB codes (2 rows, columns ...)."""
    errors = [0.5 + ERROR_GAIN * (image - judged.image) for image in images]
    blank = np.full_like(judged.image, 0.5)
    blank[judged.edges] = judged.image[judged.edges]
    top, below = np.concatenate([judged.image, *images], axis=1), np.concatenate([blank, *errors], axis=1)
    return np.concatenate([encode(top, 8, "srgb"), encode(below, 8, "linear")])


def cells(row: Mapping[str, float], plain: Mapping[str, float] | None) -> list[str]:
    """PSNR whole / near edges, and the cost: seconds, or how many times that of plain scattering."""
    ratio = f"{row['seconds'] / plain['seconds']:.2f}x" if plain and row is not plain else f"{row['seconds']:.3f} s"
    return [f"{row['psnr']:.1f} / {row['psnr_edges']:.1f}", ratio]


def show(console: Console, name: str, result: Mapping[str, Any]) -> None:
    """Print the table of one scene."""
    table = Table(title=f"{name}: PSNR in dB against the tracer")
    table.add_column("occlusion")
    for title in ("whole / edges", "cost"):
        table.add_column(title, justify="right")
    rows = result["settings"]
    for mode, row in rows.items():
        table.add_row(mode, *cells(row, rows.get("none")))
    table.add_section()
    table.add_row("the tracer's noise", f"{decibels(result['noise']):.1f} / {decibels(result['noise_edges']):.1f}", "")
    console.print(table)


def markdown(report: Mapping[str, Any]) -> str:
    """The report as Markdown: scenes by modes."""
    lines = [
        "# Blurred edges of near things before far ones",
        "",
        f"PSNR in dB (peak 1.0) against the ray-traced thin lens, {report['size']} x {report['size']} px: whole",
        f"frame / within {EDGE_PX} px of an occlusion edge. Errors have no share of the noise.",
        "Cost: all passes of a frame without ground truth, in seconds for `none`, for the others relative to it. The",
        "scenes are `examples/occlusion_*.toml`; `alone` is",
        f"`examples/sphere.toml`, where nothing overlaps. Device: {report['device']}.",
        "",
        f"| scene | the tracer's noise | {' | '.join(f'`{mode}` | cost' for mode in MODES)} |",
        f"|---|---|{'---|---|' * len(MODES)}",
    ]
    for name, scene in report["scenes"].items():
        rows = scene["settings"]
        entries = [f"{decibels(scene['noise']):.1f} / {decibels(scene['noise_edges']):.1f}"]
        for mode in MODES:
            entries += cells(rows[mode], rows.get("none")) if mode in rows else ["", ""]
        lines.append(f"| {name} | {' | '.join(entries)} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Read the command line, trace, render, print and write."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--only", default="", metavar="NAME", help="scenes whose name contains this")
    parser.add_argument("--mode", default="", metavar="NAME", help="modes whose name contains this")
    parser.add_argument("--size", type=int, default=FULL_SIZE, metavar="N", help="frame of N x N px")
    parser.add_argument("--engine", choices=("device", "reference"), default="device")
    parser.add_argument("--noise", type=float, default=NOISE, help="RMS noise of the traced images")
    parser.add_argument("--repetitions", type=int, default=REPETITIONS, metavar="N", help="of each rendering")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="also write images, and errors times 10")
    parser.add_argument("--cache", type=Path, default=ROOT.parent / "build" / "traced")
    parser.add_argument("-o", type=Path, default=ROOT / "results", dest="folder", metavar="DIR")
    options = parser.parse_args()

    def render(scene: Any) -> Iterable[Any]:
        return clsco.reference.render(scene) if options.engine == "reference" else clsco.render(scene, truth=())

    console = Console()
    for name in (name for name in EXAMPLES if options.only in name):
        judged = judge(name, options.size, options.noise, options.cache)
        scenes = {mode: scene_of(name, mode, options.size) for mode in MODES if options.mode in mode}
        found = render_modes(scenes, render, options.repetitions)
        rows = {mode: asdict(compare(image, judged, seconds)) for mode, (image, seconds, _) in found.items()}
        noises = {"noise": judged.noise, "noise_edges": judged.noise_edges}
        result = {**noises, "edge_pixels": int(judged.edges.sum()), "settings": rows}
        show(console, name, result)
        device = next((device for _, _, device in found.values()), "")
        report = {"size": options.size, "device": device, "scenes": {name: result}}
        update(options.folder / "occlusion.json", report, EXAMPLES, markdown)
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
            images = [image for image, _, _ in found.values()]
            write_png(options.pictures / f"{name}.png", picture(judged, images))


if __name__ == "__main__":
    main()
