"""Data sets in a folder or an object store: open, resume, measure and complete them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from clsco.data import manifest
from clsco.data.card import CARD, write_card
from clsco.data.manifest import Identity, ManifestPart, Merged, part_key
from clsco.data.storage import Storage
from clsco.errors import FileError, SceneError
from clsco.files.strict_json import strict_json

MOST_SHARDS = 10**6
LARGEST_CARD = 2**26
LATEST = 64  # shards from whose times the rate is taken
AT_ONCE = 16  # parts that are read at the same time


@dataclass(frozen=True)
class DataSet:
    """A data set in a storage; about: the content of its card (`dataset.json`), {} if the set has none yet."""

    storage: Storage
    identity: Identity
    samples: range
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def shards(self) -> range:
        """Numbers of all shards."""
        return manifest.shard_numbers(self.samples, self.identity.shard_size)

    def numbers(self, shard: int) -> range:
        """Numbers of the samples of a shard."""
        return manifest.numbers_of(shard, self.samples, self.identity.shard_size)

    def part_keys(self) -> list[str]:
        """Keys of the manifest parts that exist, in order."""
        return sorted(key for key in self.storage.sizes(manifest.PARTS) if key.endswith(".jsonl"))

    def parts(self, keys: Sequence[str] | None = None) -> Iterator[tuple[str, bytes]]:
        """Content of all existing parts or of those with `keys`, in order; several are read at a time."""
        keys = self.part_keys() if keys is None else keys
        with ThreadPoolExecutor(AT_ONCE) as threads:
            for start in range(0, len(keys), 8 * AT_ONCE):  # not all of them in memory
                chunk = keys[start : start + 8 * AT_ONCE]
                for key, data in zip(chunk, threads.map(self.storage.read, chunk), strict=True):
                    if data is not None:
                        yield key, data

    def done(
        self, shards: Iterable[int], hashes: bool, faults: list[str], merged: Merged | None = None
    ) -> dict[int, ManifestPart]:
        """Parts of finished shards: they belong to this set, have all samples, and their files are complete.

        hashes: compare the files' SHA-256 with the part, else only sizes. `faults` gets a line for each part whose
        shard is not complete; `merged` gets the lines of the complete ones.
        """
        present, whole, sizes = set(self.part_keys()), dict[int, ManifestPart](), dict[str, dict[str, int]]()
        keys, digest = {key: shard for shard in shards if (key := part_key(shard)) in present}, self.identity.digest
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
        """Message on the first fault of a part's files, or ""; sizes: of files by folder, None to compare hashes."""
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
        """Manifest rows of a shard's samples, and of its failed samples; empty without a part."""
        data = self.storage.read(part_key(shard))
        return ([], []) if data is None else manifest.rows_of(data)

    def write(self, about: Mapping[str, Any]) -> None:
        """Write the card, before any shard is made. about: other entries of the card."""
        card = {"identity": self.identity.record(), "samples": [self.samples.start, self.samples.stop], **about}
        self.storage.write(CARD, f"{json.dumps(card, indent=2, allow_nan=False)}\n".encode())


def open_set(storage: Storage) -> DataSet:
    """The set in a storage. Raises FileError if there is none, or its card is damaged."""
    data = storage.read(CARD)
    if data is None:
        raise FileError(f"{storage.where}: must hold a data set that clsco dataset make made; got no {CARD}")
    try:
        if len(data) > LARGEST_CARD:
            raise ValueError(f"{len(data)} bytes")
        card = strict_json(data)
        about = dict(card["identity"])
        texts = (card.get("license", ""), card.get("recipe", ""), about["format"])
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("a license, recipe or format that is no text")
        about["arrays"] = tuple(map(str, about["arrays"]))
        about["splits"] = tuple((str(name), float(share)) for name, share in about["splits"])
        about["types"] = tuple((str(name), str(kind)) for name, kind in about["types"])
        samples, identity = range(*(int(number) for number in card["samples"])), Identity(**about)
        if not samples or samples.start < 0 or len(manifest.shard_numbers(samples, identity.shard_size)) > MOST_SHARDS:
            raise ValueError(f"samples are {samples}")
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, RecursionError) as error:
        raise FileError(f"{storage.where}/{CARD}: must describe a data set; got {error!r}") from None
    return DataSet(storage, identity, samples, card)


def check_resumable(new: DataSet, resumes: bool) -> Mapping[str, Any]:
    """The card of the stored set if `new` may resume it, {} for an empty storage, or a set of which nothing was made.

    Raises SceneError: another set, one with more samples, or other files are there, or `resumes` is False.
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
    """True if a shard has samples, by its part of the manifest; also if that is damaged."""
    try:
        return manifest.parsed_part(part).made > 0
    except FileError:
        return True


@dataclass(frozen=True, repr=False)
class Status:
    """Progress of a set: its number of shards and samples, and those done."""

    shards: int
    samples: int
    done: Mapping[int, ManifestPart]  # parts of complete shards by number
    faults: tuple[str, ...]  # a line for each part whose shard is incomplete
    rate: float | None  # samples per second over the latest shards, of all processes together

    def __repr__(self) -> str:
        return f"<Status: {self.made} of {self.samples} samples made, {self.failed} failed>"

    @property
    def is_whole(self) -> bool:
        """True if all shards are done."""
        return len(self.done) == self.shards

    @property
    def made(self) -> int:
        """Number of samples in files."""
        return sum(part.made for part in self.done.values())

    @property
    def failed(self) -> int:
        """Number of failed samples."""
        return sum(part.failed for part in self.done.values())

    @property
    def bytes(self) -> int:
        """Size of all files of shards."""
        return sum(size for part in self.done.values() for size, _ in part.files.values())

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the set is complete at the current rate."""
        return None if not self.rate else (self.samples - self.made - self.failed) / self.rate


def status_of(
    data_set: DataSet, hashes: bool = False, shards: Sequence[int] | None = None, merged: Merged | None = None
) -> Status:
    """Measure the progress of a set, of all shards or some; arguments are those of `DataSet.done`."""
    faults: list[str] = []
    done = data_set.done(data_set.shards if shards is None else shards, hashes, faults, merged)
    return Status(len(data_set.shards), len(data_set.samples), done, tuple(faults), _rate(data_set, done))


def finish(data_set: DataSet, own: Sequence[int] | None = None) -> Status:
    """Measure the progress of a set; if it is complete, merge its manifest and complete its card.

    Each part is read once; while some are missing, only those of `own`, so that many jobs do not read all parts each.
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
    """Samples per second by the log, which is used for nothing else."""
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
    spans: list[list[int]] = []
    for number in sorted(numbers):
        if spans and number == spans[-1][1] + 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return ", ".join(f"{first}" if first == last else f"{first}-{last}" for first, last in spans)
