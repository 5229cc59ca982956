"""Random scenes one after the other in one process, in an old version and in this one: images per second, memory,
programs.

    .venv/bin/python benchmarks/speed/random_scenes.py --old OLD/.venv/bin/python --count 1000
All shapes, 1 to 4 objects, both PSFs, 256 x 256 px, depth and blur radius with each; the same scenes in both, each in a
process of its own, with a cache of kernels that is empty at first. "later" leaves the first tenth out.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

SIDE = 256
TEXTURES = ("bricks", "checkerboard", "slanted_edge", "siemens_star")


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--old", type=Path, help="Python of the old version; without it this one alone")
    parser.add_argument("--new", type=Path, default=Path(sys.executable), help="Python of the new version")
    parser.add_argument("--count", type=int, default=1000, help="number of scenes")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.worker:
        work(chosen.count)
        return
    print(
        f"{'':8}{'images/s':>10}{'later':>10}{'CPU s':>9}{'programs':>10}{'build s':>9}{'MiB at 10 %':>13}{'at end':>8}"
    )
    for name, python in (("old", chosen.old), ("new", chosen.new)):
        if python is not None:
            with tempfile.TemporaryDirectory() as cache:
                environ = {k: v for k, v in os.environ.items() if k != "POCL_CACHE_DIR"} | {"XDG_CACHE_HOME": cache}
                command = [str(python), str(Path(__file__).resolve()), "--worker", "--count", str(chosen.count)]
                done = subprocess.run(command, env=environ, check=True, stdout=subprocess.PIPE, text=True)
            found = json.loads(done.stdout.splitlines()[-1])
            print(
                f"{name:8}{found['per_s']:10.2f}{found['later']:10.2f}{found['cpu']:9.1f}{found['programs']:10}"
                f"{found['build']:9.1f}{found['early']:13.0f}{found['end']:8.0f}",
                flush=True,
            )


def work(count: int) -> None:
    """Render the scenes, and print what it took as JSON."""
    import pyopencl as cl

    import clsco

    spent, programs, build = [0.0], [0], cl.Program.build

    def timed(self: Any, *args: Any, **options: Any) -> Any:
        before = time.perf_counter()
        found = build(self, *args, **options)
        spent[0] += time.perf_counter() - before
        programs[0] += 1
        return found

    cl.Program.build = timed  # type: ignore[method-assign]
    radius = "blur_radius" if hasattr(clsco, "render_frame") else "coc"
    begun, cpu, times, memory = time.perf_counter(), time.process_time(), [0.0], [0.0]
    for number in range(count):
        scene = clsco.parse_scene(random_scene(random.Random(number)))
        for _ in clsco.render(scene, truth=["depth", radius]):
            pass
        times.append(time.perf_counter() - begun)
        memory.append(resident())
    tenth = max(count // 10, 1)
    print(
        json.dumps(
            {
                "per_s": count / times[-1], "later": (count - tenth) / (times[-1] - times[tenth]),
                "cpu": time.process_time() - cpu, "programs": programs[0], "build": spent[0],
                "early": memory[tenth], "end": memory[-1],
            }
        )
    )  # fmt: skip


def resident() -> float:
    """Memory of this process in MiB."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def random_scene(rng: random.Random) -> dict[str, Any]:
    """Content of a scene file."""
    camera = {
        "resolution": [SIDE, SIDE], "pixel_pitch": 0.02, "f_number": rng.choice([1.4, 2.0, 2.8, 4.0]),
        "focus_distance": rng.uniform(240.0, 340.0),
    }  # fmt: skip
    model = rng.choice(["pillbox", "gaussian"])
    objects = [random_object(rng) for _ in range(rng.randint(1, 4))]
    return {"camera": camera, "psf": {"model": model}, "object": objects}


def random_object(rng: random.Random) -> dict[str, Any]:
    """One of all shapes, somewhere before the camera."""
    near, around = rng.uniform(250.0, 340.0), rng.uniform(8.0, 30.0)
    slope, part = rng.uniform(-0.5, 0.5), rng.uniform(0.5, 1.5)
    center = [rng.uniform(-20.0, 20.0), rng.uniform(-20.0, 20.0), near]
    shapes: list[dict[str, Any]] = [
        {"shape": "plane", "distance": near + 40.0, "slope_x": slope, "slope_y": slope * part},
        {"shape": "sphere", "center": center, "radius": around},
        {"shape": "cylinder", "center": center, "radius": around, "axis": [0.0, 1.0, 0.5 * slope]},
        {"shape": "cone", "apex": center, "half_angle": rng.uniform(20.0, 60.0)},
        {"shape": "ellipsoid", "center": center, "semi_axes": [around, around * part, around]},
        {
            "shape": "quadric", "center": center, "bounds": [[-30.0, 30.0], [-30.0, 30.0], [-30.0, 30.0]],
            "coefficients": [1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -rng.uniform(20.0, 60.0), 0.0],
        },
    ]  # fmt: skip
    return rng.choice(shapes) | {"texture": rng.choice(TEXTURES)}


if __name__ == "__main__":
    main()
