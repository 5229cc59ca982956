"""Time and memory of large frames, with a limit of memory: python -m benchmarks.speed.sizes

One gray channel, R from 0 to 20 px at every size, the defaults of the PSF. `render`: a plane tilted in both directions,
rays included; `defocus`: an image and its radii, as arrays, where nothing hides anything; `layered`: the same with near
spots of -20 px before a wavy ground of up to 8 px, whose edges hide what is behind them. Each size in a process of its
own. Time is process CPU time of the second frame, with programs and tables at hand; memory is the most that the process
held at a time (the peak of its resident set), the image, the frame and Python with its libraries among it. `command`:
`clsco render` as a whole, from the texture's pattern to the PNG file; `map`: `clsco defocus`, layered, from an image
and its radii in NPY files to the PNG file.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene

Plane = NDArray[np.float32]
RESULTS = Path(__file__).parents[1] / "results"
LARGEST = 20.0  # px
PARTS = ("render", "defocus", "layered", "command", "map")


def scene_of(size: int, frames: int = 1) -> Scene:
    """The same view at every size, through a lens that blurs it by as many px."""
    return parse_scene(
        {
            "camera": {
                "focal_length": 50.0, "f_number": 8.6 * size / 8192, "focus_distance": 300.0,
                "pixel_pitch": 36.0 / size, "resolution": [size, size],
            },
            "sequence": {"frames": frames},
            "object": [{"shape": "plane", "distance": 305.0, "slope_x": 0.25, "slope_y": 0.1}],
        }
    )  # fmt: skip


def render_frame(size: int, memory: str) -> Callable[[], object]:
    """Make a function that renders one frame more of a scene."""
    frames = clsco.render(scene_of(size, frames=2), truth=(), memory=memory)

    def call() -> dict[str, Any]:
        about = next(frames).metadata
        return {"strips": about["strips"], "kernels_s": sum(about["seconds"].values())}

    return call


def image_and_radii(size: int, spots: bool) -> tuple[Plane, Plane]:
    """An image and its signed radii in px, both (size, size)."""
    image, coc = np.empty((size, size), np.float32), np.empty((size, size), np.float32)
    rng, x = np.random.default_rng(1), np.arange(size) * (8.0 / size)
    for i in range(size):
        image[i] = rng.random(size, np.float32)
        coc[i] = (8.0 if spots else LARGEST) * np.sin(x) * np.cos(x[i])
        if spots:
            coc[i] = np.where(np.sin(5 * x) * np.sin(5 * x[i]) > 0.6, -LARGEST, coc[i])
    return image, coc


def defocus_image(size: int, memory: str, layered: bool = False) -> Callable[[], object]:
    """Make a function that defocuses an image."""
    image, coc = image_and_radii(size, layered)
    return lambda: clsco.defocus(image, coc, {"occlusion": "layered" if layered else "none"}, memory=memory)


def run_map_command(size: int, memory: str) -> Callable[[], object]:
    """Make a function that runs `clsco defocus` on an image and its map of radii."""
    from clsco.cli.main import main

    folder = Path(tempfile.mkdtemp(prefix="clsco-sizes-"))
    for name, plane in zip(("image", "coc"), image_and_radii(size, True), strict=True):
        np.save(folder / f"{name}.npy", plane)
    lens = ["--focal-length", "50", "--f-number", f"{2.0 * size / 8192}", "--focus-distance", "300"]
    args = [
        "defocus",
        str(folder / "image.npy"),
        str(folder / "coc.npy"),
        "-o",
        str(folder / "out.png"),
        "--unit",
        "coc",
    ]
    return lambda: main([*args, *lens, "--pixel-pitch", f"{36.0 / size}", "--memory", memory], standalone_mode=False)


def run_command(size: int, memory: str) -> Callable[[], object]:
    """Make a function that runs `clsco render` on a scene file."""
    from clsco.cli.main import main
    from clsco.scene.changes import dump

    folder = Path(tempfile.mkdtemp(prefix="clsco-sizes-"))
    path = folder / "scene.json"
    path.write_text(json.dumps(dump(scene_of(size))))
    args = ["render", str(path), "-o", str(folder / "out"), "--memory", memory, "--quiet"]
    return lambda: main(args, standalone_mode=False)


def measured(part: str, size: int, memory: str) -> dict[str, Any]:
    """Time of the second call, of commands the only one, and the peak of the process."""
    makers = {"render": render_frame, "defocus": defocus_image, "command": run_command, "map": run_map_command}
    makers["layered"] = partial(defocus_image, layered=True)
    call = makers[part](size, memory)
    if part not in ("command", "map"):
        call()
    wall, cpu = time.perf_counter(), time.process_time()
    result = call()
    seconds = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    about = result if isinstance(result, dict) else {}
    return {"part": part, "size": size, "memory": memory, **seconds, "peak_bytes": peak, **about}


def main() -> None:
    """Measure, print a table, write benchmarks/results/sizes.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs="*", default=[512, 1024, 2048, 4096, 8192])
    parser.add_argument("--memory", default="512MiB")
    parser.add_argument("--part", choices=PARTS, help="measure this alone, at one size, in this process")
    given = parser.parse_args()
    if given.part:
        print(json.dumps(measured(given.part, given.size[0], given.memory)))
        return
    rows = []
    for part in PARTS:
        for size in given.size:
            options = ["--part", part, "--size", str(size), "--memory", given.memory]
            command = [sys.executable, "-m", "benchmarks.speed.sizes", *options]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
    lines = [f"R up to {LARGEST:g} px, gray, `--memory {given.memory}` (`python -m benchmarks.speed.sizes`)", ""]
    lines += ["| | size, px | CPU ns per px | CPU s | wall s | peak MiB |", "|---|---|---|---|---|---|"]
    for row in rows:
        figures = (1e9 * row["cpu_s"] / row["size"] ** 2, row["cpu_s"], row["wall_s"], row["peak_bytes"] / 2**20)
        lines.append(f"| {row['part']} | {row['size']} | " + " | ".join(f"{figure:.4g}" for figure in figures) + " |")
    print("\n".join(lines))
    (RESULTS / "sizes.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
