"""Frames of a sensor, judged by the reference implementation of the standard EMVA 1288.

    pip install emva1288
    python -m benchmarks.truth.emva [--size 512] [--levels 25] [--images 32]

Cards of even light are rendered as scenes are, and their codes given to the program, which knows photons and codes
alone. It fails where gain, quantum efficiency or dark noise are off by 0.5 %, DSNU or PRNU by 2 %.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco

GAIN, EFFICIENCY, READ_NOISE, DSNU, PRNU, DARK = 0.25, 0.6, 6.0, 2.0, 0.01, 4.0
FULL_WELL, WHITE, BITS, BLACK = 12000.0, 20000.0, 12, 100
PARTS = ("data", "results", "routines")
GONE = "asfarray"  # of NumPy 1, which emva1288 1.0.2 calls
SENSOR: dict[str, Any] = {
    "gain": GAIN, "quantum_efficiency": [EFFICIENCY] * 3, "read_noise": READ_NOISE, "dsnu": DSNU, "prnu": PRNU,
    "dark_current": DARK, "full_well": FULL_WELL, "white_electrons": WHITE, "bits": BITS, "black_level": BLACK,
}  # fmt: skip
BRIGHTEST = 1.05 * FULL_WELL / (EFFICIENCY * WHITE)
# Name, its true value, and how far it may be off.
WANTED = (
    ("K", GAIN, 0.005), ("QE", 100 * EFFICIENCY, 0.005), ("sigma_d", float(np.hypot(READ_NOISE, DARK**0.5)), 0.005),
    ("DSNU1288", DSNU, 0.02), ("PRNU1288", 100 * PRNU, 0.02),
)  # fmt: skip


def codes(light: float, size: int, frames: int, first: int) -> Iterator[NDArray[np.uint16]]:
    """Codes of frames of even light, from a number on."""
    card = clsco.Plane(distance=250.0, texture=np.full((size, size), light, np.float32))
    scene = clsco.Scene(
        camera=clsco.Camera(focus_distance=250.0),
        objects=(card,),
        sequence=clsco.Sequence(frames=first + frames),
        sensor=clsco.Sensor(**SENSOR),
    )
    for frame in clsco.render(scene, truth="raw", frames=range(first, first + frames)):
        assert frame.raw is not None
        yield frame.raw


def judged(size: int, levels: int, images: int) -> Any:
    """Results of the standard's program."""
    try:
        data, results, routines = (
            import_module(f"emva1288.process.{name}") for name in ("data", "results", "routines")
        )
    except ImportError as error:
        sys.exit(f"emva: needs emva1288: pip install emva1288; got {error}")
    if not hasattr(np, GONE):
        setattr(np, GONE, lambda values: np.asarray(values, np.float64))
    temporal: dict[float, Any] = {}
    spatial: dict[float, Any] = {}
    for number, light in enumerate(np.linspace(0.0, BRIGHTEST, levels).tolist()):
        photons = light * WHITE
        pair = routines.get_int_imgs(list(codes(light, size, 2, 2 * number)))
        temporal[photons] = pair | {name: pair[name].sum() for name in ("sum", "pvar")}
    half = BRIGHTEST / 2
    for number, light in enumerate((0.0, half)):
        found = list(codes(light, size, images, 10_000 * (number + 1)))
        spatial[light * WHITE] = routines.get_int_imgs(found)
    given = {"width": size, "height": size, "temporal": {1.0: temporal}, "spatial": {1.0: spatial}}
    known = data.Data1288(given, loglevel=logging.ERROR)
    return results.Results1288(known.data, pixel_area=25.0, loglevel=logging.ERROR)


def main() -> None:
    """Read the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, metavar="N", help="frames of N x N px")
    parser.add_argument("--levels", type=int, default=25, metavar="N", help="of light, from none to beyond a full well")
    parser.add_argument("--images", type=int, default=32, metavar="N", help="for fixed patterns, in the dark and half")
    options = parser.parse_args()
    found, off = judged(options.size, options.levels, options.images), False
    print("| what | true | found | off |\n|---|---|---|---|")
    for name, true, most in WANTED:
        value = float(getattr(found, name))
        off |= not abs(value / true - 1) <= most
        print(f"| {name} | {true:.6g} | {value:.6g} | {100 * (value / true - 1):+.2f} % |")
    sys.exit(int(off))


if __name__ == "__main__":
    main()
