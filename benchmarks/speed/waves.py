"""Processor time of blurs by waves beside the disc: python -m benchmarks.speed.waves [SIZE]

An image with radii that vary by 1 px around R is blurred by turns by a disc and by waves, Q = 0.11 px, in gray:
medians of the processor time of all threads, in ns per pixel. Tables and programs are made before.
"""

from __future__ import annotations

import resource
import sys
from statistics import median

import numpy as np

import clsco

TURNS = 7
CAMERA = clsco.Camera(f_number=2.0, focal_length=20.0, pixel_pitch=0.01)


def seconds() -> float:
    """Processor time of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main(size: int) -> None:
    """Print a row for each radius."""
    rng = np.random.default_rng(1)
    image = rng.random((size, size), np.float32)
    print("ns per pixel   disc   waves   ratio")
    for radius in (2.0, 6.0, 20.0):
        radii = radius + np.linspace(-0.5, 0.5, size)[:, None] * np.ones(size)
        found: dict[str, list[float]] = {"pillbox": [], "wave": []}
        for turn in range(TURNS + 1):
            for model, times in found.items():
                start = seconds()
                clsco.defocus(image, radii, {"model": model, "occlusion": "none"}, camera=CAMERA)
                if turn:
                    times.append(1e9 * (seconds() - start) / size**2)
        disc, waves = (median(times) for times in found.values())
        print(f"R {radius:4.0f}       {disc:6.1f}  {waves:6.1f}   {waves / disc:5.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 512)
