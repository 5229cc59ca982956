"""Time and error of frames with fewer samples, as `--tolerance` takes them, beside all samples.

    python benchmarks/speed/tolerance.py --examples examples [--tolerance 0.001 0.003 0.01] [--repeats 3] [--only NAME]

Scenes of the examples that move or have silhouettes, in their own size up to 512 columns; first frame, without ground
truth. Medians of process CPU time, by turns, planning included; errors are RMS of white against all samples.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

import clsco
from clsco.plan.approximation import ApproximationReport

SCENES = ("sphere_moving", "camera_motion", "occlusion_passing", "plane_approaching", "plane_turning", "road", "sphere")
COLUMNS = 512


def main() -> None:
    """Read the command line, measure, print rows of a Markdown table."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--examples", type=Path, required=True)
    parser.add_argument("--tolerance", type=float, nargs="+", default=[0.001, 0.003, 0.01])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", default="", help="part of the names of the scenes")
    options = parser.parse_args()
    for name in (name for name in SCENES if options.only in name):
        scene = clsco.load_sweep(options.examples / f"{name}.toml").scenes[0]
        columns, rows = scene.camera.resolution or (COLUMNS, COLUMNS)
        if columns > COLUMNS:
            scene = scene.replace("camera.resolution", (COLUMNS, round(rows * COLUMNS / columns)))
        wanted = [None, *options.tolerance]
        spent: dict[float | None, list[float]] = {tolerance: [] for tolerance in wanted}
        frames = {}
        for repeat in range(options.repeats + 1):
            for tolerance in wanted:
                began = time.process_time()
                frames[tolerance] = clsco.render_frame(scene, truth=(), tolerance=tolerance)
                if repeat:  # the first compiles
                    spent[tolerance].append(1e3 * (time.process_time() - began))
        exact = frames[None].color.astype(np.float64)
        whole = statistics.median(spent[None])
        for tolerance in options.tolerance:
            report = ApproximationReport(**frames[tolerance].metadata["approximation"])
            error = float(np.sqrt(np.mean((frames[tolerance].color - exact) ** 2)))
            counts = f"{report.samples} of {report.scene_samples}, {report.silhouette_samples} of "
            counts += f"{report.scene_silhouette_samples}"
            taken = statistics.median(spent[tolerance])
            figures = f"{report.rms_error:.1e} | {error:.1e} | {whole:.0f} | {taken:.0f} | {whole / taken:.2f}"
            print(f"| {name} | {tolerance:g} | {counts} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
