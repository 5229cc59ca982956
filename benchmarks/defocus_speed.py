"""Speed of the defocus pass against a direct scatter in numba, in one run: python -m benchmarks.defocus_speed

512 x 512, one gray channel, a sphere before a tilted plane with blur radii up to --radius px. Process CPU time, medians
of interleaved repetitions, ns per pixel. Two PSFs: the thesis' (sampled, no tilt) and today's default (integrated,
tilt), where numba does per tap what the thesis does and what the closed form costs respectively. Numba's scatter in
the two usual ways: a private image per thread, added up at the end; and bands of rows, each thread taking what falls
into its own.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

# Idle threads of one side must not spin while the other is timed.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from clsco.device import Session, choose
from clsco.layout import flat, frame_struct, structs
from clsco.program import build, empty, kernel, launch, upload
from clsco.scene import Psf
from clsco.spread import PIXELS, Sources, Spreader, blur_features

Array = NDArray[Any]
RESULTS = Path(__file__).parent / "results"


def radius_map(side: int, largest: float) -> Array:
    """Signed radii (side, side) in px of a sphere before a tilted plane."""
    i, j = np.mgrid[0:side, 0:side] / (side - 1.0) - 0.5
    plane = largest * (0.7 + 0.6 * j)
    ball = 1.0 - np.sqrt(np.maximum(1.0 - (np.hypot(i, j) / 0.4) ** 2, 0.0))
    return np.where(np.hypot(i, j) < 0.4, 0.3 * largest * ball, plane)


@njit(inline="always")
def _disc_taps(r):  # type: ignore[no-untyped-def]
    """Pixel centers within r, which the weights of a sampled disc are normalized by."""
    k, count = int(r), 0
    for a in range(-k, k + 1):
        for b in range(-k, k + 1):
            if a * a + b * b <= r * r:
                count += 1
    return count


@njit(parallel=True)
def sampled_private(image, radius, threads):  # type: ignore[no-untyped-def]
    """Direct scatter of the thesis' disc, an image per thread."""
    rows, columns = image.shape
    parts = np.zeros((threads, rows, columns), np.float32)
    for t in prange(threads):
        for i in range(t * rows // threads, (t + 1) * rows // threads):
            for j in range(columns):
                r = radius[i, j]
                if r < 0.5:
                    parts[t, i, j] += image[i, j]
                    continue
                k, v = int(r), image[i, j] / _disc_taps(r)
                for a in range(max(-k, -i), min(k, rows - 1 - i) + 1):
                    for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                        if a * a + b * b <= r * r:
                            parts[t, i + a, j + b] += v
    return parts.sum(axis=0)


@njit(parallel=True)
def sampled_bands(image, radius, threads):  # type: ignore[no-untyped-def]
    """Direct scatter of the thesis' disc, each thread into its own rows."""
    rows, columns = image.shape
    out = np.zeros((rows, columns), np.float32)
    reach = int(radius.max()) + 1
    for t in prange(threads):
        low, high = t * rows // threads, (t + 1) * rows // threads
        for i in range(max(0, low - reach), min(rows, high + reach)):
            for j in range(columns):
                r = radius[i, j]
                k = 0 if r < 0.5 else int(r)
                v = image[i, j] / (_disc_taps(r) if k else 1)
                for a in range(max(-k, low - i), min(k, high - 1 - i) + 1):
                    for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                        if a * a + b * b <= r * r or k == 0:
                            out[i + a, j + b] += v
    return out


@njit(inline="always")
def _tabulated(table, u, dx, dy):  # type: ignore[no-untyped-def]
    """Weight at (dx, dy), linear between the two nearest radii of a dense table."""
    k = int(u)
    t = u - k
    a, b = abs(dx), abs(dy)
    return table[k, a, b] + t * (table[k + 1, a, b] - table[k, a, b])


@njit(parallel=True)
def exact_private(image, radius, gx, gy, table, steps, threads):  # type: ignore[no-untyped-def]
    """Direct scatter of the integrated disc with tilt from a table (radii, |dx|, |dy|), an image per thread."""
    rows, columns = image.shape
    parts = np.zeros((threads, rows, columns), np.float32)
    for t in prange(threads):
        for i in range(t * rows // threads, (t + 1) * rows // threads):
            for j in range(columns):
                r = radius[i, j]
                k, v, u, s = int(np.ceil(r + 1.0)) - 1, image[i, j], r * steps, max(r, 1.0)
                x, y = gx[i, j] / s, gy[i, j] / s
                for a in range(max(-k, -i), min(k, rows - 1 - i) + 1):
                    for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                        tilt = max(0.0, 1.0 + b * x + a * y)
                        parts[t, i + a, j + b] += v * tilt * _tabulated(table, u, b, a)
    return parts.sum(axis=0)


@njit(parallel=True)
def exact_bands(image, radius, gx, gy, table, steps, threads):  # type: ignore[no-untyped-def]
    """Direct scatter of the integrated disc with tilt from a table, each thread into its own rows."""
    rows, columns = image.shape
    out = np.zeros((rows, columns), np.float32)
    reach = int(radius.max()) + 2
    for t in prange(threads):
        low, high = t * rows // threads, (t + 1) * rows // threads
        for i in range(max(0, low - reach), min(rows, high + reach)):
            for j in range(columns):
                r = radius[i, j]
                k, v, u, s = int(np.ceil(r + 1.0)) - 1, image[i, j], r * steps, max(r, 1.0)
                x, y = gx[i, j] / s, gy[i, j] / s
                for a in range(max(-k, low - i), min(k, high - 1 - i) + 1):
                    for b in range(max(-k, -j), min(k, columns - 1 - j) + 1):
                        tilt = max(0.0, 1.0 + b * x + a * y)
                        out[i + a, j + b] += v * tilt * _tabulated(table, u, b, a)
    return out


def dense_table(largest: float, steps: int) -> Array:
    """Weights of the integrated disc (radii, |dx|, |dy|) at every 1/steps px, as a user would tabulate them."""
    from clsco.psf import weights

    offsets = np.arange(int(np.ceil(largest)) + 2, dtype=float)
    radii = np.arange(int(largest * steps) + 3) / steps
    table = weights(Psf(), offsets[None, :, None], offsets[None, None, :], radii[:, None, None])
    return table.astype(np.float32)


def defocus_pass(
    session: Session, image: Array, radius: Array, psf: Psf
) -> tuple[Callable[[], None], Callable[[], None], Callable[[], Array]]:
    """The device's prepass (radius to source record), its defocus pass, both warm; and the result."""
    rows, columns = image.shape
    camera = frame_struct(rows, columns, 0, "double")
    features = dict.fromkeys(("QUADRATIC", "LINEAR", "NAPPE", "BOUNDED", "FILTER", "SUBPIXELS"), 0)
    stepwise = psf.edge == "sampled"
    features |= {
        "CHANNELS": 1,
        "TILT": int(psf.tilt),
        "SAMPLED": int(stepwise),
        "POWERS": 1 if stepwise else 4,
    }
    program = build(session, ["blur.cl"], features | blur_features("gather", "lose", True), structs("double"), "double")
    spreader = Spreader(
        session, program, psf, "gather", camera, 1, float(radius.min()), float(radius.max()), 0, "double", 1.0
    )
    source, value = empty(session, 16 * image.size), upload(session, flat(image, np.float32))
    coc, valid = upload(session, radius), upload(session, np.ones(image.shape, np.uint8))

    def prepass() -> None:
        args = (camera, spreader.struct, coc, valid, source)
        launch(session, kernel(program, "prepare_sources"), (columns, rows), PIXELS, *args)
        session.queue.finish()

    def spread() -> None:
        spreader.clear()
        spreader.add(Sources(source, value), 0.0, [])
        session.queue.finish()

    return prepass, spread, lambda: spreader.image([])


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
    pixels, threads = image.size, get_num_threads()
    with Session(choose()) as session:
        for largest in options.radius:
            radius = radius_map(options.side, largest)
            single = radius.astype(np.float32)
            gy, gx = (g.astype(np.float32) for g in np.gradient(radius))
            dense = dense_table(largest, 128)
            exact = (image, single, gx, gy, dense, 128.0, threads)
            cases: dict[str, tuple[Psf, Callable[[], Array], Callable[[], Array]]] = {
                "sampled": (
                    Psf(edge="sampled", tilt=False),
                    partial(sampled_private, image, single, threads),
                    partial(sampled_bands, image, single, threads),
                ),
                "integrated, tilt": (Psf(), partial(exact_private, *exact), partial(exact_bands, *exact)),
            }
            for name, (psf, private, bands) in cases.items():
                prepass, spread, result = defocus_pass(session, image, radius, psf)
                passes = {"private": private, "bands": bands, "prepass": prepass, "pass": spread}
                spent = measured(passes, options.repetitions)
                ns = {key: 1e9 * value / pixels for key, value in spent.items()}
                best = min(ns["private"], ns["bands"])
                ratios = {"ratio": best / ns["pass"], "ratio_with_prepass": best / (ns["pass"] + ns["prepass"])}
                inner = slice(int(largest) + 2, -int(largest) - 2)
                error = float(np.abs(result() - bands())[inner, inner].max())
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
