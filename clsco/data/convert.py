"""Data sets from one format to another, shard by shard, with the bits of all arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from clsco.data.card import CARD
from clsco.data.containers import CONTAINERS, container_named
from clsco.data.manifest import part_bytes, part_key
from clsco.data.record import Record
from clsco.data.sets import DataSet, Status, begun, finish, open_set, status_of
from clsco.data.storage import Storage, remove_path
from clsco.errors import ImageError
from clsco.files.atomic import file_digests
from clsco.files.bounded import strict_json

OWN = ("identity", "samples", "counts", "arrays", "conventions", "load", "cite", "files")  # of a card, not carried over


def convert(
    source: Storage, target: Storage, form: str, resume: bool, begin: Callable[[int], Callable[[], object]]
) -> tuple[DataSet, Status]:
    """Write a whole set in another format.

    Parameters
    ----------
    source : Storage
    target : Storage
        Empty, or with a conversion that was interrupted.
    form : str
        Name of a container.
    resume : bool
        Go on with what is in `target`: shards that are whole there stay.
    begin : callable
        Takes the number of shards that are left, and gives what is called after each.

    Returns
    -------
    (DataSet, Status)
        The set in `target` and its progress.

    Raises
    ------
    SceneError
        There is no such format, or another set is in `target`.
    ImageError
        The set is not whole or damaged: each array must have the SHA-256 that the manifest names.

    Notes
    -----
    What comes out is what `clsco dataset make --format` would have made, byte by byte, so that `dataset status`,
    `verify` and `--resume` take it.
    """
    container_named(form)
    there = open_set(source)
    container_named(there.identity.format)
    status = status_of(there)
    if not status.is_whole:
        found = next(iter(status.faults), f"{len(status.done)}")
        raise ImageError(f"{source.where}: all {status.shards} shards must be whole; got {found}")
    made = DataSet(target, replace(there.identity, format=form), there.samples)
    begun(made, resume)
    card = strict_json(source.read(CARD) or b"{}")
    made.write({name: value for name, value in card.items() if name not in OWN})
    done = made.done(made.shards, target.is_local, [])
    left = [shard for shard in made.shards if shard not in done]
    advance = begin(len(left))
    for shard in left:
        _convert_shard(there, made, shard)
        advance()
    return made, finish(made)


def _convert_shard(there: DataSet, made: DataSet, shard: int) -> None:
    """Convert the files of a shard; its part is written when they are there."""
    rows, failures = there.lines(shard)
    old, new = CONTAINERS[there.identity.format], CONTAINERS[made.identity.format]
    by_file: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_file.setdefault(row["file"], []).append(row)
    scratch, files = made.storage.scratch(), dict[str, Path]()
    described: dict[str, tuple[int, str]] = {}
    for file, own in by_file.items():
        key = f"{file.removesuffix(old.suffix)}{new.suffix}"
        path, local = scratch / key.replace("/", "_"), there.storage.local(file)
        remove_path(path)
        reader = old.read(local)
        try:
            if len(reader) != len(own):
                raise ImageError(f"{file}: must hold {len(own)} samples, as the manifest says; got {len(reader)}")
            new.write(path, _checked(file, reader, own))
        finally:
            reader.close()
            if not there.storage.is_local:
                remove_path(local)
        files[key] = path
        described |= file_digests(key, path)
        for row in own:
            row["file"] = key
    part = part_bytes(shard, made.identity.digest, made.numbers(shard), described, rows, failures)
    made.storage.remove(part_key(shard))
    for key, path in files.items():
        made.storage.put(key, path)
    made.storage.write(part_key(shard), part)


def _checked(file: str, records: Iterator[Record] | Any, rows: Sequence[Mapping[str, Any]]) -> Iterator[Record]:
    """Records whose arrays are those of the manifest."""
    for record, row in zip(records, sorted(rows, key=lambda row: row["offset"]), strict=True):
        if record.key != f"{row['number']:09d}" or record.sha256() != row["arrays"]:
            raise ImageError(f"{file}: sample {row['number']} must have the arrays of the manifest; got others")
        yield record
