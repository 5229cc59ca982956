"""`clsco.defocus` of a float32 array, whole calls with upload and download, beside a direct scatter in numba, and
beside an old version of clsco; needs the extra `bench`.

    .venv/bin/python benchmarks/speed/defocus_call.py --old OLD/.venv/bin/python
White noise, sampled discs of radii from 0 up to R px that grow over the image from its middle, so that both have the
same taps. The scatter fills the rows of each disc one after the other in one thread, the strongest form that was found.
Medians of processor time of interleaved calls, ns per pixel. The old version's Python runs in a process of its own.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco

CASES = ((2048, 2.0), (2048, 6.0), (1024, 20.0), (1024, 60.0))
PSF = {"model": "pillbox", "edge": "sampled", "tilt": False, "occlusion": "none"}


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--old", type=Path, help="Python of an old version")
    parser.add_argument("--repetitions", type=int, default=7, help="calls of each that count")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.worker:
        serve()
        return
    old = None
    if chosen.old is not None:
        command = [str(chosen.old), str(Path(__file__).resolve()), "--worker"]
        old = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    print(f"{'side':>6}{'R px':>6}{'numba ns':>10}{'old ns':>9}{'new ns':>9}{'numba/old':>11}{'numba/new':>11}")
    for side, radius in CASES:
        row(side, radius, chosen.repetitions, old)
    if old is not None and old.stdin is not None:
        old.stdin.close()
        old.wait()


def row(side: int, radius: float, repetitions: int, old: subprocess.Popen[str] | None) -> None:
    """Measure one case, and print it."""
    image, radii = given(side, radius)
    options: Any = as_the_scatter()
    calls: dict[str, Callable[[], float]] = {
        "numba": lambda: spent(lambda: scatter()(image, radii)),
        "new": lambda: spent(lambda: clsco.defocus(image, radii, PSF, **options)),
    }
    if old is not None:
        calls["old"] = lambda: asked(old, side, radius)
    times: dict[str, list[float]] = {name: [] for name in calls}
    for repetition in range(repetitions + 2):
        for name, call in calls.items():
            found = call()
            if repetition > 1:
                times[name].append(1e9 * found / side**2)
    ns = {name: median(values) for name, values in times.items()}
    before = ns.get("old", float("nan"))
    print(
        f"{side:6}{radius:6.0f}{ns['numba']:10.2f}{before:9.2f}{ns['new']:9.2f}"
        f"{ns['numba'] / before:11.2f}{ns['numba'] / ns['new']:11.2f}",
        flush=True,
    )


def given(side: int, largest: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Image and radii."""
    y, x = np.mgrid[:side, :side].astype(np.float32) / (side - 1) - 0.5
    radii = largest * np.hypot(x, y) / np.hypot(0.5, 0.5)
    return np.random.default_rng(0).random((side, side), np.float32), radii.astype(np.float32)


def as_the_scatter() -> dict[str, str]:
    """Options of `clsco.defocus` that old versions have without being asked."""
    options: Any
    options, nothing = {"outside": "black", "soft_edges": "keep"}, np.zeros((2, 2), np.float32)
    try:
        clsco.defocus(nothing, nothing, **options)
    except TypeError:
        return {}
    return options


def spent(call: Callable[[], Any]) -> float:
    """Processor time of a call in s."""
    before = time.process_time()
    call()
    return time.process_time() - before


def serve() -> None:
    """Measure what is asked for on stdin: side and radius of each call."""
    arrays: dict[str, Any] = {}
    options: Any = as_the_scatter()
    for line in sys.stdin:
        if line not in arrays:
            side, radius = line.split()
            arrays = {line: given(int(side), float(radius))}
        print(spent(partial(clsco.defocus, *arrays[line], PSF, **options)), flush=True)


def asked(worker: subprocess.Popen[str], side: int, radius: float) -> float:
    """Processor time of a call of the old version in s."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(f"{side} {radius}\n")
    worker.stdin.flush()
    return float(worker.stdout.readline())


@lru_cache(maxsize=1)
def scatter() -> Callable[[NDArray[np.float32], NDArray[np.float32]], NDArray[np.float32]]:
    """Discs row by row: how far each reaches, and how many taps share the light, once; then whole rows of one value."""
    from numba import njit

    @njit(fastmath=True)
    def discs(image, radius):  # type: ignore[no-untyped-def]
        rows, columns = image.shape
        out = np.zeros_like(image)
        half = np.zeros(1 + 2 * 512, np.int64)
        for i in range(rows):
            for j in range(columns):
                r = radius[i, j]
                if r < 0.5:
                    out[i, j] += image[i, j]
                    continue
                k, square, count = int(r), r * r, 0
                for a in range(k + 1):
                    half[a] = int(np.sqrt(square - a * a))
                    count += (2 * half[a] + 1) * (1 if a == 0 else 2)
                v = image[i, j] / count
                for a in range(max(-k, -i), min(k, rows - 1 - i) + 1):
                    w = half[abs(a)]
                    for b in range(max(j - w, 0), min(j + w, columns - 1) + 1):
                        out[i + a, b] += v
        return out

    return discs


if __name__ == "__main__":
    main()
