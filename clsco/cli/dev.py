"""The command `clsco dev`: figures of the thesis, comparisons with the reference, and measurements of a device."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from clsco.cli.options import (
    PATH,
    BenchExtent,
    bench_extent,
    device_option,
    quick_option,
    quiet_option,
    require_device,
)
from clsco.cli.output import echo
from clsco.errors import ClscoError

if TYPE_CHECKING:
    from clsco.cli.bench.command import BenchTask


@click.group()
def dev() -> None:
    """Check and measure clsco itself: the laboratory behind the documentation."""


@dev.command()
@click.option("-o", "out", metavar="DIR", required=True, type=PATH, help="Folder for the figures and the page.")
@click.option(
    "--only", "wanted", metavar="NUMBER", multiple=True,
    help="This figure or section, such as 4.14 or 4.3.3; may be given again. Default: all.",
)  # fmt: skip
@device_option
@quiet_option
def thesis(out: Path, wanted: tuple[str, ...], device: str | None, quiet: bool) -> None:
    """Render the figures of the thesis, with a page of the numbers that it states and those that are measured.

    DIR/thesis.html is the page, for a browser, and DIR/thesis.md the same as text; with --only they are called
    thesis_only. They are written when all else is there; each scene has a folder with its frames in DIR.
    """
    from clsco.cli.thesis_figures import chosen

    figures, numbers = chosen(wanted)
    require_device(device)
    from clsco.cli.thesis import PAGE, PART, render, write_page
    from clsco.files.atomic import remove, writable_folder

    name = PART if wanted else PAGE
    pages = [writable_folder(out) / f"{name}{ending}" for ending in (".html", ".md")]
    for page in pages:
        remove(page)  # an older page is not whole any more
    values = render(out, figures, numbers, device, quiet)
    write_page(out, name, figures, values)
    echo(f"{click.format_filename(pages[0])}: figures, and numbers as stated and as measured")


_bench_out = click.option(
    "-o", "out", metavar="DIR", required=True, type=PATH, help="Folder for the figures and plots."
)


@dev.command()
@_bench_out
@bench_extent
@device_option
@quiet_option
def bench(out: Path, extent: BenchExtent, device: str | None, quiet: bool) -> None:
    """Measure speed against error of the defocus pass: bench.json, bench.csv and plots in DIR.

    Time is process CPU time, on a graphics card that of its kernels; from radii on the device to the frame on the host.
    Errors are those of a crop, against the NumPy reference. Cases with long calls are left out, and named in the JSON.
    In a checkout, --compare adds the blur of numba and OpenCV; whole frames beside a ray-traced lens and Mitsuba's, and
    the forward warp beside numba's, but not where only some sizes or radii are asked for.
    """
    from clsco.cli.bench.command import speed_task

    _run(speed_task(extent), out, device, quiet)


@dev.command()
@_bench_out
@quick_option
@device_option
@quiet_option
def stability(out: Path, quick: bool, device: str | None, quiet: bool) -> None:
    """Measure errors of hard cases of numerics against an oracle of 106 bits: stability.json, CSV files and a plot."""
    from clsco.cli.bench.command import StabilityTask

    _run(StabilityTask(quick), out, device, quiet)


def _run(task: BenchTask, out: Path, device: str | None, quiet: bool) -> None:
    """Measure, print the tables, and fail where something is beyond its bound."""
    require_device(device)
    from clsco.cli.progress import progress
    from clsco.cli.tables import print_tables
    from clsco.files.atomic import writable_folder
    from clsco.opencl.device import choose

    for notice in task.notices():
        echo(notice, err=True)
    folder, chosen = writable_folder(out), choose(device)
    with progress(task.steps(chosen), quiet, "calls") as advance:
        tables, short = task.run(chosen, folder, advance)
    print_tables(*tables)
    if short:
        raise ClscoError(short)
