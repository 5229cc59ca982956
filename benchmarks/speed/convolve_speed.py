"""Speed of the blur with one radius against OpenCV, in one run: python -m benchmarks.speed.convolve_speed

White noise, one gray channel, whole passes with the copy of the result. Process CPU time, medians of interleaved
repetitions, ns per pixel. OpenCV's filter2D has the same weights, and takes a DFT for more than a few; its GaussianBlur
has samples of the Gaussian for weights. Errors: RMS and largest of white, against filter2D in float64 (another image).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.blur.passes import MeasuredPass
from benchmarks.defocus_speed import measured
from benchmarks.speed.peers import opencv
from benchmarks.tables import write_table
from clsco.opencl.device import choose
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.scene.model import Psf

RESULTS = Path(__file__).parents[1] / "results"
PSFS = {
    "sampled": Psf(edge="sampled"),
    "area": Psf(edge="area"),
    "integrated": Psf(),
    "gaussian": Psf(model="gaussian"),
}
CROP = 256  # px a side


def error_of(psf: Psf, side: int, radius: float, session: Session) -> tuple[float, float]:
    """RMS and largest error on an image of its own, at most CROP px a side."""
    image = np.random.default_rng(1).random((min(side, CROP),) * 2, dtype=np.float32)
    span = np.arange(-point_spread(psf).reach(radius), point_spread(psf).reach(radius) + 1.0)
    kernel = point_spread(psf).weights(span[None, :], span[:, None], np.asarray(radius))
    expected = cv2.filter2D(image.astype(np.float64), -1, kernel, borderType=cv2.BORDER_CONSTANT)
    found = MeasuredPass(session, image, np.full(image.shape, radius), psf, "convolve", "double")([])
    return float(np.sqrt(np.mean((found - expected) ** 2))), float(np.abs(found - expected).max())


def main() -> None:
    """Measure, print a table, write benchmarks/results/convolve_speed.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--radius", type=float, nargs="*", default=[2.0, 6.0, 20.0, 60.0])
    parser.add_argument("--side", type=int, nargs="*", default=[512, 2048])
    parser.add_argument("--psf", nargs="*", choices=PSFS, default=list(PSFS))
    parser.add_argument("--repetitions", type=int, default=7)
    options = parser.parse_args()
    table = Table(title="process CPU time, ns per pixel")
    for heading in ("side", "R", "PSF", "clsco", "filter2D", "times faster", "GaussianBlur", "RMS error", "largest"):
        table.add_column(heading, justify="right")
    rows = []
    with Session(choose()) as session:
        for side in options.side:
            image = np.random.default_rng(0).random((side, side), dtype=np.float32)
            for radius in options.radius:
                radii = np.full((side, side), radius)
                for name in options.psf:
                    psf = PSFS[name]
                    own = MeasuredPass(session, image, radii, psf, "convolve", "double")
                    passes: dict[str, Callable[[], object]] = {
                        "clsco": partial(own, []),
                        "filter2D": opencv("filter2D", psf, image, radius),
                    }
                    if psf.model == "gaussian":
                        passes["GaussianBlur"] = opencv("GaussianBlur", psf, image, radius)
                    spent = measured(passes, options.repetitions)
                    ns = {key: 1e9 * value / image.size for key, value in spent.items()}
                    rms, largest = error_of(psf, side, radius, session)
                    rows.append({"side": side, "radius_px": radius, "psf": name, **ns, "rms": rms, "largest": largest})
                    shown = (ns["clsco"], ns["filter2D"], ns["filter2D"] / ns["clsco"], ns.get("GaussianBlur"))
                    table.add_row(
                        f"{side}", f"{radius:g}", name, *("" if v is None else f"{v:.1f}" for v in shown),
                        f"{rms:.1e}", f"{largest:.1e}",
                    )  # fmt: skip
        device = str(session.device)
    Console(width=120).print(table)
    heading = f"{device}: process CPU time, ns per pixel (`python -m benchmarks.speed.convolve_speed`)"
    write_table(RESULTS / "convolve_speed.md", heading, rows)


if __name__ == "__main__":
    main()
