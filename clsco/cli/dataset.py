"""The command `clsco dataset`: makes data sets from distributions, inspects them, and checks them."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli.options import (
    ARRAYS,
    PATH,
    SET_FORMAT,
    precision_option,
    quiet_option,
    require_opencl,
    set_option,
    types_option,
    usage_error,
)
from clsco.cli.output import echo
from clsco.cli.progress import progress
from clsco.errors import ClscoError, SceneError
from clsco.scene.formatting import format_bytes, format_seconds

if TYPE_CHECKING:
    from clsco.data.creation import Progress
    from clsco.data.sets import Status

SHOWN = 16  # samples on a sheet


@click.group()
def dataset() -> None:
    """Make data sets of many scenes drawn from distributions, look at them, and check them."""


def _parse_numbers(text: str) -> range:
    match = re.fullmatch(r"(\d{1,12}):(\d{1,12})", text, re.ASCII)
    if match is None or not (numbers := range(int(match[1]), int(match[2]))):
        raise click.BadParameter(f"must be A:B, samples A to B - 1 counted from 0; got {text}")
    return numbers


def _parse_part(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text, re.ASCII)
    if match is None or int(match[1]) >= int(match[2]):
        raise click.BadParameter(f"must be I/N, with I from 0 to N - 1; got {text}")
    return int(match[1]), int(match[2])


data_argument = click.argument("data", metavar="DATA")
base_option = click.option(
    "--base", metavar="FOLDER", type=PATH, default=Path(),
    help="Where the distribution file was, with its textures; default: here.",
)  # fmt: skip


@dataset.command()
@click.argument("distribution", type=PATH)
@click.option("-o", "out", metavar="DATA", required=True, help="Folder of the set, or an address like s3://bucket/set.")
@click.option("--count", metavar="N", type=click.IntRange(1, 10**12), help="Samples of the set.")
@click.option("--seed", metavar="S", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@click.option(
    "--shard-size", metavar="N", type=click.IntRange(1, 10**6), default=256, show_default=True,
    help="Samples of a shard, which is one file.",
)  # fmt: skip
@click.option(
    "--format", metavar="NAME", type=SET_FORMAT, default="webdataset", show_default=True, help="Of the files."
)
@click.option(
    "--truth", metavar="NAME,...", type=ARRAYS, default="sharp,depth,coc", show_default=True,
    help="Arrays of a sample besides color.",
)  # fmt: skip
@click.option("--no-color", is_flag=True, help="Those arrays alone: no image is made, which is most of the work.")
@types_option
@click.option("--split", "splits", metavar="NAME=SHARE,...", help="Such as train=0.9,test=0.1.")
@click.option(
    "--device", "devices", metavar="NAME", multiple=True,
    help="Where to render; may be given again. all: all devices of the best kind.",
)  # fmt: skip
@click.option(
    "--workers", metavar="N", type=click.IntRange(1, 1024),
    help="Processes. Default: one for each graphics card, or for each core of a processor.",
)  # fmt: skip
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    default="",
    help="Of a dask.distributed cluster that renders, like tcp://host:8786.",
)
@click.option("--resume", is_flag=True, help="Go on with the set in DATA.")
@click.option("--only", metavar="A:B", type=_parse_numbers, help="Samples A to B - 1 alone.")
@click.option("--part", metavar="I/N", type=_parse_part, help="Only every N-th shard, from I = 0 on, for array jobs.")
@click.option("--dry-run", is_flag=True, help="Draw only: ranges, a contact sheet, predicted time and bytes.")
@click.option("--license", metavar="TEXT", default="", help="For the data card.")
@click.option(
    "--allow-failures", metavar="N", type=click.IntRange(0), default=0, show_default=True,
    help="Samples that may fail; with more, the exit status is 1.",
)  # fmt: skip
@set_option
@precision_option
@quiet_option
def make(distribution: Path, out: str, devices: tuple[str, ...], quiet: bool, **options: Any) -> None:
    """Make a data set of scenes drawn from a DISTRIBUTION file.

    The same file, seed and version give the same bytes on all devices of a family.
    """
    from clsco.data import creation
    from clsco.data.record import parse_stored

    color = not options.pop("no_color")
    try:
        samples = creation.sample_numbers(options["count"], options["only"])
        arrays, _ = creation.stored_arrays(options["truth"], color), parse_stored(options["types"])
    except SceneError as error:
        raise usage_error(error) from None
    if options.pop("dry_run"):
        _dry_run(distribution, out, samples, arrays, options)
        return
    if options["scheduler"] and (devices or options["workers"]):
        raise click.UsageError("--scheduler: its workers have devices; got --device or --workers as well")
    if not options["scheduler"]:
        require_opencl()
    try:
        status = creation.make(distribution, out, color=color, devices=devices, progress=_bar(quiet), **options)
    except creation.FailedSamplesError as error:
        echo(_line(out, error.status))
        raise
    echo(_line(out, status))


def _bar(quiet: bool) -> Progress:
    @contextmanager
    def shown(total: int) -> Iterator[Callable[[int], object]]:
        with progress(total, quiet, "samples") as bar:
            yield lambda count: [bar() for _ in range(count)]

    return shown


def _dry_run(distribution: Path, out: str, samples: range, arrays: tuple[str, ...], options: dict[str, Any]) -> None:
    from clsco.cli.dry_run import print_dry_run
    from clsco.data.distribution import load_distribution
    from clsco.data.dryrun import dry_run

    drawn = load_distribution(distribution, options["overrides"], options["splits"])
    sheet = Path("dry_run.png" if "://" in out else f"{out.rstrip('/')}_dry_run.png")
    forecast = dry_run(drawn, options["seed"], len(samples), arrays=arrays, sheet_path=sheet)
    print_dry_run(forecast)
    if forecast.fails:
        raise SceneError(f"{distribution}: at least one sample must be possible; got {forecast.looked_at} that failed")


def _line(out: str, status: Status) -> str:
    """Summary of a set in one line."""
    failed = f", {status.failed} failed" if status.failed else ""
    whole = "" if status.is_whole else f" of {status.shards}, as far as it is made"
    shards = len(status.done)
    samples = f"{status.made} samples in {shards} shard{'' if shards == 1 else 's'}"
    return f"{click.format_filename(out)}: {samples}{whole}{failed}, {format_bytes(status.bytes)}"


@dataset.command()
@data_argument
def status(data: str) -> None:
    """Report how much of a set has been made; nothing is written."""
    from clsco.data.sets import open_set, ranges, status_of
    from clsco.data.storage import open_storage

    there = open_set(open_storage(data))
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
@click.option(
    "--sample", metavar="N", type=click.IntRange(0), default=16, show_default=True,
    help="Samples, spread over the set, that are rendered again.",
)  # fmt: skip
@click.option("--device", metavar="NAME", help="Where to render them.")
@click.option("--draw", metavar="MODULE:FUNCTION", help="The function that made the set, where scenes have arrays.")
@base_option
@quiet_option
def verify(data: str, sample: int, device: str | None, draw: str | None, base: Path, quiet: bool) -> None:
    """Check a set: hashes of all files and arrays, and samples rendered again, bit by bit.

    Prints a line for each finding; if there are any, the exit status is 1.
    """
    from clsco.data.sets import open_set
    from clsco.data.storage import open_storage
    from clsco.data.verify import chosen_samples, drawn_again, hold_arrays, verify_files, verify_samples

    with closing(open_storage(data)) as storage:
        there = open_set(storage)
        if draw is not None:
            sys.path.insert(0, str(Path.cwd()))  # where a user's own modules lie
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
@click.option("-o", "out", metavar="DATA", help="Folder or address of the new set; by default it is removed again.")
@click.option("--device", "devices", metavar="NAME", multiple=True, help="Where to render; may be given again.")
@click.option("--workers", metavar="N", type=click.IntRange(1, 1024), help="Processes, as of clsco dataset make.")
@base_option
@quiet_option
def remake(data: str, out: str | None, devices: tuple[str, ...], workers: int | None, base: Path, quiet: bool) -> None:
    """Make a set again from its data card, and compare the bytes.

    Prints a line for each difference; if there are any, the exit status is 1.
    """
    from clsco.data import copies

    require_opencl()
    differences = copies.remake(data, out, folder=base, devices=devices, workers=workers, progress=_bar(quiet))
    for line in differences:
        echo(line)
    if differences:
        raise ClscoError(f"{data}: must be what is made again; got {len(differences)} differences")
    echo(f"{click.format_filename(data)}: made again, all bytes are the same")


@dataset.command(name="open")
@data_argument
@click.option("--sheet", metavar="FILE", type=PATH, help="Also write pictures of the first samples, as PNG.")
def open_data(data: str, sheet: Path | None) -> None:
    """Report what a set contains: samples, splits, arrays, and how to load it."""
    from clsco.cli.tables import print_tables, table
    from clsco.data.card import loading_lines
    from clsco.data.dataset import open as opened
    from clsco.data.dataset import record_sheet
    from clsco.data.sets import open_set
    from clsco.data.storage import open_storage
    from clsco.files.images import write_png

    records = opened(data)
    card = records.card
    rows = [
        (name, about["dtype"], " x ".join(map(str, about["shape"])), about["unit"], about["convention"])
        for name, about in card.get("arrays", {}).items()
    ]
    with closing(open_storage(data)) as storage:
        loading = loading_lines(storage, open_set(storage).identity, card["files"])
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
    from clsco.data.sets import open_set
    from clsco.data.storage import open_storage
    from clsco.data.verify import hold_arrays, scene_table
    from clsco.scene.toml import toml_text

    with closing(open_storage(data)) as storage:
        there = open_set(storage)
        if hold_arrays(there, [number]):
            raise SceneError(f"sample {number}: must be a scene of files; got arrays, which its function alone makes")
        echo(toml_text(located(scene_table(there, number), base.absolute())), nl=False)


@dataset.command(short_help="Write a data set in another format.")
@click.argument("data", metavar="DATA")
@click.option("-o", "out", metavar="OUT", required=True, help="Folder for it, or an address like s3://bucket/set.")
@click.option(
    "--format", "form", metavar="NAME", type=SET_FORMAT, required=True,
    help="webdataset, npz, hdf5 or zarr, each also uncompressed, like npz+raw.",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with the conversion in OUT.")
@quiet_option
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
    place = click.format_filename(out)
    echo(f"{place}: {status.made} samples in {len(status.done)} shards, {status.failed} failed, as {form}")
