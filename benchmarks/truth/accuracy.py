"""Error of a rendered frame per setting, against the thin-lens ray tracer.

    python -m benchmarks.truth.accuracy [--only NAME] [--setting NAME] [--size 512] [--engine device|reference]

Every scene is traced once (kept under build/) and rendered with each setting; a table per scene goes to the
terminal and all figures to benchmarks/results/accuracy.json and accuracy.md. PSNR has the peak 1.0, white;
the figure `inside` is that of the pixels more than 16 px within the silhouette at all times of the exposure.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Mapping
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

ROOT = Path(__file__).resolve().parents[1]
FULL_SIZE = 512
INSIDE_PX = 16
NOISE = 1e-4
TIME_SAMPLES = 9

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]
Render = Callable[[Any], Iterable[Any]]
Options = Mapping[str, Any]


def _card(distance: float, shift_px: float) -> dict[str, Any]:
    """A plane across the axis that moves by `shift_px` px of a 512 px frame in a second."""
    return {
        "shape": "plane",
        "distance": distance,
        "motion": {"velocity": [shift_px * 0.01 * distance / 20, 0.0, 0.0]},
    }


BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0}
SCENES: dict[str, dict[str, Any]] = {
    "sphere": BALL,
    "cylinder": {"shape": "cylinder", "center": [0.0, 0.0, 280.0], "radius": 30.0, "axis": [0.0, 1.0, 0.0]},
    "ellipsoid": {"shape": "ellipsoid", "center": [0.0, 0.0, 280.0], "semi_axes": [40.0, 25.0, 30.0]},
    "cone": {"shape": "cone", "apex": [0.0, 0.0, 250.0], "half_angle": 50.0},
    "plane_b1.5": {"shape": "plane", "distance": 250.0, "slope_x": 1.5},
    "plane_b1_c1": {"shape": "plane", "distance": 250.0, "slope_x": 1.0, "slope_y": 1.0},
    "plane_moving_250": _card(250.0, 17.0),
    "plane_moving_240": _card(240.0, 17.0),
    "sphere_turning": {**BALL, "motion": {"angular_velocity": [0.0, 10.0, 0.0]}},
    "sphere_moving_turning": {
        **BALL,
        "motion": {"velocity": [2.0, 1.0, 3.0], "angular_velocity": [0.0, 10.0, 5.0]},
    },
    "sphere_accelerated": {
        **BALL,
        "motion": {
            "velocity": [-1.0, 1.0, 0.0],
            "acceleration": [6.0, -2.0, 8.0],
            "angular_acceleration": [0.0, 20.0, 8.0],
        },
    },
    "sphere_spinning": {**BALL, "motion": {"angular_velocity": [0.0, 0.0, 60.0]}},
    "sphere_shaken": BALL,
    # Behind the focus: a zoom moves points near its middle little, where texels in focus look as they are interpolated.
    "sphere_zoom": {"shape": "sphere", "center": [4.0, 3.0, 290.0], "radius": 24.0},
}
SHAKEN = {"shake": {"rotation_rms": 0.2, "translation_rms": 0.1, "band": [0.5, 3.0], "seed": 2}}
ZOOM = {"keyframe": [{"time": 0.0, "focal_length": 20.0}, {"time": 1.0, "focal_length": 21.0}]}

PLAIN = {"tilt": False, "silhouette_samples": 1}
SETTINGS: dict[str, dict[str, Any]] = {
    "thesis": {
        "psf": {"edge": "sampled", **PLAIN, "occlusion": "none"},
        "sequence": {"samples": 5, "sampling": "endpoint"},
        "motion": {"warp": "forward"},
        "fill": {"domain": "span"},
    },
    "sampled, no tilt, no silhouettes": {"psf": {"edge": "sampled", **PLAIN}},
    "area, no tilt, no silhouettes": {"psf": {"edge": "area", **PLAIN}},
    "integrated, no tilt, no silhouettes": {"psf": PLAIN},
    "defaults": {},
    "edge sampled": {"psf": {"edge": "sampled"}},
    "edge area": {"psf": {"edge": "area"}},
    "no tilt": {"psf": {"tilt": False}},
    "no silhouettes": {"psf": {"silhouette_samples": 1}},
    "silhouettes 2": {"psf": {"silhouette_samples": 2}},
    "no occlusion": {"psf": {"occlusion": "none"}},
    "gaussian 0.62": {"psf": {"model": "gaussian", "sigma_ratio": 0.62}},
    "gaussian 0.65": {"psf": {"model": "gaussian", "sigma_ratio": 0.65}},
    "gaussian 0.7071": {"psf": {"model": "gaussian"}},
}
MOVING_SETTINGS: dict[str, dict[str, Any]] = {
    "endpoint": {"sequence": {"sampling": "endpoint"}},
    "5 samples": {"sequence": {"samples": 5}},
    "bilinear": {"motion": {"texture_filter": "bilinear"}},
    "51 samples": {"sequence": {"samples": 51}},
    "51 samples, bilinear": {"sequence": {"samples": 51}, "motion": {"texture_filter": "bilinear"}},
    "nearest": {"motion": {"texture_filter": "nearest"}},
    "forward": {"motion": {"warp": "forward"}},
}


@dataclass(frozen=True)
class Figures:
    """Error of one rendered frame: PSNR in dB, whole and inside; largest error; seconds to render."""

    psnr: float
    psnr_inside: float
    largest: float
    seconds: float


@dataclass(frozen=True)
class Judged:
    """The truth of a scene: the traced image, the pixels well inside it, and its RMS noise there."""

    image: Array
    inside: Mask
    noise: float
    noise_inside: float


def scene_of(name: str, settings: Options, size: int) -> Any:
    """The scene `name` with `settings`, size x size px; field of view and blur radii in px as at 512 px."""
    item = SCENES[name]
    ratio = FULL_SIZE / size
    camera = {"resolution": [size, size], "pixel_pitch": 0.01 * ratio, "aperture_diameter": 10.0 * ratio}
    camera |= SHAKEN if name == "sphere_shaken" else {}
    lens = {"lens": ZOOM} if name == "sphere_zoom" else {}
    return clsco.parse_scene({"camera": camera, "object": [{**item, "texture": "bricks"}], **lens, **settings})


def moves(name: str) -> bool:
    """True if the object or the camera of the scene `name` moves, or its lens zooms."""
    return "motion" in SCENES[name] or name in ("sphere_shaken", "sphere_zoom")


def settings_of(name: str) -> dict[str, dict[str, Any]]:
    """The settings that make a difference to the scene `name`."""
    return {**SETTINGS, **(MOVING_SETTINGS if moves(name) else {})}


def well_inside(seen: Mask, margin: float = INSIDE_PX) -> Mask:
    """Pixels more than `margin` px from any not in `seen` (rows, columns); beyond the frame there is none."""
    return seen if seen.all() else ndimage.distance_transform_edt(seen) > margin


def judge(name: str, size: int, noise: float, cache: Path | None) -> Judged:
    """Trace the scene `name`, size x size px, to the RMS `noise`."""
    scene = scene_of(name, {}, size)
    image, error = traced(scene, noise, cache)
    _, depth = pinhole_view(scene, np.linspace(0.0, 1.0, TIME_SAMPLES).tolist())
    inside = well_inside(np.asarray(np.isfinite(depth).all(axis=0)))
    return Judged(image, inside, rms(error), rms(error[inside]))


def compare(color: NDArray[Any], judged: Judged, seconds: float) -> Figures:
    """Figures of a rendered image (rows, columns[, channels]), linear."""
    difference = np.asarray(color, float) - judged.image
    whole, inside = decibels(rms(difference)), decibels(rms(difference[judged.inside]))
    return Figures(whole, inside, float(abs(difference).max()), seconds)


def measure(name: str, settings: Options, size: int, judged: Judged, render: Render) -> Figures:
    """Render the scene `name` with `settings` and compare its first frame with the traced one."""
    scene = scene_of(name, settings, size)
    began = time.perf_counter()
    frame = next(iter(render(scene)))
    return compare(frame.color, judged, time.perf_counter() - began)


def show(console: Console, name: str, result: Mapping[str, Any]) -> None:
    """Print the table of one scene."""
    table = Table(title=f"{name}: PSNR in dB against the tracer")
    table.add_column("setting")
    for title in ("whole", "inside", "largest error", "s"):
        table.add_column(title, justify="right")
    for setting, row in result["settings"].items():
        cells = (f"{row['psnr']:.1f}", f"{row['psnr_inside']:.1f}", f"{row['largest']:.4f}")
        table.add_row(setting, *cells, f"{row['seconds']:.2f}")
    table.add_section()
    table.add_row("the tracer's noise", *(f"{decibels(result[key]):.1f}" for key in ("noise", "noise_inside")))
    console.print(table)


def markdown(report: Mapping[str, Any]) -> str:
    """The report as Markdown: settings by scenes, whole frame / inside, in dB."""
    scenes, size = report["scenes"], report["size"]
    lines = [
        "# Error per setting",
        "",
        f"PSNR in dB (peak 1.0) against the ray-traced thin lens, {size} x {size} px, texture `bricks`:",
        f"whole frame / more than {INSIDE_PX} px inside the silhouette. Engine: {report['engine']}.",
        "",
        f"| setting | {' | '.join(scenes)} |",
        f"|---|{'---|' * len(scenes)}",
    ]
    for setting in {**SETTINGS, **MOVING_SETTINGS}:
        rows = [scene["settings"].get(setting) for scene in scenes.values()]
        if any(rows):
            cells = ["" if row is None else f"{row['psnr']:.1f} / {row['psnr_inside']:.1f}" for row in rows]
            lines.append(f"| {setting} | {' | '.join(cells)} |")
    noises = ((decibels(scene["noise"]), decibels(scene["noise_inside"])) for scene in scenes.values())
    floors = [f"{whole:.1f} / {inside:.1f}" for whole, inside in noises]
    return "\n".join([*lines, f"| the tracer's noise | {' | '.join(floors)} |", ""])


def main() -> None:
    """Read the command line, measure, print and write."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--only", default="", metavar="NAME", help="scenes whose name contains this")
    parser.add_argument("--setting", default="", metavar="NAME", help="settings whose name contains this")
    parser.add_argument("--size", type=int, default=FULL_SIZE, metavar="N", help="frame of N x N px")
    parser.add_argument("--engine", choices=("device", "reference"), default="device")
    parser.add_argument("--noise", type=float, default=NOISE, help="RMS noise of the traced images")
    parser.add_argument("--cache", type=Path, default=ROOT.parent / "build" / "traced")
    parser.add_argument("-o", type=Path, default=ROOT / "results", dest="folder", metavar="DIR")
    options = parser.parse_args()
    render: Render = clsco.reference.render if options.engine == "reference" else clsco.render
    console = Console()
    for name in (name for name in SCENES if options.only in name):
        judged = judge(name, options.size, options.noise, options.cache)
        rows = {}
        for setting, keys in settings_of(name).items():
            if options.setting in setting:
                rows[setting] = asdict(measure(name, keys, options.size, judged, render))
        noises = {"noise": judged.noise, "noise_inside": judged.noise_inside}
        result = {**noises, "inside_pixels": int(judged.inside.sum()), "settings": rows}
        show(console, name, result)
        report = {"size": options.size, "engine": options.engine, "scenes": {name: result}}
        update(options.folder / "accuracy.json", report, SCENES, markdown)


if __name__ == "__main__":
    main()
