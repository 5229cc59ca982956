"""The command `clsco dataset`: makes data sets from distributions, inspects them, and checks them."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli import options
from clsco.cli.options import PATH, option
from clsco.cli.output import echo
from clsco.cli.progress import progress
from clsco.errors import ClscoError, SceneError
from clsco.scene.formatting import format_bytes, format_seconds

if TYPE_CHECKING:
    from clsco.data.creation import Progress
    from clsco.data.sets import DataSet, Status

SHOWN = 16  # samples on a sheet


@click.group()
def dataset() -> None:
    """Make data sets of many scenes drawn from distributions, look at them, and check them."""


def _parse_numbers(text: str) -> range:
    rule = "A:B, samples A to B - 1 counted from 0"
    return range(*options.parse_pair(text, r"(\d{1,12}):(\d{1,12})", rule, ordered=True))


def _parse_part(text: str) -> tuple[int, int]:
    return options.parse_pair(text, r"(\d{1,6})/(\d{1,6})", "I/N, with I from 0 to N - 1", ordered=True)


data_argument = click.argument("data", metavar="DATA")
base_option = option(
    "--base", "FOLDER", "Where the distribution file was, with its textures; default: here.", PATH, default=Path()
)
WORKERS = click.IntRange(1, 1024)


@dataset.command()
@click.argument("distribution", type=PATH)
@option("-o out", "DATA", "Folder of the set, or an address like s3://bucket/set.", required=True)
@option("--count", "N", "Samples of the set.", click.IntRange(1, 10**12))
@click.option("--seed", metavar="S", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@option("--shard-size", "N", "Samples of a shard, which is one file.", click.IntRange(1, 10**6), shown=256)
@option("--format", "NAME", "Of the files.", options.SET_FORMAT, shown="webdataset")
@option("--truth", "NAME,...", "Arrays of a sample besides color.", options.ARRAYS, shown="sharp,depth,coc")
@options.flag("--no-color", "Those arrays alone: no image is made, which is most of the work.")
@options.types_option
@option("--split splits", "NAME=SHARE,...", "Such as train=0.9,test=0.1.")
@option("--split-by", "KEY", "Parameter of samples; those with equal values share a split.", default="")
@option(
    "--device devices", "NAME", "Where to render; may be given again. all: all devices of the best kind.", multiple=True
)
@option("--workers", "N", "Processes. Default: one for each graphics card, or for each core of a processor.", WORKERS)
@option("--scheduler", "ADDRESS", "Of a dask.distributed cluster that renders, like tcp://host:8786.", default="")
@options.flag("--resume", "Go on with the set in DATA.")
@option("--only", "A:B", "Samples A to B - 1 alone.", _parse_numbers)
@option("--part", "I/N", "Only every N-th shard, from I = 0 on, for array jobs.", _parse_part)
@options.flag("--dry-run", "Draw only: ranges, a contact sheet, predicted time and bytes.")
@option("--license", "TEXT", "For the data card.", default="")
@option("--allow-failures", "N", "Samples that may fail; with more, the exit status is 1.", click.IntRange(0), shown=0)
@options.set_option
@options.precision_option
@options.quiet_option
def make(distribution: Path, out: str, devices: tuple[str, ...], quiet: bool, **values: Any) -> None:
    """Make a data set of scenes drawn from a DISTRIBUTION file.

    The same file, seed and version give the same bytes on all devices of a family.
    """
    from clsco.data import creation
    from clsco.data.record import parse_stored

    color = not values.pop("no_color")
    try:
        samples = creation.sample_numbers(values["count"], values["only"])
        arrays, _ = creation.stored_arrays(values["truth"], color), parse_stored(values["types"])
    except SceneError as error:
        raise options.usage_error(error) from None
    if values.pop("dry_run"):
        _dry_run(distribution, out, samples, arrays, values)
        return
    if values["scheduler"] and (devices or values["workers"]):
        raise click.UsageError("--scheduler: its workers have devices; got --device or --workers as well")
    if not values["scheduler"]:
        options.require_opencl()
    try:
        status = creation.make(distribution, out, color=color, devices=devices, progress=_bar(quiet), **values)
    except creation.FailedSamplesError as error:
        echo(_line(out, error.status))
        raise
    echo(_line(out, status))


def _bar(quiet: bool) -> Progress:
    return lambda total: progress(total, quiet, "samples")


def _dry_run(distribution: Path, out: str, samples: range, arrays: tuple[str, ...], values: dict[str, Any]) -> None:
    from clsco.cli.tables import print_dry_run
    from clsco.data.distribution import load_distribution
    from clsco.data.dryrun import dry_run

    drawn = load_distribution(distribution, values["overrides"], values["splits"], split_by=values["split_by"])
    sheet = Path("dry_run.png" if "://" in out else f"{out.rstrip('/')}_dry_run.png")
    forecast = dry_run(drawn, values["seed"], len(samples), arrays=arrays, sheet_path=sheet)
    print_dry_run(forecast)
    if forecast.fails:
        raise SceneError(f"{distribution}: at least one sample must be possible; got {forecast.looked_at} that failed")


def _line(out: str, status: Status) -> str:
    failed = f", {status.failed} failed" if status.failed else ""
    whole = "" if status.is_whole else f" of {status.shards}, as far as it is made"
    shards = len(status.done)
    samples = f"{status.made} samples in {shards} shard{'' if shards == 1 else 's'}"
    return f"{click.format_filename(out)}: {samples}{whole}{failed}, {format_bytes(status.bytes)}"


@contextmanager
def _opened(data: str) -> Iterator[DataSet]:
    from clsco.data.sets import open_set
    from clsco.data.storage import open_storage

    with closing(open_storage(data)) as storage:
        yield open_set(storage)


@dataset.command()
@data_argument
def status(data: str) -> None:
    """Report how much of a set has been made; nothing is written."""
    from clsco.data.sets import ranges, status_of

    with _opened(data) as there:
        state = status_of(there)
    echo(f"shards: {len(state.done)} of {state.shards}")
    echo(f"samples: {state.made} made, {state.failed} failed, of {state.samples}; {format_bytes(state.bytes)}")
    if state.rate is not None and not state.is_whole:
        echo(f"rate: {state.rate:.3g} samples/s, {format_seconds(state.seconds_left or 0.0)} left at this rate")
    if missing := [shard for shard in there.shards if shard not in state.done]:
        echo(f"missing: {ranges(missing)}")
    for fault in state.faults:
        echo(f"incomplete: {fault}")


@dataset.command()
@data_argument
@option("--sample", "N", "Samples, spread over the set, that are rendered again.", click.IntRange(0), shown=16)
@option("--device", "NAME", "Where to render them.")
@option("--draw", "MODULE:FUNCTION", "The function that made the set, where scenes have arrays.")
@base_option
@options.quiet_option
def verify(data: str, sample: int, device: str | None, draw: str | None, base: Path, quiet: bool) -> None:
    """Check a set: hashes of all files and arrays, and samples rendered again, bit by bit.

    Prints a line for each finding; if there are any, the exit status is 1.
    """
    from clsco.data.verify import chosen_samples, drawn_again, hold_arrays, verify_files, verify_samples

    with _opened(data) as there:
        if draw is not None:
            sys.path.insert(0, str(Path.cwd()))  # the user's own modules are in the current folder
        drawn = None if draw is None else drawn_again(there, draw, base)
        with progress(len(there.shards) + sample, quiet, "checks") as advance:
            findings = verify_files(there, advance)
            chosen = chosen_samples(there, sample)
            left_out = hold_arrays(there, chosen) if drawn is None else []
            chosen = [number for number in chosen if number not in left_out]
            findings += verify_samples(there, chosen, device, advance, base, drawn)
    for finding in findings:
        echo(finding)
    if findings:
        raise ClscoError(f"{data}: must be as it was made; got {len(findings)} findings")
    name, more = click.format_filename(data), ""
    if left_out:
        more = f", not {len(left_out)} with arrays that their function alone makes"
    echo(f"{name}: {len(there.samples)} samples as recorded, {len(chosen)} rendered again{more}")


@dataset.command()
@data_argument
@option("-o out", "DATA", "Folder or address of the new set; by default it is removed again.")
@option("--device devices", "NAME", "Where to render; may be given again.", multiple=True)
@option("--workers", "N", "Processes, as of clsco dataset make.", WORKERS)
@base_option
@options.quiet_option
def remake(data: str, out: str | None, devices: tuple[str, ...], workers: int | None, base: Path, quiet: bool) -> None:
    """Make a set again from its data card, and compare the bytes.

    Prints a line for each difference; if there are any, the exit status is 1.
    """
    from clsco.data import copies

    options.require_opencl()
    differences = copies.remake(data, out, folder=base, devices=devices, workers=workers, progress=_bar(quiet))
    for line in differences:
        echo(line)
    if differences:
        raise ClscoError(f"{data}: must be what is made again; got {len(differences)} differences")
    echo(f"{click.format_filename(data)}: made again, all bytes are the same")


@dataset.command(name="open")
@data_argument
@option("--sheet", "FILE", "Also write pictures of the first samples, as PNG.", PATH)
def open_data(data: str, sheet: Path | None) -> None:
    """Report what a set contains: samples, splits, arrays, and how to load it."""
    from clsco.cli.tables import print_tables, table
    from clsco.data.card import loading_lines
    from clsco.data.dataset import open as opened
    from clsco.data.dataset import record_sheet
    from clsco.files.images import write_png

    records = opened(data)
    card = records.card
    rows = [
        (name, about["dtype"], " x ".join(map(str, about["shape"])), about["unit"], about["convention"])
        for name, about in card.get("arrays", {}).items()
    ]
    with _opened(data) as there:
        loading = loading_lines(there.storage, there.identity, card["files"])
    place = json.dumps(data)[:-1]
    splits = ", ".join(f"{sum(count for _, count in files)} of {name}" for name, files in card["files"].items() if name)
    about = f"{len(records)} samples{f' ({splits})' if splits else ''}, {card['identity']['format']}"
    print_tables(
        f"{click.format_filename(data)}: {about}",
        table("Arrays", ("array", "type", "shape", "unit", "what it is"), rows),
        *(line.replace('"DATA', place) for line in loading),
    )
    if sheet is not None:
        write_png(sheet, record_sheet(records[:SHOWN]))
        echo(f"{click.format_filename(sheet)}: pictures of {min(SHOWN, len(records))} samples")
    records.close()


@dataset.command()
@data_argument
@click.argument("number", type=click.IntRange(0))
@base_option
def show(data: str, number: int, base: Path) -> None:
    """Print the scene of sample NUMBER of a set as TOML: a scene file for clsco render."""
    from clsco.data.build import located
    from clsco.data.verify import hold_arrays, scene_table
    from clsco.scene.toml import toml_text

    with _opened(data) as there:
        if hold_arrays(there, [number]):
            raise SceneError(f"sample {number}: must be a scene of files; got arrays, which its function alone makes")
        echo(toml_text(located(scene_table(there, number), base.absolute())), nl=False)


@dataset.command(short_help="Write a data set in another format.")
@data_argument
@option("-o out", "OUT", "Folder for it, or an address like s3://bucket/set.", required=True)
@option(
    "--format form", "NAME", "webdataset, npz, hdf5 or zarr, each also uncompressed, like npz+raw.", options.SET_FORMAT,
    required=True,
)  # fmt: skip
@options.flag("--resume", "Go on with the conversion in OUT.")
@options.quiet_option
def convert(data: str, out: str, form: str, resume: bool, quiet: bool) -> None:
    """Write the data set DATA in another format. All arrays keep their bits."""
    from clsco.data.copies import convert as convert_set
    from clsco.data.storage import open_storage

    with ExitStack() as stack:
        source, target = (stack.enter_context(closing(open_storage(place))) for place in (data, out))
        target.tidy()
        _, status = convert_set(
            source, target, form, resume, lambda count: stack.enter_context(progress(count, quiet, "shards"))
        )
    echo(f"{_line(out, status)}, as {form}")
