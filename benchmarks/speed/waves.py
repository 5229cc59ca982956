"""Processor time of blurs by waves beside the disc: python -m benchmarks.speed.waves [SIZE]

An image with radii that vary by 1 px around R is blurred by turns by a disc and by waves, Q = 0.11 px, in gray, of a
circle, of a ring, and of a circle with coma, whose tables have no symmetry, as those of blades and images have none,
and with coma that grows over the field, where a weight comes from four tables: medians of the processor time of all
threads, in ns per pixel. Tables and programs are made before.
"""

from __future__ import annotations

import resource
import sys
from statistics import median
from typing import Any

import numpy as np

import clsco

TURNS = 7
WAVES: dict[str, Any] = {"model": "wave"}
RING = {"shape": "ring", "obstruction": 0.35}
LENSES: dict[str, tuple[dict[str, Any], dict[str, Any] | None]] = {
    "disc": ({}, None), "ring": ({}, RING), "waves": (WAVES, None), "ring, waves": (WAVES, RING),
    "coma, waves": (WAVES | {"zernike": {"3,1": 0.1}}, None),
    "field, waves": (WAVES | {"seidel": {"W131": 0.2}}, None),
}  # fmt: skip
CAMERA = clsco.Camera(f_number=2.0, focal_length=20.0, pixel_pitch=0.01)


def seconds() -> float:
    """Processor time of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main(size: int) -> None:
    """Print a row for each radius."""
    rng = np.random.default_rng(1)
    image = rng.random((size, size), np.float32)
    print("ns per pixel " + "".join(f"{name:>16}" for name in LENSES))
    for radius in (2.0, 6.0, 20.0):
        radii = radius + np.linspace(-0.5, 0.5, size)[:, None] * np.ones(size)
        found: dict[str, list[float]] = {name: [] for name in LENSES}
        for turn in range(TURNS + 1):
            for name, times in found.items():
                psf, aperture = LENSES[name]
                start = seconds()
                clsco.defocus(image, radii, {"occlusion": "none", **psf}, aperture=aperture, camera=CAMERA)
                if turn:
                    times.append(1e9 * (seconds() - start) / size**2)
        ns = [median(times) for times in found.values()]
        print(f"R {radius:4.0f}       " + "".join(f"{each:8.1f} ({each / ns[0]:4.2f})" for each in ns))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 512)
