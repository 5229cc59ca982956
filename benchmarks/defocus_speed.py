"""Speed of the defocus pass against a direct scatter in numba, in one run: python -m benchmarks.defocus_speed

512 x 512, gray and color, a sphere before a tilted plane with blur radii up to --radius px. Process CPU time, medians
of interleaved repetitions, ns per pixel. Two PSFs: the thesis' (sampled, no tilt) and today's default (integrated,
tilt), where numba does per tap what the thesis does and what the closed form costs respectively; and of one channel the
Gaussian without tilt, where numba multiplies the weights of two axes, in bands only. Numba's scatter in the better of
the two usual ways: a private image per thread, added up at the end; and bands of rows, each thread taking what falls
into its own. Channels share the weights of taps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.blur.cases import radius_map
from benchmarks.blur.passes import MeasuredPass
from benchmarks.speed.direct import THREADS, axis_table, dense_table, gaussian_bands, scatter
from benchmarks.tables import write_table
from clsco.opencl.device import choose
from clsco.opencl.program import Events
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.scene.model import Psf

Array = NDArray[Any]
LARGEST_GAUSSIAN = 20.0  # px; numba takes minutes beyond
RESULTS = Path(__file__).parent / "results"


def finished(session: Session, enqueue: Callable[[Events], None]) -> None:
    """Enqueue a part of the pass, and wait for it."""
    enqueue([])
    session.queue.finish()


def measured(passes: Mapping[str, Callable[[], object]], repetitions: int) -> dict[str, float]:
    """Median process CPU time of each in s, repetitions interleaved."""
    spent: dict[str, list[float]] = {name: [] for name in passes}
    for run in passes.values():
        run()
    for _ in range(repetitions):
        for name, run in passes.items():
            start = time.process_time()
            run()
            spent[name].append(time.process_time() - start)
    return {name: float(np.median(times)) for name, times in spent.items()}


def cases_of(image: Array, radius: Array) -> dict[str, tuple[Psf, list[Callable[[], Array]]]]:
    """PSFs by name, and numba's ways for an image (rows, columns, channels): private images, and bands where there is
    a second way."""
    largest, single, ways = float(radius.max()), radius.astype(np.float32), scatter(image.shape[2])
    gy, gx = (g.astype(np.float32) for g in np.gradient(radius))
    exact = (image, single, gx, gy, dense_table(largest, 128), 128.0, THREADS)
    sampled = [partial(way, image, single, THREADS) for way in (ways.sampled_private, ways.sampled_bands)]
    found: dict[str, tuple[Psf, list[Callable[[], Array]]]] = {
        "sampled": (Psf(edge="sampled", tilt=False), [*sampled]),
        "integrated, tilt": (Psf(), [partial(way, *exact) for way in (ways.exact_private, ways.exact_bands)]),
    }
    if largest <= LARGEST_GAUSSIAN and image.shape[2] == 1:
        psf = Psf(model="gaussian", tilt=False)
        axis, cut = axis_table(psf, largest, 128), float(1.0 * point_spread(psf).extent)
        found["gaussian"] = psf, [partial(gaussian_bands, image[..., 0], single, axis, 128.0, cut, THREADS)]
    return found


def main() -> None:
    """Measure, print a table, write benchmarks/results/defocus_speed.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--radius", type=float, nargs="*", default=[2.0, 6.0, 20.0])
    parser.add_argument("--channels", type=int, nargs="*", default=[1, 3])
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--repetitions", type=int, default=9)
    options = parser.parse_args()
    console, table = Console(), Table(title=f"{options.side} x {options.side}, process CPU time, ns per pixel")
    headings = ("largest R", "PSF", "channels", "numba", "clsco pass", "+ prepass")
    for heading in (*headings, "times faster", "with prepass", "difference"):
        table.add_column(heading, justify="right")
    rows = []
    with Session(choose()) as session:
        for largest, channels in product(options.radius, options.channels):
            shape = (options.side, options.side, channels)
            image, radius = np.random.default_rng(0).random(shape, np.float32), radius_map(options.side, largest)
            for name, (psf, ways) in cases_of(image, radius).items():
                device_pass = MeasuredPass(session, image, radius, psf, "gather", "double")
                passes: dict[str, Callable[[], object]] = {
                    **{f"numba {n}": way for n, way in enumerate(ways)},
                    "prepass": partial(finished, session, device_pass.prepare),
                    "pass": partial(finished, session, device_pass.spread),
                }
                spent = measured(passes, options.repetitions)
                ns = {key: 1e9 * value / radius.size for key, value in spent.items()}
                best = min(ns.pop(f"numba {n}") for n in range(len(ways)))
                ratios = {"ratio": best / ns["pass"], "ratio_with_prepass": best / (ns["pass"] + ns["prepass"])}
                inner = slice(int(largest) + 2, -int(largest) - 2)
                error = float(np.abs(device_pass([]).reshape(shape) - ways[-1]().reshape(shape))[inner, inner].max())
                row = {"largest_radius_px": largest, "psf": name, "channels": channels, "numba": best}
                rows.append({**row, **ns, **ratios, "difference": error})
                shown = [f"{value:.1f}" for value in (best, ns["pass"], ns["prepass"], *ratios.values())]
                table.add_row(f"{largest:g}", name, str(channels), *shown, f"{error:.1e}")
        device = str(session.device)
    console.print(table)
    heading = f"{device}: process CPU time, ns per pixel (`python -m benchmarks.defocus_speed`)"
    write_table(RESULTS / "defocus_speed.md", heading, rows)


if __name__ == "__main__":
    main()
