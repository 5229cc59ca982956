"""The thesis' method beside OpenCV's Navier-Stokes: python -m benchmarks.inpainting.speed [--images NAME...]

Warm calls of `clsco.inpaint(image, missing, method="mean-median")`, with all stages and the report's figures, and of
`cv2.inpaint(image, mask, 3, cv2.INPAINT_NS)`, on the same 8-bit images and masks, in one process in turns: programs are
compiled and the session is open before. Medians, in ms, of the processor's time, all threads together, and of time by
the clock; OpenCV works in one thread.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import clsco
from benchmarks.inpainting.cases import IMAGES, MASKS, Case, cases

Times = tuple[float, float]


def in_turns(fills: list[Callable[[], Any]], repetitions: int) -> list[NDArray[np.float64]]:
    """Medians of processor time and time by the clock, in ms, of each."""
    spent: list[list[Times]] = [[] for _ in fills]
    for _ in range(repetitions + 1):
        for fill, times in zip(fills, spent, strict=True):
            processor, clock = time.process_time(), time.perf_counter()
            fill()
            times.append((time.process_time() - processor, time.perf_counter() - clock))
    return [1000 * np.median(times[1:], axis=0) for times in spent]  # the first call compiles


def compare(case: Case, repetitions: int) -> list[NDArray[np.float64]]:
    """Medians of ours and of OpenCV's."""
    damaged = case.image.copy()
    damaged[case.missing] = 0
    mask = np.where(case.missing, 255, 0).astype(np.uint8)
    return in_turns(
        [
            lambda: clsco.inpaint(damaged, case.missing, method="mean-median"),
            lambda: cv2.inpaint(damaged, mask, 3, cv2.INPAINT_NS),
        ],
        repetitions,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", nargs="+", default=IMAGES)
    parser.add_argument("--masks", nargs="+", default=MASKS, choices=MASKS)
    parser.add_argument("--repetitions", type=int, default=9)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print("| case | missing | ours, processor / clock | NS | ours / NS |\n|---|---|---|---|---|")
    ratios = []
    for case in cases(options.images, options.masks):
        ours, other = compare(case, options.repetitions)
        ratios.append(ours / other)
        shown = " | ".join(f"{a:.1f} / {b:.1f}" for a, b in (ours, other))
        part = f"{100 * case.missing.mean():.0f} %"
        print(f"| {case.image_name}, {case.mask_name} | {part} | {shown} | {ratios[-1][0]:.2f} / {ratios[-1][1]:.2f} |")
    mean, most = np.exp(np.log(ratios).mean(axis=0)), np.max(ratios, axis=0)
    print(f"ours / NS: geometric mean {mean[0]:.2f} / {mean[1]:.2f}, most {most[0]:.2f} / {most[1]:.2f}")


if __name__ == "__main__":
    main()
