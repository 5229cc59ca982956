"""Copies of data sets: made again from the card and compared, or converted to another format."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from clsco.data.containers import CONTAINERS, container_named
from clsco.data.creation import DistributionLike, Progress, make
from clsco.data.failures import failure_of
from clsco.data.manifest import part_bytes, part_key
from clsco.data.record import Record
from clsco.data.sets import DataSet, Status, check_resumable, finish, open_set, ranges, status_of
from clsco.data.storage import Storage, open_storage, remove_path
from clsco.errors import FileError, SceneError
from clsco.files.atomic import file_digests, naming


def remake(
    data: str | os.PathLike[str], out: str | os.PathLike[str] | None = None, *,
    distribution: DistributionLike | None = None, folder: str | os.PathLike[str] | None = None,
    devices: str | Sequence[str] = (), workers: int | None = None, progress: Progress | None = None,
) -> list[str]:  # fmt: skip
    """Make a data set again from its card, and compare the bytes.

    Parameters
    ----------
    data : path
        Folder or address of the set, which is not changed.
    out : path, optional
        Folder or address of the new set; by default a temporary folder that is removed.
    distribution : path, mapping or callable, optional
        As for `clsco.data.make`; by default the distribution in the card. If a function made the set, give this
        function, because code in a set is never run.
    folder : path, optional
        Folder of the distribution file's textures; by default the current one.
    devices, workers, progress
        As for `clsco.data.make`.

    Returns
    -------
    list of str
        A line for each difference; empty if all bytes are the same.

    Raises
    ------
    SceneError
        A function made the set, and `distribution` is missing; or `clsco.data.make` raises the error.
    FileError
        The set does not exist, or is damaged.

    Examples
    --------
    >>> import clsco.data
    >>> clsco.data.remake("DATA")  # doctest: +SKIP
    []
    """
    with ExitStack() as stack:
        storage = open_storage(data)
        stack.callback(storage.close)
        original = open_set(storage)
        identity = original.identity
        made_by = original.about.get("distribution") if distribution is None else distribution
        if made_by is None:
            rule = "must be given for a set that a function made, as it is not run"
            raise SceneError(f"distribution: {rule}; got {original.about.get('function', 'none')}")
        target = stack.enter_context(tempfile.TemporaryDirectory()) if out is None else os.fspath(out)
        make(
            made_by, target, only=original.samples, seed=identity.seed, truth=set(identity.arrays) - {"color"},
            color="color" in identity.arrays, types=dict(identity.types), splits=identity.splits or None,
            format=identity.format, shard_size=identity.shard_size, precision=identity.precision, devices=devices,
            workers=workers, folder=folder, license=original.about.get("license", ""), progress=progress,
            split_by=original.about.get("split_by", ""), allow_failures=len(original.samples),
        )  # fmt: skip
        remade = open_storage(target)
        stack.callback(remade.close)
        return list(_differences(original, open_set(remade)))


def _differences(original: DataSet, remade: DataSet) -> Iterator[str]:
    yield from remade.identity.differences(original.identity.record())
    for shard in original.shards:
        key = part_key(shard)
        part = original.storage.read(key)
        if part is None:
            yield f"{key}: shard {shard} must be there; got none"
        elif part != remade.storage.read(key):
            old, new = ([*rows, *failures] for rows, failures in (original.lines(shard), remade.lines(shard)))
            others = ranges(row["number"] for row in old if row not in new)
            yield f"{key}: {f'samples {others}' if others else 'files'} must be what is made again; got others"


OWN = ("identity", "samples", "counts", "arrays", "conventions", "load", "cite", "files")  # entries made anew


def convert(
    source: Storage, target: Storage, form: str, resume: bool, begin: Callable[[int], Callable[[], object]]
) -> tuple[DataSet, Status]:
    """Write a complete set in another format, byte for byte as `clsco dataset make --format` would have made it.

    target: empty, or holds an interrupted conversion. resume: True to keep the shards that this conversion finished.
    begin: called with the number of remaining shards; returns a function that is called after each shard.

    Returns the new set and its progress. Raises SceneError if the format is unknown, or `target` holds another set;
    FileError if the set is incomplete, or the SHA-256 of an array differs from the manifest.
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
    new_set.write({name: value for name, value in source_set.about.items() if name not in OWN})
    done = new_set.done(new_set.shards, target.is_local, [])
    left = [shard for shard in new_set.shards if shard not in done]
    advance = begin(len(left))
    for shard in left:
        try:
            _convert_shard(source_set, new_set, shard)
        except OSError as error:
            raise FileError(failure_of(error, target.where)[1]) from error
        advance()
    return new_set, finish(new_set)


def _convert_shard(source_set: DataSet, new_set: DataSet, shard: int) -> None:
    """Convert the files of a shard, then write the shard's part of the manifest."""
    rows, failures = source_set.lines(shard)
    old, new = CONTAINERS[source_set.identity.format], CONTAINERS[new_set.identity.format]
    by_file: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_file.setdefault(row["file"], []).append(row)
    scratch, files = new_set.storage.scratch(), dict[str, Path]()
    described: dict[str, tuple[int, str]] = {}
    for file, own in sorted(by_file.items(), key=lambda item: item[1][0]["split"]):  # the order of a made shard
        key = f"{file.removesuffix(old.suffix)}{new.suffix}"
        path, local = scratch / key.replace("/", "_"), source_set.storage.local(file)
        remove_path(path)
        try:
            reader = old.read(local)
            if len(reader) != len(own):
                raise FileError(f"{file}: must hold {len(own)} samples, as the manifest says; got {len(reader)}")
            with naming(path):
                new.write(path, _checked(file, reader, own))
        finally:
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
    """The records of a file, each after a check of its arrays against the hashes in the manifest."""
    for record, row in zip(records, sorted(rows, key=lambda row: row["offset"]), strict=True):
        if record.key != f"{row['number']:09d}" or record.sha256() != row["arrays"]:
            raise FileError(f"{file}: sample {row['number']} must have the arrays of the manifest; got others")
        yield record
