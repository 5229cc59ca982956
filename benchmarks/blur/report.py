"""Report of the benchmark: a table, JSON, CSV and plots; the extra `bench` has matplotlib for them."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from benchmarks.blur.cases import PSFS
from benchmarks.blur.measure import Bench, BenchRow
from clsco.errors import ClscoError
from clsco.files.atomic import atomic_folder

RING: dict[str, Any] = {"markersize": 11, "markerfacecolor": "none", "linewidth": 0.7, "markeredgewidth": 0.7}
NO_ERROR = 1e-9  # where plots show rows without error, which a logarithm cannot
COLUMNS = tuple(field.name for field in fields(BenchRow) if field.name != "kernels_ns")
MARKERS = "osD^vP*X<>"
COLORS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c564b", "#7f7f7f", "#882255",
    "#999933", "#332288",
)  # fmt: skip


def write(folder: Path, bench: Bench, also: Callable[[Path], None] = lambda _: None) -> None:
    """Write bench.json, bench.csv and the plots, and what `also` writes into the folder it is given: all or none.

    Raises FileError where the folder cannot be written, ClscoError where all cases were left out.
    """
    if not bench.rows:
        raise ClscoError(f"bench: some case must be short enough; got none, {bench.left_out[0]['why']}")
    content = rounded(asdict(bench))
    with atomic_folder(folder, "bench") as made:
        (made / "bench.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
        write_csv(made / "bench.csv", COLUMNS, content["rows"])
        also(made)
        for name, plot in PLOTS.items():
            plot(bench).savefig(made / name, dpi=100)


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[dict[str, Any]]) -> None:
    """Write the columns of rows to a CSV file."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        lines = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        lines.writeheader()
        lines.writerows(rows)


def rounded(value: Any) -> Any:
    """A tree of JSON values with six digits of each number, more than were measured."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return [rounded(item) for item in value] if isinstance(value, list | tuple) else value


def tables(bench: Bench) -> list[RenderableType]:
    """All rows, the fastest of each task first, and what was left out."""
    device = f"{bench.device['name']} ({bench.device['platform']})"
    title = f"{device}: {bench.roof.gb_per_s:.3g} GB/s, {bench.roof.gflop_per_s:.3g} GFLOP/s; ns per pixel and channel"
    shown = Table(title=Text(title), title_justify="left", box=SIMPLE, pad_edge=False)
    for name in ("px", "R, px", "PSF", "channels", "method", "precision"):
        shown.add_column(name, justify="right" if name in ("px", "channels") else "left", no_wrap=True)
    for name in ("ns", "kernels", "first call", "RMS", "largest", "memory", "of peak", "front"):
        shown.add_column(name, justify="right", no_wrap=True)
    for row in sorted(bench.rows, key=lambda row: (*row.task, row.cost_ns)):
        shown.add_row(
            f"{row.size}", ("to " if row.scene == "varying" else "= ") + f"{row.radius:g}", row.psf,
            f"{row.channels}", _method(row), row.precision, f"{row.cost_ns:.1f}", _number(row.device_ns, ".1f", ""),
            f"{row.first_call_s:.2f} s", f"{row.rms_error:.1e}", f"{row.largest_error:.1e}",
            _number(row.device_bytes, ".3g", " MiB", 2**-20), _number(row.of_peak, ".1f", " %", 100.0),
            "*" if row.on_front else "",
        )  # fmt: skip
    lines = [Text(f"{len(bench.left_out)} cases left out: left_out in bench.json")] if bench.left_out else []
    return [shown, *lines]


def _number(value: float | None, form: str, unit: str, scale: float = 1.0) -> str:
    return "" if value is None else f"{scale * value:{form}}{unit}"


def _method(row: BenchRow) -> str:
    return row.method if row.tool == "clsco" else f"{row.tool}, {row.method}"


def speed_error(bench: Bench) -> Any:
    """Cost against RMS error at the largest size; the front of each radius has rings, and a line."""
    figure, panels, colors = _panels(bench, "Speed against error", "RMS error, of white (none at all: 1e-9)")
    radii = sorted({row.radius for row in bench.rows})
    markers = {radius: MARKERS[k % len(MARKERS)] for k, radius in enumerate(radii)}
    for row in _plotted(bench):
        panel, color = panels[row.scene, row.psf], colors[_method(row)]
        point = ([max(row.rms_error, NO_ERROR)], [row.cost_ns])
        inside = color if row.precision == "double" else "none"
        panel.scatter(*point, marker=markers[row.radius], s=32, edgecolors=color, facecolors=inside)
    of_radius = attrgetter("scene", "psf", "radius")
    for (scene, psf, _), group in groupby(sorted(_front(bench), key=of_radius), key=of_radius):
        ends = sorted((max(row.rms_error, NO_ERROR), row.cost_ns) for row in group)
        panels[scene, psf].plot(*zip(*ends, strict=True), "o-", color="0.5", **RING)
    for panel in panels.values():
        panel.set_xscale("log")
    styles: dict[str, dict[str, Any]] = {
        f"R to {radius:g} px": {"marker": marker} for radius, marker in markers.items()
    }
    styles |= {"single precision": {"marker": "o", "markerfacecolor": "none"}}
    styles |= {"front of its R": {"marker": "o", "linestyle": "-", "color": "0.5"} | RING}
    _legend(figure, colors, styles)
    return figure


def cost_by_radius(bench: Bench) -> Any:
    """Cost against the largest radius at the largest size."""
    figure, panels, colors = _panels(bench, "Cost against radius", "largest radius, px")
    _lines(panels, colors, _plain(_plotted(bench)), lambda row: row.radius)
    for panel in panels.values():
        panel.set_xscale("symlog", linthresh=1.0)
        _ticks(panel, sorted({row.radius for row in bench.rows}))
    _legend(figure, colors, {})
    return figure


def cost_by_size(bench: Bench) -> Any:
    """Cost against the size at one radius, in the middle of those that there are."""
    radii = sorted({row.radius for row in bench.rows})
    radius = radii[len(radii) // 2]
    figure, panels, colors = _panels(bench, f"Cost against size, R up to {radius:g} px", "px a side")
    rows = [row for row in bench.rows if row.radius == radius and row.channels == _channels(bench)]
    _lines(panels, colors, _plain(rows), lambda row: row.size)
    for panel in panels.values():
        panel.set_xscale("log")
        _ticks(panel, sorted({row.size for row in bench.rows}))
    _legend(figure, colors, {})
    return figure


def roofline(bench: Bench) -> Any:
    """GFLOP/s of the passes' kernels below what the device can do, at the largest size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    panel: Any = figure.subplots()
    rows = [row for row in _plain(_plotted(bench)) if row.gflop_per_s is not None]
    colors = {name: color for name, color in _colors(bench.rows).items() if name in {row.method for row in rows}}
    markers = dict(zip(PSFS, MARKERS, strict=False))
    for row in rows:
        panel.plot([row.flop_per_byte], [row.gflop_per_s], markers[row.psf], color=colors[_method(row)], markersize=6)
    edge = bench.roof.gflop_per_s / bench.roof.gb_per_s
    ends = [row.flop_per_byte for row in rows]
    x = [min([*ends, edge]) / 2, edge, max([*ends, edge]) * 2]
    panel.plot(x, [bench.roof.at(each) for each in x], color="0.2")
    panel.set(xscale="log", yscale="log", xlabel="flop per byte that must move", ylabel="GFLOP/s, two per tap")
    panel.set_title(
        f"{bench.device['name']}\n{bench.roof.gb_per_s:.3g} GB/s triad, {bench.roof.gflop_per_s:.3g} GFLOP/s "
        f"multiply-add, {_size(bench)} px a side",
        fontsize=10,
    )
    panel.grid(alpha=0.3)
    _legend(figure, colors, {name: {"marker": marker} for name, marker in markers.items()})
    return figure


PLOTS: dict[str, Callable[[Bench], Any]] = {
    "speed_error.png": speed_error,
    "radius.png": cost_by_radius,
    "size.png": cost_by_size,
    "roofline.png": roofline,
}


def _size(bench: Bench) -> int:
    """The largest size among those that show most: calls may be too long, or time over, at larger ones."""
    shown: dict[int, set[object]] = {}
    for row in bench.rows:
        shown.setdefault(row.size, set()).add((row.scene, row.psf, row.radius))
    return max(shown, key=lambda size: (len(shown[size]), size))


def _channels(bench: Bench) -> int:
    """Plots show the fewest channels: the others are alike."""
    return min(row.channels for row in bench.rows)


def _plotted(bench: Bench) -> list[BenchRow]:
    size, channels = _size(bench), _channels(bench)
    return [row for row in bench.rows if row.size == size and row.channels == channels]


def _front(bench: Bench) -> list[BenchRow]:
    return [row for row in _plotted(bench) if row.on_front]


def _plain(rows: Iterable[BenchRow]) -> list[BenchRow]:
    """One precision of each method of clsco: double where the device has it."""
    alike = list(rows)
    wanted = "double" if any(row.precision == "double" for row in alike) else "single"
    return [row for row in alike if row.tool != "clsco" or row.precision == wanted]


def _colors(rows: Iterable[BenchRow]) -> dict[str, str]:
    """Methods of clsco first."""
    names = dict.fromkeys(_method(row) for row in sorted(rows, key=lambda row: row.tool != "clsco"))
    return {name: COLORS[k % len(COLORS)] for k, name in enumerate(names)}


def _panels(bench: Bench, title: str, x: str) -> tuple[Any, dict[tuple[str, str], Any], dict[str, str]]:
    """A figure with a panel for each scene and PSF that there is, and the methods' colors."""
    from matplotlib.figure import Figure

    titles = {"varying": "many radii", "constant": "one radius"}
    scenes = [scene for scene in titles if any(row.scene == scene for row in bench.rows)]
    figure = Figure(figsize=(11.0, 1.4 + 3.0 * len(scenes)), layout="constrained")
    grid = figure.subplots(len(scenes), len(PSFS), sharex=True, sharey=True, squeeze=False)
    panels = {}
    for scene, line in zip(scenes, grid, strict=True):
        for psf, panel in zip(PSFS, line, strict=True):
            panels[scene, psf] = panel
            panel.set_yscale("log")
            panel.set_title(f"{psf}, {titles[scene]}", fontsize=10)
            panel.grid(alpha=0.3)
        line[0].set_ylabel("ns per pixel and channel")
    for panel in grid[-1]:
        panel.set_xlabel(x)
    figure.suptitle(f"{title}; {bench.device['name']}", fontsize=11)
    return figure, panels, _colors(bench.rows)


def _lines(
    panels: dict[tuple[str, str], Any], colors: dict[str, str], rows: Sequence[BenchRow], x: Callable[[BenchRow], float]
) -> None:
    for (scene, psf), panel in panels.items():
        inside = sorted((row for row in rows if (row.scene, row.psf) == (scene, psf)), key=x)
        for name, color in colors.items():
            own = [row for row in inside if _method(row) == name]
            panel.plot([x(row) for row in own], [row.cost_ns for row in own], "o-", color=color, markersize=4)


def _ticks(panel: Any, values: Sequence[float]) -> None:
    panel.set_xticks(values, [f"{value:g}" for value in values])
    panel.set_xticks([], minor=True)


def _legend(figure: Any, colors: dict[str, str], styles: dict[str, dict[str, Any]]) -> None:
    """Key of the colors (methods) and marks of the panels, beside them."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=color, linewidth=3, label=name) for name, color in colors.items()]
    plain = {"linestyle": "none", "color": "0.3"}
    handles += [Line2D([], [], label=name, **(plain | style)) for name, style in styles.items()]
    figure.legend(handles=handles, loc="outside right upper", fontsize=9)
