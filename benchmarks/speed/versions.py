"""Two versions of clsco on one machine, in turn: warm frames, `clsco render` with an empty and a filled cache, and
`clsco plan`.

Run it with the Python of each version; scenes come from a folder that both can read:
    .venv/bin/python benchmarks/speed/versions.py --old OLD/.venv/bin/python --new .venv/bin/python \
        --examples OLD/examples
It prints medians of processor time, of starts of elapsed time as well, and of the ratio new / old, pair by pair.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

SCENES = ("sphere", "occlusion_three", "plane_gaussian", "sphere_turning", "depth_map")
SAMPLES = "sequence.samples=5"  # the default of versions differs


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--old", type=Path, help="Python of the old version")
    parser.add_argument("--new", type=Path, help="Python of the new version")
    parser.add_argument("--examples", type=Path, help="folder of scene files")
    parser.add_argument("--scenes", default=",".join(SCENES), help="names of scenes, separated by commas")
    parser.add_argument("--frames", type=int, default=15, help="warm frames of each scene")
    parser.add_argument("--starts", type=int, default=5, help="starts of the command, with each cache")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.worker:
        serve()
        return
    pythons = (chosen.old, chosen.new)
    paths = {name: chosen.examples / f"{name}.toml" for name in chosen.scenes.split(",")}
    print(f"{'':28}{'old s':>9}{'new s':>9}{'new/old':>9}  lowest, highest")
    for name, path in paths.items():
        row(f"{name}, warm frame", warm_frames(pythons, path, chosen.frames))
    first = next(iter(paths.values()))
    for command, cache in (("render", "empty"), ("render", "filled"), ("plan", "filled")):
        spent, elapsed = starts(pythons, command, first, chosen.starts, cache == "empty")
        row(f"{command} {first.stem}, {cache} cache", spent)
        row(f"{command} {first.stem}, {cache}, elapsed", elapsed)


def row(label: str, pairs: list[tuple[float, float]]) -> None:
    """Print medians of pairs (old, new) in seconds."""
    ratios = [new / old for old, new in pairs]
    old, new = (median(values) for values in zip(*pairs, strict=True))
    spread = f"{min(ratios):.3f}, {max(ratios):.3f}"
    print(f"{label:28}{old:9.4f}{new:9.4f}{median(ratios):9.3f}  {spread}", flush=True)


def warm_frames(pythons: tuple[Path, Path], scene: Path, frames: int) -> list[tuple[float, float]]:
    """Processor time in s of one frame with its ground truth, in both versions by turns; the first two do not count."""
    command = (str(Path(__file__).resolve()), "--worker")
    workers = [
        subprocess.Popen((str(python), *command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for python in pythons
    ]
    found = [tuple(ask(worker, scene) for worker in workers) for _ in range(frames + 2)]
    for worker in workers:
        worker.communicate()
    return [(old, new) for old, new in found[2:]]


def ask(worker: subprocess.Popen[str], scene: Path) -> float:
    """Have a worker render a frame; its processor time in s."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(f"{scene}\n")
    worker.stdin.flush()
    return float(json.loads(worker.stdout.readline()))


def serve() -> None:
    """Render the first frame of each scene that is named on a line of standard input."""
    import clsco

    loaded: dict[str, Any] = {}
    for line in sys.stdin:
        path = line.strip()
        if path not in loaded:
            loaded[path] = clsco.load_scene(path, [SAMPLES])
        before = time.process_time()
        for _ in clsco.render(loaded[path], frames=[0]):
            pass
        print(json.dumps(time.process_time() - before), flush=True)


Pairs = list[tuple[float, float]]


def starts(pythons: tuple[Path, Path], command: str, scene: Path, count: int, empty: bool) -> tuple[Pairs, Pairs]:
    """Processor time and elapsed time in s of a command from its start to its end, in both versions by turns."""
    with tempfile.TemporaryDirectory() as base:
        found = []
        for turn in range(count + (not empty)):
            caches = [Path(base) / f"{version}{turn * empty}" for version in range(2)]
            found.append(
                [started(python, command, scene, cache) for python, cache in zip(pythons, caches, strict=True)]
            )
    kept = found[not empty :]
    return [(old[0], new[0]) for old, new in kept], [(old[1], new[1]) for old, new in kept]


def started(python: Path, command: str, scene: Path, cache: Path) -> tuple[float, float]:
    """Processor time and elapsed time in s of one `clsco render` or `clsco plan` beside this Python, with its cache of
    kernels in a folder."""
    cache.mkdir(exist_ok=True)
    environ = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    words = [command, str(scene), "--set", SAMPLES]
    if command == "render":
        words += ["-o", str(cache / "out"), "--frames", "0:1", "--quiet"]
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [str(python.parent / "clsco"), *words], check=True, env=environ | {"XDG_CACHE_HOME": str(cache)},
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    after, elapsed = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - begun
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, elapsed


if __name__ == "__main__":
    main()
