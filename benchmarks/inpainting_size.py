"""Memory and time of filling a large image: python -m benchmarks.inpainting_size [--side 8192] [--method texture]

A square color image with 1 % missing in blocks of 16 x 16 px. Prints the process' largest resident memory before and
after, and process CPU and wall-clock time; kernels are compiled before.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

from clsco.device import Session, choose
from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.inpainting.texture import fill_texture

METHODS = {"texture": fill_texture, "biharmonic": fill_biharmonic}


def largest_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "linux" else 1024**2)


def main() -> None:
    """Make the image, fill it, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=8192)
    parser.add_argument("--method", choices=METHODS, default="texture")
    options = parser.parse_args()
    fill, side = METHODS[options.method], options.side
    image = np.empty((side, side, 3), np.float32)
    column = np.arange(side, dtype=np.float32)
    for row in range(side):
        for channel in range(3):
            image[row, :, channel] = 0.5 + 0.3 * np.sin(0.02 * row + 0.5 * channel + 0.03 * column)
    missing = np.zeros((side, side), bool)
    places = np.random.default_rng(0).permutation((side // 16) ** 2)[: round(side**2 / 100 / 256)]
    for place in places:
        i, j = (16 * int(k) for k in divmod(int(place), side // 16))
        missing[i : i + 16, j : j + 16] = True
    with Session(choose()) as session:
        fill(session, image[:64, :64].copy(), np.eye(64, dtype=bool))
        before, cpu, wall = largest_mib(), time.process_time(), time.perf_counter()
        found = fill(session, image, missing)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    error = np.abs(found[missing] - image[missing]).max()
    print(f"{options.method}, {side} x {side} x 3, {missing.mean():.2%} missing: {cpu:.1f} s CPU, {wall:.1f} s")
    print(f"largest memory {largest_mib():.0f} MiB, {before:.0f} MiB before; largest error {error:.3f}")


if __name__ == "__main__":
    main()
