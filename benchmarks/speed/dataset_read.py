"""Formats of data sets: bytes on the disk, and rates of writing and of reading from the page cache.

Run it in a checkout, with a device that renders, and the extra `data`:
    .venv/bin/python benchmarks/speed/dataset_read.py [--samples 64] [--size 512] [--only hdf5] [-o FILE]
A sample has color, sharp, depth, coc, flow and mask of a textured sphere before a plane. Rates
are bytes of the arrays in memory per second of one process: reading all of them in order, at random, and depth alone.
The best of three.
"""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import clsco
from clsco.data.containers import CONTAINERS, Container
from clsco.data.record import Record, make_record
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene

ARRAYS = ("color", "sharp", "depth", "coc", "flow", "mask")
HEADS = ("format", "size, MB", "of the arrays", "write, MB/s", "read, MB/s", "at random", "depth alone")


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--size", type=int, default=512, help="pixels a side")
    parser.add_argument("--only", default="", help="part of the names of the formats")
    parser.add_argument("-o", dest="out", type=Path, help="file for the table")
    chosen = parser.parse_args()
    records = rendered(chosen.samples, chosen.size)
    total = sum(array.nbytes for record in records for array in record.arrays.values())
    lines = [
        f"{len(records)} samples of {chosen.size} x {chosen.size} px, {', '.join(ARRAYS)}: {total / 1e6:.1f} MB.",
        "", f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|",
    ]  # fmt: skip
    print("\n".join(lines), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, container in CONTAINERS.items():
            if chosen.only in name:
                lines.append(row(container, records, total, Path(folder)))
                print(lines[-1], flush=True)
    if chosen.out:
        chosen.out.write_text("\n".join(lines) + "\n")


def scene_of(number: int, size: int) -> Scene:
    """A textured sphere that moves before a tilted plane, with a lens of its own."""
    rng = np.random.default_rng(number)
    texture = np.kron(rng.random((32, 32, 3)), np.ones((16, 16, 1))) + rng.normal(0, 0.01, (512, 512, 3))
    lens = {"focal_length": 50.0, "f_number": 2.0 + 0.1 * (number % 40), "focus_distance": 280.0}
    return parse_scene(
        {
            "camera": {**lens, "pixel_pitch": 10.0 / size, "resolution": [size, size]},
            "object": [
                {"shape": "plane", "distance": 320.0, "slope_x": 0.2, "texture": texture.clip(0, 1).astype(np.float32)},
                {"shape": "sphere", "center": [0, 0, 270], "radius": 15, "motion": {"velocity": [2.0, 1.0, 0.0]}},
            ],
        }
    )


def rendered(count: int, size: int) -> list[Record]:
    """Records of such scenes."""
    truth = tuple("blur_radius" if name == "coc" else name for name in ARRAYS[1:])
    found = []
    for number in range(count):
        scene = scene_of(number, size)
        about = {"number": number, "split": "", "attempts": 1, "parameters": {}, "table": {}}
        sample: Any = SimpleNamespace(**about, labels=("",), scenes=(scene,))
        found.append(make_record(sample, 0, [[clsco.render_frame(scene, truth=truth)]], ARRAYS))
    return found


def row(container: Container, records: list[Record], total: int, folder: Path) -> str:
    """Figures of one format."""
    path = folder / f"{container.name}{container.suffix}"

    def write() -> None:
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
        container.write(path, iter(records))

    written = best(write)
    stored = sum(each.stat().st_size for each in (path.rglob("*") if path.is_dir() else [path]) if each.is_file())
    order = random.Random(0).sample(range(len(records)), len(records))
    reader = container.read(path)
    rates = [
        total / best(lambda: [reader.record(n) for n in range(len(records))]),
        total / best(lambda: [reader.record(n) for n in order]),
        sum(record["depth"].nbytes for record in records)
        / best(lambda: [reader.record(n, ("depth",)) for n in range(len(records))]),
    ]
    cells = [
        f"{stored / 1e6:.1f}",
        f"{stored / total:.2f}",
        *(f"{rate / 1e6:.0f}" for rate in (total / written, *rates)),
    ]
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)
    return f"| {container.name} | {' | '.join(cells)} |"


def best(work: Callable[[], object]) -> float:
    """Seconds of the fastest of three runs."""
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return min(spent)


if __name__ == "__main__":
    main()
