"""Table and plot of whole frames against the traced lens."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from benchmarks.speed.lens import EDGES, PSFS, Lens

EDGE_COLORS = dict(zip(EDGES, ("#d55e00", "#e69f00", "#0072b2"), strict=True))
# With tilt or not, with sources at silhouettes or not.
MARKERS = {(False, False): "o", (True, False): "^", (False, True): "s", (True, True): "*"}


def lens_table(lens: Lens) -> RenderableType:
    """All rows, those of clsco with what Mitsuba takes for the same error; ~ marks times that were not measured."""
    title = f"{lens.scene}, {lens.size} x {lens.size}, against the traced lens; process CPU time of a warm frame"
    shown = Table(title=Text(title), title_justify="left", box=SIMPLE, pad_edge=False)
    for name in ("", "PSF, or rays per pixel", "ms", "RMS", "dB", "Mitsuba, ms", "times less"):
        shown.add_column(name, justify="left" if name[:3] in ("", "PSF") else "right", no_wrap=True)
    for row in lens.rows:
        about = "~" if row.extrapolated else ""
        theirs = "" if row.mitsuba_cpu_s is None else f"{about}{1e3 * row.mitsuba_cpu_s:,.0f}"
        times = "" if row.times_less is None else f"{about}{row.times_less:,.0f}"
        figures = (f"{1e3 * row.cpu_s:,.1f}", f"{row.rms_error:.2e}", f"{row.psnr_db:.1f}", theirs, times)
        shown.add_row(row.tool, row.setting, *figures)
    return shown


def lens_plot(lens: Lens) -> Any:
    """CPU time against error: each PSF of clsco, and Mitsuba with more and more rays."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 5.5), layout="constrained")
    panel: Any = figure.subplots()
    theirs = [row for row in lens.rows if row.tool == "Mitsuba"]
    if theirs:
        curve = ([row.rms_error for row in theirs], [row.cpu_s for row in theirs])
        panel.plot(*curve, "x-", color="0.2", label="Mitsuba 3, rays per pixel")
        for row in theirs:
            place = {"xytext": (4, 4), "textcoords": "offset points", "fontsize": 8}
            panel.annotate(row.setting, (row.rms_error, row.cpu_s), **place)
    for row in lens.rows:
        if row.tool == "clsco":
            psf = PSFS[row.setting]
            marker = MARKERS[psf.tilt, psf.silhouette_samples > 1]
            style = {"color": EDGE_COLORS[psf.edge], "markersize": 11 if marker == "*" else 7, "linestyle": "none"}
            panel.plot([row.rms_error], [row.cpu_s], marker, label=row.setting, **style)
    title = f"{lens.scene}, {lens.size} x {lens.size}: a warm frame against the traced lens (noise {lens.noise:.1e})"
    panel.set_title(title, fontsize=10)
    panel.set(xscale="log", yscale="log", xlabel="RMS error, of white", ylabel="process CPU time, s")
    panel.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize=8)
    return figure
