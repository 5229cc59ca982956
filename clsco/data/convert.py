"""Data sets written in another format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from clsco.data.card import CARD
from clsco.data.containers import CONTAINERS, container_named
from clsco.data.manifest import part_bytes, part_key
from clsco.data.record import Record
from clsco.data.sets import DataSet, Status, check_resumable, finish, open_set, status_of
from clsco.data.storage import Storage, remove_path
from clsco.errors import FileError
from clsco.files.atomic import file_digests
from clsco.files.strict_json import strict_json

OWN = ("identity", "samples", "counts", "arrays", "conventions", "load", "cite", "files")  # of a card, not carried over


def convert(
    source: Storage, target: Storage, form: str, resume: bool, begin: Callable[[int], Callable[[], object]]
) -> tuple[DataSet, Status]:
    """Write a whole set in another format, byte for byte as `clsco dataset make --format` would have made it.

    target: empty, or with an interrupted conversion, whose finished shards stay with `resume`; begin: called with the
    number of remaining shards, returns a function to call after each. Returns the set in `target` and its progress.
    Raises SceneError: unknown format, or another set is in `target`; FileError: the set is incomplete, or the SHA-256
    of an array differs from the manifest.
    """
    container_named(form)
    source_set = open_set(source)
    container_named(source_set.identity.format)
    status = status_of(source_set)
    if not status.is_whole:
        got = next(iter(status.faults), f"{len(status.done)}")
        raise FileError(f"{source.where}: all {status.shards} shards must be whole; got {got}")
    new_set = DataSet(target, replace(source_set.identity, format=form), source_set.samples)
    check_resumable(new_set, resume)
    card = strict_json(source.read(CARD) or b"{}")
    new_set.write({name: value for name, value in card.items() if name not in OWN})
    done = new_set.done(new_set.shards, target.is_local, [])
    left = [shard for shard in new_set.shards if shard not in done]
    advance = begin(len(left))
    for shard in left:
        _convert_shard(source_set, new_set, shard)
        advance()
    return new_set, finish(new_set)


def _convert_shard(source_set: DataSet, new_set: DataSet, shard: int) -> None:
    """Convert the files of a shard, then write its part of the manifest."""
    rows, failures = source_set.lines(shard)
    old, new = CONTAINERS[source_set.identity.format], CONTAINERS[new_set.identity.format]
    by_file: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_file.setdefault(row["file"], []).append(row)
    scratch, files = new_set.storage.scratch(), dict[str, Path]()
    described: dict[str, tuple[int, str]] = {}
    for file, own in by_file.items():
        key = f"{file.removesuffix(old.suffix)}{new.suffix}"
        path, local = scratch / key.replace("/", "_"), source_set.storage.local(file)
        remove_path(path)
        reader = old.read(local)
        try:
            if len(reader) != len(own):
                raise FileError(f"{file}: must hold {len(own)} samples, as the manifest says; got {len(reader)}")
            new.write(path, _checked(file, reader, own))
        finally:
            reader.close()
            if not source_set.storage.is_local:
                remove_path(local)
        files[key] = path
        described |= file_digests(key, path)
        for row in own:
            row["file"] = key
    part = part_bytes(shard, new_set.identity.digest, new_set.numbers(shard), described, rows, failures)
    new_set.storage.remove(part_key(shard))
    for key, path in files.items():
        new_set.storage.put(key, path)
    new_set.storage.write(part_key(shard), part)


def _checked(file: str, records: Iterator[Record] | Any, rows: Sequence[Mapping[str, Any]]) -> Iterator[Record]:
    """Records, checked against the hashes of arrays in the manifest."""
    for record, row in zip(records, sorted(rows, key=lambda row: row["offset"]), strict=True):
        if record.key != f"{row['number']:09d}" or record.sha256() != row["arrays"]:
            raise FileError(f"{file}: sample {row['number']} must have the arrays of the manifest; got others")
        yield record
