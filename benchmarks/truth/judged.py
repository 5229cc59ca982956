"""Judge frames by rays through the real lens: the examples, and scenes in which faults of light would show.

    python -m benchmarks.truth.judged [--only NAME] [--seconds 2] [--size 160]

Of each scene the first frame, the left one of a pair, is compared with rays as `clsco check` does, in float64 where the
device has it. Larger examples have --size pixels along an axis, of the same field of view: R in px is smaller. Figures
go to the terminal, and into the table of benchmarks/results/judged.md, where other scenes keep theirs:
dB of all pixels and of classes, noise of the rays in dB, mean error, deviations beyond 0.01 of white and 5 standard
errors, the worst of them, and the least and largest light around small objects in that by rays.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import clsco
from clsco.plan.prepare import with_resolution
from clsco.scene.model import Scene
from clsco.truth.judge import MOST_RAYS, Judgement, judge
from clsco.truth.problem import make_problem, not_judged

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks/results/judged.md"
SIZE, GRAY, SAND = 96, "#a0a0a0", "#e0c080"

Content = dict[str, Any]


def _scene(*objects: Content, **tables: Any) -> Content:
    """A scene whose R in px is 5000 (1 / 250 - 1 / Z), and 100 mm are 400 px at Z = 250 mm."""
    camera = {"focal_length": 20.0, "aperture_diameter": 10.0, "focus_distance": 250.0, "pixel_pitch": 0.02}
    camera |= {"resolution": [SIZE, SIZE]} | tables.pop("camera", {})
    return {"camera": camera, "object": list(objects), **tables}


def _wall(distance: float = 360.0, texture: Any = GRAY) -> Content:
    return {"shape": "plane", "distance": distance, "texture": texture}


def _card(distance: float = 190.0, **keys: Any) -> Content:
    center = [-1.0, 2.0, distance]
    return {
        "shape": "rectangle",
        "center": center,
        "size": [16.0, 18.0],
        "rotation": [0.0, 0.0, 7.0],
        "texture": SAND,
    } | keys


def _balls(radius_px: float, distance: float = 280.0) -> list[Content]:
    """Nine balls of a radius in px, at as many places in pixels."""
    mm, found = 0.02 * distance / 20.0, []
    for k in range(9):
        column, row = 24 * (k % 3) + 24 + 0.37 * k % 1, 24 * (k // 3) + 24 + 0.61 * k % 1
        center = [mm * (column - 0.5 * (SIZE - 1)), mm * (0.5 * (SIZE - 1) - row), distance]
        found.append({"shape": "sphere", "center": center, "radius": radius_px * mm, "texture": "#ffffff"})
    return found


def _wire(width_px: float, distance: float) -> Content:
    mm = 0.02 * distance / 20.0
    keys = {"center": [0.3 * mm, 0.0, distance], "radius": 0.5 * width_px * mm, "rotation": [0.0, 0.0, 5.0]}
    return {"shape": "cylinder", "texture": "#ffffff", **keys}


def _letter() -> Any:
    """The opening as the letter F."""
    image = np.zeros((64, 64), np.float32)
    image[12:54, 20:28] = image[12:20, 20:46] = image[28:36, 20:40] = 1.0
    return image


def _points() -> Any:
    """Points of light of a pixel."""
    image = np.zeros((SIZE, SIZE), np.float32)
    image[2::5, 3::5] = 1.0
    return image


def _rims(*rims: tuple[float, float]) -> Content:
    return {"aperture": {"rim": [{"distance": distance, "diameter": diameter} for distance, diameter in rims]}}


SCENES: dict[str, Callable[[], Content]] = {
    "aberrated rays, W040 = 10": lambda: _scene(_card(), _wall(), psf={"seidel": {"W040": 10.0}}),
    "aberrated rays, W040 = 2": lambda: _scene(_card(), _wall(), psf={"seidel": {"W040": 2.0}}),
    "rim that clears all, R 3.4": lambda: _scene(_wall(302.0, "#ffffff"), **_rims((16.0, 9.5))),
    "rim that cuts, R 3.2": lambda: _scene(_wall(297.7, "#ffffff"), **_rims((16.0, 8.0))),
    "cat-eye, near card": lambda: _scene(_card(200.0), _wall(300.0), **_rims((16.0, 8.0), (-6.0, 8.5))),
    "letter F, card": lambda: _scene(_card(), _wall(), aperture={"shape": "image", "image": _letter()}),
    "concave blades, card": lambda: _scene(
        _card(225.0), _wall(285.0), aperture={"shape": "polygon", "blades": 5, "blade_curvature": -0.6}
    ),
    "hexagon, card": lambda: _scene(_card(), _wall(), aperture={"shape": "polygon"}),
    "card near the focus, R -1.4": lambda: _scene(_card(233.6), _wall(272.0)),
    "card in focus": lambda: _scene(_card(250.0), _wall(300.0)),
    "distortion below R 2": lambda: _scene(
        _card(240.0, size=[80.0, 90.0]), _wall(262.0, "checkerboard"), lens={"distortion": [-0.3, 0.05, 0.0]},
        camera={"pixel_pitch": 0.15, "aperture_diameter": 40.0},
    ),
    "balls of 0.45 px": lambda: _scene(*_balls(0.45)),
    "balls of 0.8 px in focus": lambda: _scene(*_balls(0.8, 250.0)),
    "balls of 1.5 px before a wall": lambda: _scene(*_balls(1.5), _wall(400.0, "#303030")),
    "cards of 0.2 x 10 px": lambda: _scene(
        {"shape": "rectangle", "center": [1.0444, 2.0, 280.0], "size": [0.056, 2.8], "texture": "#ffffff"},
        {"shape": "rectangle", "center": [-4.01, 0.4844, 280.0], "size": [2.8, 0.056], "texture": "#ffffff"},
    ),
    "wire of 0.4 px": lambda: _scene(_wire(0.4, 280.0)),
    "small spheres, wide lens": lambda: {
        "camera": {"focal_length": 9.0, "aperture_diameter": 5.0, "focus_distance": 10.0, "pixel_pitch": 0.01,
                   "normalization_distance": 90.0, "resolution": [SIZE, SIZE]},
        "object": [
            {"shape": "sphere", "center": [0.001 * k - 0.03, 0.03 - 0.0013 * k, 10.02], "radius": 0.001,
             "texture": "#ffffff"}
            for k in (0, 29.55, 60.3)
        ],
    },
    "distortion alone": lambda: _scene(
        _wall(313.7, _points()), lens={"distortion": [-0.3, 0.05, 0.0]},
        camera={"pixel_pitch": 0.25, "aperture_diameter": 40.0},
    ),
    "field curvature": lambda: _scene(_card(), _wall(), lens={"field_curvature": -0.05}, camera={"pixel_pitch": 0.1}),
    "moving card, triangle": lambda: _scene(
        _card(motion={"velocity": [12.0, 5.0, 0.0]}), _wall(), sequence={"shutter_curve": "triangle"}
    ),
}  # fmt: skip


def examples() -> dict[str, Callable[[], Scene]]:
    """The first scene of each example."""
    found = sorted((ROOT / "examples").glob("*.toml"))
    return {path.stem: lambda path=path: clsco.load_sweep(path).scenes[0] for path in found}  # type: ignore[misc]


def at_most(scene: Scene, size: int) -> Scene:
    """The scene with its field of view in no more pixels along an axis."""
    camera, ratio = scene.camera, max(scene.camera.frame_size) / size
    if ratio <= 1:
        return scene
    resolution = tuple(round(count / ratio) for count in camera.frame_size)
    smaller = {"resolution": resolution, "pixel_pitch": camera.pixel_pitch * ratio}
    return scene.model_copy(update={"camera": camera.model_copy(update=smaller)})


def line_of(name: str, found: Judgement) -> str:
    """Row of the table."""
    if not len(found.right):
        return f"| {name} | not judged: hidden |  |  |  |  |  |  |  |  |"
    classes = {row.name: row for row in found.classes}
    off, pixels = found.got - found.right, len(found.right)
    figures = found.figures
    each = [f"{classes[kind].decibels:.1f}" if kind in classes else "" for kind in ("outline", "focus", "small")]
    beyond = figures["deviations"]
    k, channel = np.unravel_index(int(np.where(found.deviations[:, None], abs(off), -1.0).argmax()), off.shape)
    worst = f"{found.right[k, channel]:.3f}, {found.got[k, channel]:.3f}" if beyond else ""
    shares = [light.got / light.right for light in found.lights if light.right]
    light = f"{min(shares):.2f} to {max(shares):.2f}, {figures['lights_off']} of {len(shares)} off" if shares else ""
    cells = (name, f"{figures['psnr']:.1f}", *each, f"{figures['psnr_noise']:.0f}", f"{figures['mean']:+.4f}",
             f"{beyond} of {pixels}", worst, light)  # fmt: skip
    return f"| {' | '.join(cells)} |"


def rows_before() -> dict[str, str]:
    """Rows of the table by scene, as they are in the results."""
    text = RESULTS.read_text("utf-8") if RESULTS.exists() else ""
    return {line.split(" | ")[0].removeprefix("| "): line for line in text.splitlines() if line.startswith("| ")}


def write(rows: dict[str, str], cost: str) -> None:
    """Write the results."""
    names = ("scene", "dB", "outline", "focus", "small", "noise", "mean", "beyond", "right, got", "light")
    known = [rows[name] for name in (*examples(), *SCENES) if name in rows]
    text = "\n".join([f"| {' | '.join(names)} |", "|---" * len(names) + "|", *known, ""])
    RESULTS.write_text(f"# Frames by rays\n\n`python -m benchmarks.truth.judged`\n\n{text}\n{cost}\n", "utf-8")


def main() -> None:
    """Read the command line, render, trace and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="NAME", help="scenes whose name contains this")
    parser.add_argument("--seconds", type=float, default=3.0, metavar="S", help="of rays for each scene")
    parser.add_argument("--size", type=int, default=160, metavar="N", help="most pixels of examples along an axis")
    options = parser.parse_args()
    made: dict[str, Callable[[], Scene]] = {
        name: lambda content=content: clsco.parse_scene(content()) for name, content in SCENES.items()  # type: ignore[misc]
    }  # fmt: skip
    rows, rays, spent = rows_before(), 0, 0.0
    for name, load in (made | examples()).items():
        if options.only not in name:
            continue
        scene = at_most(with_resolution(load()), options.size).model_copy(update={"sensor": None})
        why = not_judged(scene)
        if why is None:
            frame, began = next(iter(clsco.render(scene))), time.process_time()
            found = judge(make_problem(scene, 0, frame.eye), frame.color, MOST_RAYS, options.seconds)
            rays, spent = rays + found.rays, spent + time.process_time() - began
            rows[name] = line_of(name, found)
        else:
            rows[name] = f"| {name} | not judged: {why.partition(' ')[0]} |  |  |  |  |  |  |  |  |"
        print(rows[name], flush=True)
        write(rows, f"{rays / 1e6:.1f} million rays took {1e9 * spent / max(rays, 1):.0f} ns of processor time each.")


if __name__ == "__main__":
    main()
