"""Time and memory of filling 1 % of a large color image: python -m benchmarks.inpainting.large [--size 8192].

The image is noise on shades, as hard to compress as a photograph; the holes are single pixels, scratches from one
border to the other, or blocks of 16 x 16 px. `clsco inpaint` runs with each method in a process of its own, whose peak
of memory is printed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clsco.files.images import write_png

SHARE = 0.01
RUN = "from clsco.cli.main import main; main()"


def picture(size: int) -> NDArray[np.uint8]:
    """Shades with noise, (size, size, 3)."""
    rng = np.random.default_rng(1)
    image = np.empty((size, size, 3), np.uint8)
    waves = 128 + 90 * np.sin(np.arange(size) / 50)
    for row in range(size):
        image[row] = (waves * (0.6 + 0.4 * np.sin(row / 70)))[:, None] + rng.integers(0, 12, (size, 3))
    return image


def single_pixels(size: int) -> NDArray[np.bool_]:
    """Missing pixels here and there, (size, size)."""
    return np.random.default_rng(2).random((size, size), np.float32) < SHARE


def scratches(size: int) -> NDArray[np.bool_]:
    """Missing lines 1 to 9 px wide from the left border to the right one, (size, size)."""
    rng, missing, columns = np.random.default_rng(3), np.zeros((size, size), np.bool_), np.arange(size)
    while np.count_nonzero(missing) < SHARE * size * size:
        begin, end = rng.integers(0, size, 2)
        middle = (begin + (end - begin) * columns / size).astype(np.int64)
        for offset in range(rng.integers(1, 10)):
            missing[np.minimum(middle + offset, size - 1), columns] = True
    return missing


def blocks(size: int) -> NDArray[np.bool_]:
    """Missing blocks, (size, size)."""
    side = size // 16
    chosen = np.zeros(side * side, np.bool_)
    chosen[np.random.default_rng(4).permutation(side * side)[: round(SHARE * side * side)]] = True
    return np.kron(chosen.reshape(side, side), np.ones((16, 16), np.bool_))


MASKS: dict[str, Callable[[int], NDArray[np.bool_]]] = {
    "pixels": single_pixels,
    "scratches": scratches,
    "blocks": blocks,
}


def run(words: list[str]) -> tuple[float, float, float]:
    """Seconds by the clock and of the processor, and the peak of memory in GiB, of `clsco` with some words."""
    before = time.perf_counter()
    child = os.spawnv(os.P_NOWAIT, sys.executable, [sys.executable, "-c", RUN, *words])
    _, status, usage = os.wait4(child, 0)
    assert status == 0
    return time.perf_counter() - before, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def main() -> None:
    """Make the files, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=8192)
    parser.add_argument("--methods", nargs="+", default=["mean-median", "biharmonic", "texture", "auto"])
    parser.add_argument("--masks", nargs="+", default=list(MASKS), choices=MASKS)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        image, mask, out = (Path(folder) / name for name in ("image.png", "mask.png", "out.png"))
        write_png(image, picture(chosen.size))
        for name in chosen.masks:
            write_png(mask, np.where(MASKS[name](chosen.size), 255, 0).astype(np.uint8))
            for method in chosen.methods:
                words = ["inpaint", str(image), str(mask), "-o", str(out), "--quiet", "--method", method]
                clock, processor, peak = run(words)
                print(
                    f"{method}, {name}: {clock:.0f} s with files, {processor:.0f} s of the processor, {peak:.2f} GiB",
                    flush=True,
                )


if __name__ == "__main__":
    main()
