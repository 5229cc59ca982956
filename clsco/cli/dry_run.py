"""Tables of `clsco dataset make --dry-run`."""

from __future__ import annotations

from rich.console import RenderableType

from clsco.cli.tables import print_tables, table
from clsco.data.dryrun import DryRun, SeenHistogram
from clsco.scene.formatting import format_bytes, format_seconds

BAR = 40  # characters of the longest bar


def dry_run_tables(found: DryRun) -> list[RenderableType]:
    """Tables of a data set to be made: parameters, measures of samples, size and time."""
    parameters = [
        (one.name, _number(one.low), _number(one.mean), _number(one.high), one.note) for one in found.parameters
    ]
    tables: list[RenderableType] = [
        table(
            f"Parameters of {found.looked_at - len(found.failed)} samples",
            ("parameter", "lowest", "mean", "highest", ""),
            parameters,
            ("lowest", "mean", "highest"),
        )
    ]
    if found.splits:
        rows = [(name, f"{share * found.count:.0f}", f"{share:.2%}") for name, share in found.splits.items()]
        tables.append(table("Splits, about", ("split", "samples", "share"), rows, ("samples", "share")))
    accepted = found.looked_at - len(found.failed)
    seen = [
        ("accepted", f"{accepted / max(1, found.attempts):.1%} of {found.attempts} attempts"),
        ("failed", f"{len(found.failed)}"),
        ("frames per sample", f"{found.frames:g}"),
        ("predicted work", f"{found.weights:.3g} weights per frame"),
    ]
    of = f"{found.looked_at} of {found.count} samples"
    tables.append(table(f"Looked at: {of}, with rays on a coarse grid", ("what", "how much"), seen))
    tables += [_histogram(one) for one in found.histograms]
    sizes = [(name, format_bytes(size), format_bytes(size * found.count)) for name, size in found.bytes.items()]
    total = sum(found.bytes.values())
    sizes.append(("in all", format_bytes(total), format_bytes(total * found.count)))
    tables.append(
        table("Size before compression", ("array", "per sample", "of the set"), sizes, ("per sample", "of the set"))
    )
    duration = "not known" if found.seconds is None else format_seconds(found.seconds)
    tables.append(table("Time", ("predicted", "from"), [(duration, found.basis)]))
    return tables


def print_dry_run(found: DryRun) -> None:
    """Print `dry_run_tables`, the messages of samples that failed, and where the contact sheet is."""
    print_tables(*dry_run_tables(found), *found.failed)
    if found.sheet is not None:
        print_tables(f"{found.sheet}: pictures of some samples")


def _histogram(one: SeenHistogram) -> RenderableType:
    most = max(one.shares)
    rows = [
        (f"{low:.4g} to {high:.4g}", f"{share:.1%}", "#" * round(BAR * share / most))
        for low, high, share in zip(one.edges, one.edges[1:], one.shares, strict=False)
    ]
    return table(one.name, ("from, to", "share", ""), rows, ("from, to", "share"))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"
