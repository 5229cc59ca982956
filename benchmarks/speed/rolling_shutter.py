"""Processor time of a rolling shutter beside a global one: python -m benchmarks.speed.rolling_shutter [--rounds N]

A ball before a wall, 640 x 480 px, both of which move: the whole exposure in so many time samples with all rows at
once, and the same time samples in the rows that are open at each; in turns, medians.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import clsco

CASES = ((0.5, 0.5, 6), (0.8, 0.2, 4), (0.9, 0.1, 3))  # readout and shutter in s, and time samples of a row


def scene(readout: float, shutter: float, samples: int) -> clsco.Scene:
    """A scene with this shutter."""
    ball = clsco.Sphere(center=(0, 0, 280), radius=30, motion=clsco.ObjectMotion(velocity=(40, 0, 0)))
    wall = clsco.Plane(distance=320, motion=clsco.ObjectMotion(velocity=(30, 0, 0)))
    camera = clsco.Camera(resolution=(640, 480), focus_distance=250)
    sequence = clsco.Sequence(readout=readout, shutter=shutter, samples=samples)
    return clsco.Scene(camera=camera, objects=(ball, wall), sequence=sequence)


def spent(wanted: clsco.Scene) -> tuple[float, int]:
    """Seconds of processor time of a frame, and its number of time samples."""
    begin = time.process_time()
    frame = clsco.render_frame(wanted, truth=())
    return time.process_time() - begin, frame.metadata["samples"]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    print("| row open for, of the readout | time samples | rolling, s | global with as many, s | ratio |")
    print("|---|---|---|---|---|")
    for readout, shutter, samples in CASES:
        rolling = scene(readout, shutter, samples)
        _, count = spent(rolling)  # which may compile
        whole = scene(0.0, 1.0, count)
        spent(whole)
        times = [(spent(rolling)[0], spent(whole)[0]) for _ in range(rounds)]
        one, other = (median(each) for each in zip(*times, strict=True))
        print(f"| {shutter / readout:.2f} | {count} | {one:.2f} | {other:.2f} | {one / other:.2f} |", flush=True)


if __name__ == "__main__":
    main()
