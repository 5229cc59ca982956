"""The command `clsco batch`: data sets made from a distribution, looked at, and checked."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli.options import OF_THE_IMAGE, PATH, precision_option, quiet_option, require_opencl, set_option
from clsco.cli.output import echo
from clsco.errors import ClscoError, SceneError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsco.data.distribution import Distribution
    from clsco.data.manifest import Identity
    from clsco.data.pool import Place
    from clsco.data.sets import Status

WORKER_SHARE = 0.5  # of the machine's memory, for all processes together


class _WithDefault(click.Group):
    """A group of which `batch FILE` is `batch make FILE`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command first where none is named."""
        if not args or args[0] not in self.commands:
            args = ["make", *(args or ["--help"])]
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Show `clsco batch FILE` in usage, without `make`."""
        name, command, rest = super().resolve_command(ctx, args)
        return (None if name == "make" else name), command, rest


@click.group(cls=_WithDefault, name="batch", short_help="Make a data set of many scenes drawn from distributions.")
def batch() -> None:
    """Make, look at and check data sets."""


def _parse_numbers(text: str) -> range:
    match = re.fullmatch(r"(\d{1,12}):(\d{1,12})", text, re.ASCII)
    if match is None or not (found := range(int(match[1]), int(match[2]))):
        raise click.BadParameter(f"must be A:B, samples A to B - 1 counted from 0; got {text}")
    return found


def _parse_part(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text, re.ASCII)
    if match is None or int(match[1]) >= int(match[2]):
        raise click.BadParameter(f"must be I/N, with I from 0 to N - 1; got {text}")
    return int(match[1]), int(match[2])


def _parse_arrays(text: str) -> tuple[str, ...]:
    from clsco.frame.truth_files import ATTRIBUTES

    names = set(filter(None, text.split(","))) | {"color"}
    if unknown := sorted(names - ATTRIBUTES.keys()):
        raise click.BadParameter(f"must be some of {','.join(ATTRIBUTES)}; got {unknown[0]}")
    return tuple(name for name in ATTRIBUTES if name in names)


def _uncolored(arrays: tuple[str, ...]) -> tuple[str, ...]:
    """Arrays without color. Raises click.UsageError where one belongs to the image, or none is left."""
    if named := OF_THE_IMAGE.intersection(arrays) - {"color"}:
        raise click.UsageError(f"--no-color: makes no image, so --truth must be without {min(named)}")
    if arrays == ("color",):
        raise click.UsageError("--no-color: needs --truth, as nothing else is written")
    return tuple(name for name in arrays if name != "color")


def _parse_types(text: str) -> tuple[tuple[str, str], ...]:
    from clsco.data.record import parse_stored

    try:
        return tuple(sorted(parse_stored(text).items()))
    except SceneError as error:
        raise click.BadParameter("; ".join(error.messages)) from None


data_argument = click.argument("data", metavar="DATA")
base_option = click.option(
    "--base", metavar="FOLDER", type=PATH, default=Path(),
    help="Where the distribution file was, with its textures; default: here.",
)  # fmt: skip


@batch.command(epilog="clsco batch status DATA, verify DATA, show DATA NUMBER: of a set that is there.")
@click.argument("distribution", type=PATH)
@click.option("-o", "out", metavar="DATA", required=True, help="Folder of the set, or an address like s3://bucket/set.")
@click.option("--count", metavar="N", type=click.IntRange(1, 10**12), help="Samples of the set.")
@click.option("--seed", metavar="S", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@click.option(
    "--shard-size", metavar="N", type=click.IntRange(1, 10**6), default=256, show_default=True,
    help="Samples of a shard, which is one file.",
)  # fmt: skip
@click.option("--format", "form", metavar="NAME", default="webdataset", show_default=True, help="Of the files.")
@click.option(
    "--truth", "arrays", metavar="NAMES", type=_parse_arrays, default="sharp,depth,coc", show_default=True,
    help="Arrays of a sample besides color.",
)  # fmt: skip
@click.option("--no-color", is_flag=True, help="Those arrays alone: no image is made, which is most of the work.")
@click.option(
    "--types", metavar="NAME=TYPE,...", type=_parse_types, default="",
    help="Such as color=float32, linear instead of codes of 16 bits, or uint8, or depth=float16.",
)  # fmt: skip
@click.option("--split", "splits", metavar="NAME=SHARE,...", help="Such as train=0.9,test=0.1.")
@click.option("--device", "devices", metavar="NAME", multiple=True, help="Where to render; may be given again.")
@click.option("--devices", "every", type=click.Choice(["all"]), help="On all devices of the best kind.")
@click.option(
    "--workers", metavar="N", type=click.IntRange(1, 1024),
    help="Processes. Default: one for each graphics card, or for each core of a processor.",
)  # fmt: skip
@click.option(
    "--scheduler", metavar="ADDRESS", help="Of a dask.distributed cluster that renders, like tcp://host:8786."
)
@click.option("--resume", is_flag=True, help="Go on with the set in DATA.")
@click.option("--only", metavar="A:B", type=_parse_numbers, help="Samples A to B - 1 alone.")
@click.option("--part", metavar="I/N", type=_parse_part, help="Only every N-th shard, from I = 0 on, for array jobs.")
@click.option("--dry-run", is_flag=True, help="Draw only: histograms, a contact sheet, predicted time and bytes.")
@click.option("--license", "license_text", metavar="TEXT", default="", help="For the data card.")
@set_option
@precision_option
@quiet_option
def make(distribution: Path, out: str, devices: tuple[str, ...], quiet: bool, **options: Any) -> None:
    """Make a data set of scenes drawn from a DISTRIBUTION file.

    The same file, seed and version give the same bytes on devices of a family, whatever makes them.
    """
    from clsco.data.containers import container_named
    from clsco.data.distribution import load_distribution
    from clsco.data.manifest import CONFLICT, LOG, PARTS, UNSPLIT
    from clsco.resources import read_regular
    from clsco.scene.file import MAX_FILE_BYTES

    if options.pop("no_color"):
        options["arrays"] = _uncolored(options["arrays"])
    container_named(options["form"])
    drawn = load_distribution(distribution, options["overrides"], options["splits"])
    if taken := sorted({name for name, _ in drawn.splits} & {PARTS, LOG, UNSPLIT, CONFLICT}):
        raise SceneError(f"--split: names must be others than {PARTS}, {LOG}, {UNSPLIT} and {CONFLICT}; got {taken[0]}")
    samples = _wanted(options["count"], options["only"])
    if options["dry_run"]:
        from clsco.cli.dry_run import print_dry_run
        from clsco.data.dryrun import dry_run

        sheet = Path("dry_run.png" if "://" in out else f"{out.rstrip('/')}_dry_run.png")
        found = dry_run(drawn, options["seed"], len(samples), wanted=options["arrays"], sheet_path=sheet)
        print_dry_run(found)
        return
    options["recipe"] = read_regular(distribution, MAX_FILE_BYTES, follow=True).decode("utf-8-sig")
    _make(drawn, out, samples, devices, quiet, options)


def _wanted(count: int | None, only: range | None) -> range:
    if only is None:
        if count is None:
            raise click.UsageError("--count: must be given; got nothing")
        return range(count)
    if count is not None and only.stop > count:
        raise click.UsageError(f"--only: must lie within 0:{count}; got {only.start}:{only.stop}")
    return only


def _make(
    drawn: Distribution, out: str, samples: range, devices: tuple[str, ...], quiet: bool, options: dict[str, Any]
) -> None:
    from clsco.cli.progress import progress
    from clsco.data.sets import DataSet, begun, finish, known_license, status_of
    from clsco.data.shards import Job
    from clsco.data.storage import open_storage

    storage = open_storage(out)
    storage.tidy()
    scheduler = options["scheduler"]
    if scheduler and (devices or options["every"] or options["workers"]):
        raise click.UsageError("--scheduler: its workers have devices; got --device, --devices or --workers as well")
    if scheduler:
        from clsco.data.cluster import cluster_device

        where: list[Place] = []
        family, precision = cluster_device(scheduler)
    else:
        where, family, precision = _places(devices, bool(options["every"]), options["workers"])
    identity = _identity(drawn, samples, options, options["precision"] or precision, family)
    wanted = DataSet(storage, identity, samples)
    try:
        begun(wanted, options["resume"] or options["part"] is not None)
        license_text = options["license_text"] or known_license(storage)
        wanted.write({"license": license_text, "recipe": options["recipe"]})
        index, parts = options["part"] or (0, 1)
        own = [shard for shard in wanted.shards if shard % parts == index]
        done = wanted.done(own, storage.is_local, [])
        left = [shard for shard in own if shard not in done]
        job = Job(drawn, identity, samples, storage.where)
        with progress(sum(len(wanted.numbers(shard)) for shard in left), quiet, "samples") as bar:

            def advance(count: int) -> None:
                for _ in range(count):
                    bar()

            if not left:
                pass
            elif scheduler:
                from clsco.data.cluster import run_cluster

                run_cluster(job, left, scheduler, advance)
            else:
                from clsco.data.pool import run_pool

                run_pool(job, left, where, advance, _memory_limit(len(where)))
        status = status_of(wanted)
        finish(wanted, status)
        failures = [row for shard in own if shard in status.done for row in wanted.lines(shard)[1]]
    finally:
        storage.tidy()  # what processes left that were still about to end before
        storage.close()
    echo(_line(out, status))
    if failures:
        first = f"the first, sample {failures[0]['number']}: {failures[0]['error']}"
        count = sum(len(wanted.numbers(shard)) for shard in own)
        raise ClscoError(f"{out}: every sample must be made; got {len(failures)} of {count} that failed; {first}")


def _identity(drawn: Distribution, samples: range, options: dict[str, Any], precision: str, family: str) -> Identity:
    from clsco import __version__
    from clsco.data.manifest import Identity

    return Identity(
        distribution=drawn.digest, seed=options["seed"], first=samples.start, shard_size=options["shard_size"],
        format=options["form"], arrays=options["arrays"], precision=precision, splits=tuple(drawn.splits),
        version=__version__, device_family=family, types=options["types"],
    )  # fmt: skip


def _places(names: Sequence[str], every: bool, workers: int | None) -> tuple[list[Place], str, str]:
    """Places for the processes, the family of their devices, and the precision of these."""
    require_opencl()
    from clsco.data.pool import places
    from clsco.data.shards import device_family
    from clsco.opencl.device import choose, list_devices

    if every and names:
        raise click.UsageError("--devices: all are meant; got --device as well")
    found, _ = list_devices()
    best = choose(names[0] if names else None, "--device")
    if every:
        chosen = [k for k, device in enumerate(found) if (device.kind, device.platform) == (best.kind, best.platform)]
    else:
        chosen = [found.index(choose(name, "--device")) for name in names] or [found.index(best)]
    families = {device_family(found[k]): k for k in chosen}
    if len(families) > 1:
        raise ClscoError(f"--device: all must be of one family, as bits are; got {' and '.join(families)}")
    where = places([(k, found[k].kind == "cpu") for k in chosen], workers)
    return where, next(iter(families)), "double" if best.has_fp64 else "single"


def _memory_limit(workers: int) -> int:
    """Bytes beyond which a process is replaced."""
    import os

    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return int(WORKER_SHARE * total / max(1, workers))


def _line(out: str, status: Status) -> str:
    """Summary of a set in one line."""
    failed = f", {status.failed} failed" if status.failed else ""
    whole = "" if status.is_whole else f" of {status.shards}, as far as it is made"
    made = f"{status.made} samples in {len(status.done)} shards"
    return f"{click.format_filename(out)}: {made}{whole}{failed}, {_size(status.bytes)}"


def _size(count: int) -> str:
    for unit in ("B", "KiB", "MiB", "GiB"):
        if count < 1024:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1024  # type: ignore[assignment]
    return f"{count:.1f} TiB"


@batch.command()
@data_argument
def status(data: str) -> None:
    """Tell how far a set has come, and put its manifest together where it is whole."""
    from clsco.data.sets import finish, open_set, ranges, status_of
    from clsco.data.storage import open_storage

    there = open_set(open_storage(data))
    found = status_of(there)
    echo(f"shards: {len(found.done)} of {found.shards}")
    echo(f"samples: {found.made} made, {found.failed} failed, of {found.samples}; {_size(found.bytes)}")
    if found.rate is not None and not found.is_whole:
        echo(f"rate: {found.rate:.3g} samples/s, {_duration(found.seconds_left or 0.0)} left at this rate")
    if missing := [shard for shard in there.shards if shard not in found.done]:
        echo(f"missing: {ranges(missing)}")
    for fault in found.faults:
        echo(f"incomplete: {fault}")
    finish(there, found)


def _duration(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s"


@batch.command()
@data_argument
@click.option(
    "--sample", metavar="N", type=click.IntRange(0), default=16, show_default=True,
    help="Samples, spread over the set, that are rendered again.",
)  # fmt: skip
@click.option("--device", metavar="NAME", help="Where to render them.")
@base_option
@quiet_option
def verify(data: str, sample: int, device: str | None, base: Path, quiet: bool) -> None:
    """Check a set: hashes of all files and arrays, and samples rendered again, bit by bit.

    Flow is compared with where the motion of the scene takes the depth. Exit status 1 and a line for each finding.
    """
    from clsco.cli.progress import progress
    from clsco.data.sets import open_set
    from clsco.data.storage import open_storage
    from clsco.data.verify import chosen_samples, verify_files, verify_samples

    storage = open_storage(data)
    there = open_set(storage)
    try:
        with progress(len(there.shards) + sample, quiet, "checks") as advance:
            findings = verify_files(there, advance)
            chosen = chosen_samples(there, sample)
            findings += verify_samples(there, chosen, device, advance, base)
    finally:
        storage.close()
    for finding in findings:
        echo(finding)
    if findings:
        raise ClscoError(f"{data}: must be as it was made; got {len(findings)} findings")
    echo(f"{click.format_filename(data)}: {len(there.samples)} samples as recorded, {len(chosen)} rendered again")


@batch.command()
@data_argument
@click.argument("number", type=click.IntRange(0))
@base_option
def show(data: str, number: int, base: Path) -> None:
    """Print the scene of sample NUMBER of a set as TOML, which clsco render takes."""
    from clsco.data.build import located
    from clsco.data.sets import open_set
    from clsco.data.storage import open_storage
    from clsco.data.verify import scene_table
    from clsco.scene.toml import toml_text

    storage = open_storage(data)
    try:
        echo(toml_text(located(scene_table(open_set(storage), number), base.absolute())), nl=False)
    finally:
        storage.close()
