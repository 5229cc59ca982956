"""The command `clsco dataset convert`: a data set in another format."""

from __future__ import annotations

from contextlib import ExitStack

import click

from clsco.cli.options import SET_FORMAT, quiet_option
from clsco.cli.output import echo


@click.command(short_help="Write a data set in another format.")
@click.argument("data", metavar="DATA")
@click.option("-o", "out", metavar="OUT", required=True, help="Folder for it, or an address like s3://bucket/set.")
@click.option(
    "--format", "form", metavar="NAME", type=SET_FORMAT, required=True,
    help="webdataset, folders, npz, hdf5 or zarr, each also uncompressed, like npz+raw; parquet.",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with the conversion in OUT.")
@quiet_option
def convert(data: str, out: str, form: str, resume: bool, quiet: bool) -> None:
    """Write the data set DATA in another format. All arrays keep their bits."""
    from clsco.cli.progress import progress
    from clsco.data.convert import convert as convert_set
    from clsco.data.storage import open_storage

    source, target = open_storage(data), open_storage(out)
    target.tidy()
    with ExitStack() as stack:
        stack.callback(source.close)
        stack.callback(target.close)
        _, status = convert_set(
            source, target, form, resume, lambda count: stack.enter_context(progress(count, quiet, "shards"))
        )
    place = click.format_filename(out)
    echo(f"{place}: {status.made} samples in {len(status.done)} shards, {status.failed} failed, as {form}")
