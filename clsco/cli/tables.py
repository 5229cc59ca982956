"""Tables for the terminal: reports of inpainting, OpenCL devices with their self-tests, and planned data sets."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from clsco.errors import visible
from clsco.scene.formatting import format_bytes, format_seconds

if TYPE_CHECKING:
    from clsco.data.dryrun import DryRun, Summary
    from clsco.inpainting.report import Report
    from clsco.opencl.device import Device
    from clsco.opencl.self_test import Check


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[str] = ()) -> Group:
    """A table of plain text; columns named in `right` are aligned right, as numbers."""
    body = Table(box=SIMPLE, pad_edge=False)
    for name in columns:
        body.add_column(Text(name), justify="right" if name in right else "left", overflow="fold")
    for row in rows:
        body.add_row(*(Text(visible(cell)) for cell in row))
    heading = Text(visible(title), no_wrap=True, overflow="ignore", style="italic")  # a table's title would be wrapped
    return Group(heading, body)


def inpaint_tables(report: Report) -> list[RenderableType]:
    """Tables on a filled image; for the method mean-median, with the figures of figure 5.21 of the thesis."""
    figures, rows = report.figures(), [("missing pixels", f"{report.missing_pixels}")]
    if "border_pixels" in figures:
        rows += [("border pixels", f"{figures['border_pixels']}"), ("sweeps", f"{figures['sweeps']}")]
    if "gradient_range" in figures:
        low, high = figures["gradient_range"]
        rows += [("gradients of border pixels", f"{low:.4g} to {high:.4g}")]
        rows += [("blended", f"{figures['blended_pixels']}, from {figures['threshold']:.4g} on")]
    if "mse" in figures:
        chosen = zip(figures["mse"]["neighbors"], figures["mse"]["chosen"], strict=True)
        of = ", ".join(f"{k}: {name}" for k, name in chosen)
        rows += [("estimator, by known neighbors", of)]
    rows += [("seconds", f"{report.seconds:.3g}")]
    size = " x ".join(f"{n}" for n in (report.shape[1], report.shape[0]))
    return [table(f"Filled by {report.method}: {size} pixels", ("what", "how much"), rows)]


def device_tables(
    devices: Sequence[Device], used: Device | None, checks: Mapping[Device, Sequence[Check]]
) -> list[RenderableType]:
    """Tables of devices and their features, and of the results of self-tests if they ran."""
    yes = {True: "yes", False: "no"}
    columns = ("", "device", "platform", "kind", "units", "memory", "double", "64-bit atomics", "exact division")
    rows = [
        (
            "*" if device == used else "", device.name, f"{device.platform} {device.driver}", device.kind,
            f"{device.compute_units}", f"{device.global_mem / 2**30:.1f} GiB", yes[device.has_fp64],
            yes[device.has_int64_atomics], yes[device.correctly_rounded],
        )
        for device in devices
    ]  # fmt: skip
    tables: list[RenderableType] = [table("OpenCL devices (* is used)", columns, rows, right=("units", "memory"))]
    for device, results in checks.items():
        answers = [(check.name, "passed" if check.passed else "failed", check.detail) for check in results]
        tables.append(table(f"Self-test of {device}", ("check", "result", "detail"), answers))
    return tables


def print_tables(*things: RenderableType) -> None:
    """Print to stdout, as wide as the terminal, or 160 columns wide if there is none. A closed stdout is no error."""
    if sys.stdout is None:
        return
    width = None if sys.stdout.isatty() else 160
    shown = [visible(thing, lines=True) if isinstance(thing, str) else thing for thing in things]
    Console(width=width, markup=False, highlight=False, emoji=False).print(*shown, sep="\n", crop=False)


def print_dry_run(dry_run: DryRun) -> None:
    """Print tables of a planned data set, messages of failed samples, and the path of the contact sheet."""
    accepted = dry_run.looked_at - len(dry_run.failed)
    tables: list[RenderableType] = [_summaries(f"Parameters of {accepted} samples", "parameter", dry_run.parameters)]
    if dry_run.splits:
        rows = [(name, f"{share * dry_run.count:.0f}", f"{share:.2%}") for name, share in dry_run.splits.items()]
        tables.append(table("Splits, about", ("split", "samples", "share"), rows, ("samples", "share")))
    seen = [
        ("accepted", f"{accepted / max(1, dry_run.attempts):.1%} of {dry_run.attempts} attempts"),
        ("failed", f"{len(dry_run.failed)}"),
        ("frames per sample", f"{dry_run.frames:g}"),
    ]
    of = f"{dry_run.looked_at} of {dry_run.count} samples"
    tables.append(table(f"Looked at: {of}, with rays on a coarse grid", ("what", "how much"), seen))
    if dry_run.measures:
        tables.append(_summaries("What rays see", "measure", dry_run.measures))
    sizes = [(name, format_bytes(size), format_bytes(size * dry_run.count)) for name, size in dry_run.bytes.items()]
    total = sum(dry_run.bytes.values())
    sizes.append(("in all", format_bytes(total), format_bytes(total * dry_run.count)))
    if dry_run.bytes:
        columns = ("array", "per sample", "of the set")
        tables.append(table("Size before compression", columns, sizes, columns[1:]))
    duration = "not known" if dry_run.seconds is None else format_seconds(dry_run.seconds)
    tables.append(table("Time", ("predicted", "from"), [(duration, dry_run.basis)]))
    print_tables(*tables, *dry_run.failed)
    if dry_run.sheet is not None:
        print_tables(f"{dry_run.sheet}: pictures of some samples")


def _summaries(title: str, what: str, summaries: Sequence[Summary]) -> RenderableType:
    rows = []
    for one in summaries:
        low, mean, high = ("" if value is None else f"{value:.5g}" for value in (one.low, one.mean, one.high))
        rows.append((one.name, low, mean, high, one.note))
    return table(title, (what, "lowest", "mean", "highest", ""), rows, ("lowest", "mean", "highest"))
