"""Tables of `clsco dataset make --dry-run`."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import RenderableType

from clsco.cli.tables import print_tables, table
from clsco.data.dryrun import DryRun, Summary
from clsco.scene.formatting import format_bytes, format_seconds


def dry_run_tables(dry_run: DryRun) -> list[RenderableType]:
    """Tables of a planned data set: parameters, measures of samples, size and time."""
    tables: list[RenderableType] = [
        _summaries(f"Parameters of {dry_run.looked_at - len(dry_run.failed)} samples", "parameter", dry_run.parameters)
    ]
    if dry_run.splits:
        rows = [(name, f"{share * dry_run.count:.0f}", f"{share:.2%}") for name, share in dry_run.splits.items()]
        tables.append(table("Splits, about", ("split", "samples", "share"), rows, ("samples", "share")))
    accepted = dry_run.looked_at - len(dry_run.failed)
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
    return tables


def print_dry_run(dry_run: DryRun) -> None:
    """Print `dry_run_tables`, messages of failed samples, and the path of the contact sheet."""
    print_tables(*dry_run_tables(dry_run), *dry_run.failed)
    if dry_run.sheet is not None:
        print_tables(f"{dry_run.sheet}: pictures of some samples")


def _summaries(title: str, what: str, summaries: Sequence[Summary]) -> RenderableType:
    rows = [(one.name, _number(one.low), _number(one.mean), _number(one.high), one.note) for one in summaries]
    return table(title, (what, "lowest", "mean", "highest", ""), rows, ("lowest", "mean", "highest"))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"
