"""Speed of the defocus pass against a direct scatter in numba, in one run: python -m benchmarks.defocus_speed

512 x 512, one gray channel, a sphere before a tilted plane with blur radii up to --radius px. Process CPU time, medians
of interleaved repetitions, ns per pixel. Two PSFs: the thesis' (sampled, no tilt) and today's default (integrated,
tilt), where numba does per tap what the thesis does and what the closed form costs respectively; and the Gaussian
without tilt, where numba multiplies the weights of two axes, in bands only. Numba's scatter in
the two usual ways: a private image per thread, added up at the end; and bands of rows, each thread taking what falls
into its own.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from clsco.bench.cases import radius_map
from clsco.bench.direct import (
    THREADS,
    axis_table,
    dense_table,
    exact_bands,
    exact_private,
    gaussian_bands,
    sampled_bands,
    sampled_private,
)
from clsco.bench.passes import Pass
from clsco.device import Session, choose
from clsco.psf import psf_extent
from clsco.scene import Psf
from clsco.spread import Events

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


def main() -> None:
    """Measure, print a table, write benchmarks/results/defocus_speed.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--radius", type=float, nargs="*", default=[2.0, 6.0, 20.0])
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--repetitions", type=int, default=9)
    options = parser.parse_args()
    console, table = (
        Console(),
        Table(title=f"{options.side} x {options.side}, process CPU time, ns per pixel"),
    )
    headings = ("largest R", "PSF", "numba, private", "numba, bands", "clsco pass", "+ prepass")
    for heading in (*headings, "times faster", "with prepass", "difference"):
        table.add_column(heading, justify="right")
    rows = []
    image = np.random.default_rng(0).random((options.side, options.side), dtype=np.float32)
    pixels = image.size
    with Session(choose()) as session:
        for largest in options.radius:
            radius = radius_map(options.side, largest)
            single = radius.astype(np.float32)
            gy, gx = (g.astype(np.float32) for g in np.gradient(radius))
            dense = dense_table(largest, 128)
            exact = (image, single, gx, gy, dense, 128.0, THREADS)
            cases: dict[str, tuple[Psf, Callable[[], Array], Callable[[], Array]]] = {
                "sampled": (
                    Psf(edge="sampled", tilt=False),
                    partial(sampled_private, image, single, THREADS),
                    partial(sampled_bands, image, single, THREADS),
                ),
                "integrated, tilt": (Psf(), partial(exact_private, *exact), partial(exact_bands, *exact)),
            }
            if largest <= LARGEST_GAUSSIAN:
                psf = Psf(model="gaussian", tilt=False)
                axis = axis_table(psf, largest, 128)
                direct = partial(gaussian_bands, image, single, axis, 128.0, float(psf_extent(psf, 1.0)), THREADS)
                cases["gaussian"] = psf, direct, direct
            for name, (psf, private, bands) in cases.items():
                device_pass = Pass(session, image, radius, psf, "gather", "double")
                passes: dict[str, Callable[[], object]] = {
                    "private": private,
                    "bands": bands,
                    "prepass": partial(finished, session, device_pass.prepare),
                    "pass": partial(finished, session, device_pass.spread),
                }
                spent = measured(passes, options.repetitions)
                ns = {key: 1e9 * value / pixels for key, value in spent.items()}
                best = min(ns["private"], ns["bands"])
                ratios = {"ratio": best / ns["pass"], "ratio_with_prepass": best / (ns["pass"] + ns["prepass"])}
                inner = slice(int(largest) + 2, -int(largest) - 2)
                error = float(np.abs(device_pass([]) - bands())[inner, inner].max())
                rows.append({"largest_radius_px": largest, "psf": name, **ns, **ratios, "difference": error})
                shown = [f"{ns[k]:.1f}" for k in ("private", "bands", "pass", "prepass")]
                table.add_row(
                    f"{largest:g}", name, *shown, *(f"{ratio:.1f}" for ratio in ratios.values()), f"{error:.1e}"
                )
        device = str(session.device)
    console.print(table)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "defocus_speed.json").write_text(json.dumps({"device": device, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
