"""Random scenes one after the other in one process, in an old version and in this one: images per second, memory,
programs.

    .venv/bin/python benchmarks/speed/random_scenes.py --old OLD/.venv/bin/python --count 1000
All shapes, 1 to 4 objects, both PSFs, 256 x 256 px, depth and blur radius with each; the same scenes in both, each in a
process of its own, with a cache of kernels that is empty at first. The two take turns of some scenes, so that other
work on the machine slows both. "later" leaves the first tenth out.
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
TURN = 50  # scenes
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
        serve()
        return
    pythons = {"old": chosen.old, "new": chosen.new}
    with tempfile.TemporaryDirectory() as cache:
        workers = {name: started(python, f"{cache}/{name}") for name, python in pythons.items() if python is not None}
        turns: dict[str, list[dict[str, float]]] = {name: [] for name in workers}
        for first in range(0, chosen.count, TURN):
            for name, worker in workers.items():
                turns[name].append(asked(worker, first, min(first + TURN, chosen.count)))
        for worker in workers.values():
            worker.communicate()
    print(f"{'':8}{'images/s':>10}{'later':>10}{'CPU s':>9}{'programs':>10}{'build s':>9}{'MiB at 10, 50, 100 %':>24}")
    for name, found in turns.items():
        row(name, found)


def row(name: str, turns: list[dict[str, float]]) -> None:
    """Print what the turns of a version took."""
    total = {key: sum(each[key] for each in turns) for key in ("images", "wall", "cpu", "programs", "build")}
    later = turns[round(0.1 * len(turns)) :]
    rates = [sum(each["images"] for each in some) / sum(each["wall"] for each in some) for some in (turns, later)]
    memory = [turns[max(round(share * len(turns)) - 1, 0)]["memory"] for share in (0.1, 0.5, 1.0)]
    print(
        f"{name:8}{rates[0]:10.2f}{rates[1]:10.2f}{total['cpu']:9.1f}{total['programs']:10.0f}{total['build']:9.1f}"
        f"{memory[0]:8.0f}{memory[1]:8.0f}{memory[2]:8.0f}"
    )


def started(python: Path, cache: str) -> subprocess.Popen[str]:
    """A process of a version, which waits for its turns, with a cache of its own."""
    environ = {k: v for k, v in os.environ.items() if k != "POCL_CACHE_DIR"} | {"XDG_CACHE_HOME": cache}
    Path(cache).mkdir()
    command = [str(python), str(Path(__file__).resolve()), "--worker"]
    return subprocess.Popen(command, env=environ, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def asked(worker: subprocess.Popen[str], first: int, end: int) -> dict[str, float]:
    """Have a worker render some of the scenes."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(f"{first} {end}\n")
    worker.stdin.flush()
    answer: dict[str, float] = json.loads(worker.stdout.readline())
    return answer


def serve() -> None:
    """Render the scenes that lines of standard input number, and print what each turn took as JSON."""
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
    for line in sys.stdin:
        numbers = range(*map(int, line.split()))
        before = time.perf_counter(), time.process_time(), programs[0], spent[0]
        for number in numbers:
            scene = clsco.parse_scene(random_scene(random.Random(number)))
            for _ in clsco.render(scene, truth=["depth", radius]):
                pass
        after = time.perf_counter(), time.process_time(), programs[0], spent[0]
        took = dict(
            zip(("wall", "cpu", "programs", "build"), (b - a for a, b in zip(before, after, strict=True)), strict=True)
        )
        print(json.dumps(took | {"images": len(numbers), "memory": resident()}), flush=True)


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
