"""Data sets in a folder or an object store: open, resume, measure and complete them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

from clsco.data import manifest
from clsco.data.card import CARD, write_card
from clsco.data.fields import ARRAY, NUMBER, SHORT, checked_json
from clsco.data.manifest import Identity, ManifestPart, Merged, part_key
from clsco.data.storage import Storage
from clsco.errors import FileError, SceneError
from clsco.scene.text import key_name

MOST_SHARDS = 10**6
LARGEST_CARD = 2**26
_IDENTITY = {
    "distribution": SHORT, "seed": range(2**63), "first": NUMBER, "shard_size": range(1, 2**40), "format": SHORT,
    "arrays": [SHORT], "precision": SHORT, "splits": [(SHORT, float | int)], "version": SHORT, "device_family": SHORT,
    "types": [(SHORT, SHORT)],
}  # fmt: skip
_CARD = {
    "identity": _IDENTITY, "samples": (NUMBER, NUMBER), "license?": str, "recipe?": str, "function?": SHORT,
    "split_by?": SHORT, "distribution?": dict, "arrays?": {SHORT: ARRAY}, "files?": {SHORT: [(SHORT, NUMBER)]},
}  # fmt: skip
LATEST = 64  # number of shards whose times give the rate
AT_ONCE = 16  # parts that are read at the same time


@dataclass(frozen=True)
class DataSet:
    """A data set in a storage; about: content of its card (`dataset.json`), or {} if the card was not read."""

    storage: Storage
    identity: Identity
    samples: range
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def shards(self) -> range:
        return manifest.shard_numbers(self.samples, self.identity.shard_size)

    def numbers(self, shard: int) -> range:
        return manifest.numbers_of(shard, self.samples, self.identity.shard_size)

    def part_keys(self) -> list[str]:
        """Keys of the manifest parts that exist, in order."""
        return sorted(key for key in self.storage.sizes(manifest.PARTS) if key.endswith(".jsonl"))

    def parts(self, keys: Sequence[str] | None = None) -> Iterator[tuple[str, bytes]]:
        """Keys and contents of manifest parts, all or those with `keys`, in order. Several are read at a time."""
        keys = self.part_keys() if keys is None else keys
        with ThreadPoolExecutor(AT_ONCE) as threads:
            for start in range(0, len(keys), 8 * AT_ONCE):  # to limit the number of parts in memory
                chunk = keys[start : start + 8 * AT_ONCE]
                for key, data in zip(chunk, threads.map(self.storage.read, chunk), strict=True):
                    if data is not None:
                        yield key, data

    def done(
        self, shards: Iterable[int], hashes: bool, faults: list[str], merged: Merged | None = None
    ) -> dict[int, ManifestPart]:
        """Parts of those shards that are complete, by shard number: parts of this set that have all samples, and whose
        files are complete.

        hashes: True to compare the SHA-256 of files with the part, False to compare only their sizes. faults: gets a
        line for each part whose shard is not complete. merged: gets the parts of complete shards.
        """
        whole, sizes = dict[int, ManifestPart](), dict[str, dict[str, int]]()
        keys, digest = {part_key(shard): shard for shard in shards}, self.identity.digest
        if len(keys) > 1:  # a list of the parts takes less time than attempts to read those that are missing
            keys = {key: keys[key] for key in self.part_keys() if key in keys}
        for key, data in self.parts(list(keys)):
            shard, expected = keys[key], self.numbers(keys[key])
            try:
                part = manifest.parsed_part(data)
                fault = self._file_fault(part, data, None if hashes else sizes)
            except FileError as error:
                faults.append(f"{key}: {str(error).partition(': ')[2]}")
                continue
            if part.shard != shard or part.identity != digest:
                faults.append(f"{key}: must be of shard {shard} of this set; got another one's")
            elif part.numbers != expected:
                rule = f"must have the samples {expected.start} to {expected.stop - 1}"
                faults.append(f"{key}: {rule}; got {part.first} to {part.numbers.stop - 1}")
            elif fault:
                faults.append(fault)
            else:
                whole[shard] = part
                if merged is not None:
                    merged.add(part, data)
        return whole

    def _file_fault(self, part: ManifestPart, data: bytes, sizes: dict[str, dict[str, int]] | None) -> str:
        """Message on the first fault of a part's files, or "".

        sizes: cache of the sizes of files, by folder; None to compare hashes instead of sizes.
        """
        if sizes is None:
            manifest.require_rows(part, data)
        for name, (size, digest) in part.files.items():
            folder = name.partition("/")[0]
            if sizes is not None and folder not in sizes:
                sizes[folder] = self.storage.sizes(folder)
            got = self.storage.digest(name) if sizes is None else sizes[folder].get(name)
            if got is None:
                return f"{name}: must be there, as {part_key(part.shard)} names it; got no such file"
            if got != (digest if sizes is None else size):
                what = "SHA-256" if sizes is None else "size"
                return f"{name}: must have the {what} that {part_key(part.shard)} names; got another"
        return ""

    def lines(self, shard: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Manifest lines on a shard's samples, and on its failed samples; both lists are empty if it has no part."""
        data = self.storage.read(part_key(shard))
        return ([], []) if data is None else manifest.rows_of(data)

    def write(self, about: Mapping[str, Any]) -> None:
        """Write the card, before any shard is made; about: entries besides identity and samples."""
        card = {"identity": self.identity.record(), "samples": [self.samples.start, self.samples.stop], **about}
        self.storage.write(CARD, f"{json.dumps(card, indent=2, allow_nan=False)}\n".encode())


def open_set(storage: Storage) -> DataSet:
    """The set in a storage. Raises FileError if the storage has no set, or the set's card is damaged."""
    data = storage.read(CARD)
    if data is None:
        raise FileError(f"{storage.where}: must hold a data set that clsco dataset make made; got no {CARD}")
    rule = f"{storage.where}/{CARD}: must describe a data set"
    if len(data) > LARGEST_CARD:
        raise FileError(f"{rule}; got {len(data)} bytes")
    card = checked_json(data, _CARD, rule)
    about = card["identity"]
    if unknown := about.keys() - _IDENTITY.keys():
        raise FileError(f"{rule}; got {key_name(('identity', min(unknown)))}, which is no known key")
    pairs = {name: tuple(map(tuple, about[name])) for name in ("splits", "types")}
    samples, identity = range(*card["samples"]), Identity(**about | pairs | {"arrays": tuple(about["arrays"])})
    if not samples or len(manifest.shard_numbers(samples, identity.shard_size)) > MOST_SHARDS:
        raise FileError(f"{rule}; got {samples} samples in shards of {identity.shard_size}")
    return DataSet(storage, identity, samples, card)


def check_resumable(new: DataSet, resumes: bool) -> Mapping[str, Any]:
    """Check that the set `new` can be made in its storage; returns the card of a stored set that is resumed, else {}.

    resumes: False to replace a stored set without samples, True to resume a stored set. Raises SceneError if the
    storage has other files, or a set that has samples (`resumes` is False) or is not a part of `new` (True).
    """
    storage, where = new.storage, new.storage.where
    if storage.read(CARD) is None:
        if storage.has_others():
            raise SceneError(f"{where}: must be an empty folder, or hold a data set; got other files")
        return {}
    data_set = open_set(storage)
    if not resumes:
        if any(_made_some(data) for _, data in data_set.parts()):
            raise SceneError(f"{where}: must hold no data set, unless it is continued with resume; got one")
        for key in data_set.part_keys():
            storage.remove(key)
        return {}
    faults = data_set.identity.differences(new.identity.record())
    if data_set.samples.stop > new.samples.stop:
        faults.append(f"count must be at least {data_set.samples.stop}, as in the set; got {new.samples.stop}")
    if faults:
        raise SceneError([f"{where}: {fault}" for fault in faults])
    return data_set.about


def _made_some(part: bytes) -> bool:
    """True if a shard has samples, according to its part of the manifest, or if this part is damaged."""
    try:
        return manifest.parsed_part(part).made > 0
    except FileError:
        return True


@dataclass(frozen=True, repr=False)
class Status:
    """Progress of a set; shards, samples: numbers of all of them, done or not."""

    shards: int
    samples: int
    done: Mapping[int, ManifestPart]  # parts of complete shards by number
    faults: tuple[str, ...]  # a line for each part whose shard is incomplete
    rate: float | None  # samples per second over the latest shards, of all processes together

    def __repr__(self) -> str:
        return f"<Status: {self.made} of {self.samples} samples made, {self.failed} failed>"

    @property
    def is_whole(self) -> bool:
        return len(self.done) == self.shards

    @property
    def made(self) -> int:
        return sum(part.made for part in self.done.values())

    @property
    def failed(self) -> int:
        return sum(part.failed for part in self.done.values())

    @property
    def bytes(self) -> int:
        return sum(size for part in self.done.values() for size, _ in part.files.values())

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the set is complete at the current rate; None if the rate is unknown."""
        return None if not self.rate else (self.samples - self.made - self.failed) / self.rate


def status_of(
    data_set: DataSet, hashes: bool = False, shards: Sequence[int] | None = None, merged: Merged | None = None
) -> Status:
    """Measure the progress of a set; shards: those to examine, None for all; other arguments as for `DataSet.done`."""
    faults: list[str] = []
    done = data_set.done(data_set.shards if shards is None else shards, hashes, faults, merged)
    return Status(len(data_set.shards), len(data_set.samples), done, tuple(faults), _rate(data_set, done))


def finish(data_set: DataSet, own: Sequence[int] | None = None) -> Status:
    """Measure the progress of a set; if it is complete, merge its manifest and complete its card.

    own: shards of this job. While parts are missing, only the parts of these shards are read, because each of many jobs
    would otherwise read all parts.
    """
    if {part_key(shard) for shard in data_set.shards} - set(data_set.part_keys()):
        return status_of(data_set, shards=own)
    merged = Merged(data_set.storage)
    status = status_of(data_set, merged=merged)
    if status.is_whole:
        merged.put()
        write_card(data_set.storage, data_set.identity, merged.files)
        data_set.storage.close()
    return status


def _rate(data_set: DataSet, done: Iterable[int]) -> float | None:
    """Samples per second of the latest shards, from the log; None if the log is missing. Nothing else uses the log."""
    times = []
    for shard in sorted(done)[-LATEST:]:
        data = data_set.storage.read(f"{manifest.LOG}/{shard:06d}.jsonl")
        try:
            log = json.loads(data or b"")
            times.append((float(log["began"]), float(log["ended"]), int(log["samples"])))
        except (ValueError, KeyError, TypeError):
            continue
    if not times:
        return None
    spent = max(end for _, end, _ in times) - min(begin for begin, _, _ in times)
    return sum(count for _, _, count in times) / max(1e-3, spent)


def ranges(numbers: Iterable[int]) -> str:
    """Ranges of numbers as text: 3, 7-9."""
    runs = groupby(enumerate(sorted(numbers)), lambda pair: pair[1] - pair[0])
    spans = [[number for _, number in run] for _, run in runs]
    return ", ".join(f"{span[0]}-{span[-1]}" if len(span) > 1 else f"{span[0]}" for span in spans)
