"""Measure clsco: python -m benchmarks blur|stability|thesis -o DIR"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import click
from rich.console import RenderableType

from benchmarks.blur import measure, report
from benchmarks.blur.cases import BenchGrid, make_grid
from benchmarks.thesis import page
from benchmarks.thesis.figures import chosen
from clsco.cli.main import Commands
from clsco.cli.options import PATH, device_option, quiet_option, require_device
from clsco.cli.output import echo
from clsco.cli.progress import progress
from clsco.cli.tables import print_tables
from clsco.errors import ClscoError, require_extra
from clsco.files.atomic import make_writable_folder, remove_file
from clsco.opencl.device import Device, choose

Advance = Callable[[], object]
Outcome = tuple[list[RenderableType], str]
"""Tables, and what falls short of its bound in one line, or ""."""


class Task(Protocol):
    """Measurement of a command."""

    def notices(self) -> list[str]:
        """Notes on cases that are left out, a line each. Raises ClscoError where an extra is missing."""

    def steps(self, device: Device) -> int:
        """Number of times that `run` calls `advance`."""

    def run(self, device: Device, folder: Path, advance: Advance) -> Outcome:
        """Measure, and write the files."""


@dataclass(frozen=True)
class Blur:
    """Speed against error of the blur, see `benchmarks.blur.measure`."""

    grid: BenchGrid

    def notices(self) -> list[str]:
        require_extra("blur", "matplotlib", "bench")
        return []

    def steps(self, device: Device) -> int:
        return measure.steps(self.grid, device, ())

    def run(self, device: Device, folder: Path, advance: Advance) -> Outcome:
        bench = measure.run(self.grid, device, (), advance)
        report.write(folder, bench)
        return report.tables(bench), ""


@dataclass(frozen=True)
class Stability:
    """Errors of hard cases of numerics, see `benchmarks.stability.report`."""

    quick: bool

    def notices(self) -> list[str]:
        require_extra("stability", "matplotlib", "bench")
        return []

    def steps(self, device: Device) -> int:
        del device
        return _import("stability.report").steps(self.quick)

    def run(self, device: Device, folder: Path, advance: Advance) -> Outcome:
        stability_report = _import("stability.report")
        stability = stability_report.run(device, self.quick, advance)
        stability_report.write(folder, stability)
        short = stability.shortfalls()
        line = f"stability: every error must be within its bound; got {len(short)} beyond: {short[0]}" if short else ""
        return stability_report.tables(stability), line


def _import(name: str) -> Any:
    """A module of the benchmarks. Raises ClscoError where it needs one that is not installed."""
    try:
        return import_module(f"benchmarks.{name}")
    except ModuleNotFoundError as error:
        raise ClscoError(f"{name}: needs {error.name}: pip install 'clsco[bench]'; got no such module") from None


@click.group(cls=Commands)
def main() -> None:
    """Measure clsco itself: the figures behind the documentation."""


out_option = click.option("-o", "out", metavar="DIR", required=True, type=PATH, help="Folder for figures and plots.")
quick_option = click.option("--quick", is_flag=True, help="A small grid: a minute or two on a slow machine.")


@main.command()
@out_option
@click.option(
    "--only", "numbers", metavar="NUMBER", multiple=True,
    help="This figure or section, such as 4.14 or 4.3.3; may be given again. Default: all.",
)  # fmt: skip
@device_option
@quiet_option
def thesis(out: Path, numbers: tuple[str, ...], device: str | None, quiet: bool) -> None:
    """Render the figures of the thesis, with a page of the numbers that it states and those that are measured.

    DIR/thesis.html is the page, for a browser, DIR/thesis.md that of the documentation, and DIR/thesis_numbers.md all
    numbers; with --only they are called thesis_only. They are written when all else is there; each scene has a folder
    with its frames in DIR.
    """
    figures, stated = chosen(numbers)
    require_device(device)
    name = page.PART if numbers else page.PAGE
    pages = [make_writable_folder(out) / f"{name}{ending}" for ending in (".html", ".md", page.NUMBERS_PAGE)]
    for path in pages:
        remove_file(path)  # an older page is not whole any more
    page.write_page(out, name, figures, page.render(out, figures, stated, device, quiet))
    echo(f"{click.format_filename(pages[0])}: figures, and numbers as stated and as measured")


@main.command()
@out_option
@quick_option
@click.option("--compare", is_flag=True, help="Also measure numba, OpenCV and Mitsuba, as far as they are installed.")
@click.option("--size", "sizes", metavar="PX", type=int, multiple=True, help="Pixels a side; may be given again.")
@click.option("--radius", "radii", metavar="PX", type=float, multiple=True, help="Largest radius; may be given again.")
@click.option("--minutes", metavar="M", type=float, help="Begin no case later, and leave out what is left.")
@device_option
@quiet_option
def blur(
    out: Path,
    quick: bool,
    compare: bool,
    sizes: tuple[int, ...],
    radii: tuple[float, ...],
    minutes: float | None,
    device: str | None,
    quiet: bool,
) -> None:
    """Measure speed against error of the defocus pass: bench.json, bench.csv and plots in DIR.

    Time is process CPU time, on a graphics card that of its kernels; from radii on the device to the frame on the host.
    Errors are those of a crop, against the NumPy reference. Cases with long calls are left out, and named in the JSON.
    --compare adds the blur of numba and OpenCV; whole frames beside a ray-traced lens and Mitsuba's, and the forward
    warp beside numba's, but not where only some sizes or radii are asked for.
    """
    grid = make_grid(quick, sizes, radii, minutes)
    if compare:
        _run(_import("speed.compare").comparison(grid, quick, not (sizes or radii)), out, device, quiet)
    else:
        _run(Blur(grid), out, device, quiet)


@main.command()
@out_option
@quick_option
@device_option
@quiet_option
def stability(out: Path, quick: bool, device: str | None, quiet: bool) -> None:
    """Measure errors of hard cases of numerics against an oracle of 106 bits: stability.json, CSV files and a plot."""
    _run(Stability(quick), out, device, quiet)


def _run(task: Task, out: Path, device: str | None, quiet: bool) -> None:
    """Measure, print the tables, and fail where something is beyond its bound."""
    require_device(device)
    for notice in task.notices():
        echo(notice, err=True)
    folder, on = make_writable_folder(out), choose(device)
    with progress(task.steps(on), quiet, "calls") as advance:
        tables, shortfall = task.run(on, folder, advance)
    print_tables(*tables)
    if shortfall:
        raise ClscoError(shortfall)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
