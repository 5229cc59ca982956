"""Data sets in a folder or a store: begun, gone on with, looked at, and ended."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clsco.data.card import CARD, write_card
from clsco.data.manifest import (
    LOG,
    Identity,
    ManifestPart,
    ManifestParts,
    Merged,
    numbers_of,
    part_key,
    rows_of,
    shard_numbers,
)
from clsco.data.storage import Storage
from clsco.errors import ImageError, SceneError
from clsco.files.bounded import strict_json

MOST_SHARDS = 10**6
LATEST = 64  # shards from whose times the rate is taken


@dataclass(frozen=True)
class DataSet:
    """A set in a storage.

    Attributes
    ----------
    storage : Storage
    identity : Identity
    samples : range
    about : mapping
        Entries of the card about what made the set, where it is there already.
    """

    storage: Storage
    identity: Identity
    samples: range
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def shards(self) -> range:
        """Numbers of all shards."""
        return shard_numbers(self.samples, self.identity.shard_size)

    def listed(self) -> frozenset[str]:
        """Keys of the parts that are there."""
        return frozenset(ManifestParts(self.storage).keys)

    def numbers(self, shard: int) -> range:
        """Numbers of the samples of a shard."""
        return numbers_of(shard, self.samples, self.identity.shard_size)

    def done(
        self, shards: Iterable[int], hashes: bool, faults: list[str], merged: Merged | None = None
    ) -> dict[int, ManifestPart]:
        """`ManifestParts.done` of this set."""
        return ManifestParts(self.storage).done(self.identity, self.samples, shards, hashes, faults, merged)

    def lines(self, shard: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Rows of the manifest about the samples of a shard, and about those that failed; none without a part."""
        data = self.storage.read(part_key(shard))
        return ([], []) if data is None else rows_of(data)

    def write(self, about: Mapping[str, Any]) -> None:
        """Write the card, which is there before any shard. about: what else it says."""
        card = {"identity": self.identity.record(), "samples": [self.samples.start, self.samples.stop], **about}
        self.storage.write(CARD, f"{json.dumps(card, indent=2, allow_nan=False)}\n".encode())


def open_set(storage: Storage) -> DataSet:
    """The set in a storage. Raises ImageError where there is none, or its card is damaged."""
    data = storage.read(CARD)
    if data is None:
        raise ImageError(f"{storage.where}: must hold a data set that clsco dataset make made; got no {CARD}")
    try:
        card = strict_json(data)
        if not all(isinstance(card.get(name, ""), str) for name in ("license", "recipe")):
            raise TypeError("a license or recipe that is no text")
        about = dict(card["identity"])
        about["arrays"] = tuple(map(str, about["arrays"]))
        about["splits"] = tuple((str(name), float(share)) for name, share in about["splits"])
        about["types"] = tuple((str(name), str(kind)) for name, kind in about["types"])
        samples, identity = range(*(int(number) for number in card["samples"])), Identity(**about)
        if not samples or samples.start < 0 or len(shard_numbers(samples, identity.shard_size)) > MOST_SHARDS:
            raise ValueError(f"samples are {samples}")
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, RecursionError) as error:
        raise ImageError(f"{storage.where}/{CARD}: must describe a data set; got {error!r}") from None
    return DataSet(storage, identity, samples, card)


def known_license(storage: Storage) -> str:
    """License on the card of a set, "" where there is none."""
    try:
        return str(json.loads(storage.read(CARD) or b"{}").get("license", ""))
    except (ValueError, AttributeError, RecursionError):
        return ""


def begun(wanted: DataSet, goes_on: bool) -> bool:
    """True if the storage holds a set that may be resumed.

    Parameters
    ----------
    wanted : DataSet
    goes_on : bool
        The set is to be resumed.

    Raises
    ------
    SceneError
        The set there is another one, has samples that are not wanted, or is not to be gone on with; or the folder has
        other files.
    """
    storage, where = wanted.storage, wanted.storage.where
    if storage.read(CARD) is None:
        if storage.has_others():
            raise SceneError(f"{where}: must be an empty folder, or hold a data set; got other files")
        return False
    there = open_set(storage)
    if not goes_on:
        raise SceneError(f"{where}: must hold no data set, unless that is resumed; got one")
    faults = there.identity.differences(wanted.identity.record())
    if there.samples.stop > wanted.samples.stop:
        faults.append(f"count must be at least {there.samples.stop}, as in the set; got {wanted.samples.stop}")
    if faults:
        raise SceneError([f"{where}: {fault}" for fault in faults])
    return True


@dataclass(frozen=True, repr=False)
class Status:
    """Progress of a set.

    Attributes
    ----------
    shards, samples : int
        Numbers in the whole set.
    done : mapping
        Parts of the shards that are whole, by number.
    faults : tuple of str
        A line for each part whose shard is not.
    rate : float or None
        Samples per second over the latest shards, of all processes together; None where it is not known.
    """

    shards: int
    samples: int
    done: Mapping[int, ManifestPart]
    faults: tuple[str, ...]
    rate: float | None

    def __repr__(self) -> str:
        return f"<Status: {self.made} of {self.samples} samples made, {self.failed} failed>"

    @property
    def is_whole(self) -> bool:
        """True if all shards are done."""
        return len(self.done) == self.shards

    @property
    def made(self) -> int:
        """Samples that are in files."""
        return sum(part.made for part in self.done.values())

    @property
    def failed(self) -> int:
        """Samples that failed."""
        return sum(part.failed for part in self.done.values())

    @property
    def bytes(self) -> int:
        """Size of all files of shards."""
        return sum(size for part in self.done.values() for size, _ in part.files.values())

    @property
    def seconds_left(self) -> float | None:
        """Until the set is whole, at the rate that it has."""
        return None if not self.rate else (self.samples - self.made - self.failed) / self.rate


def status_of(
    there: DataSet, hashes: bool = False, shards: Sequence[int] | None = None, merged: Merged | None = None
) -> Status:
    """Measure the progress of a set.

    Parameters
    ----------
    there : DataSet
    hashes : bool
        Files must have the SHA-256 that the parts of the manifest name; else their sizes are compared.
    shards : sequence of int, optional
        Shards that are looked at; by default all.
    merged : Merged, optional
        Takes the lines of those that are done.
    """
    faults: list[str] = []
    done = there.done(there.shards if shards is None else shards, hashes, faults, merged)
    return Status(len(there.shards), len(there.samples), done, tuple(faults), _rate(there, done))


def finish(there: DataSet, own: Sequence[int] | None = None) -> Status:
    """Measure the progress of a set; where it is whole, put its manifest together and complete its card.

    Each part is read once. While some are missing only those of the shards `own` are read, so that the work of many
    jobs grows with the number of shards, and not with its product with theirs.
    """
    listed = there.listed()
    if any(part_key(shard) not in listed for shard in there.shards):
        return status_of(there, shards=own)
    merged = Merged(there.storage)
    status = status_of(there, merged=merged)
    if status.is_whole:
        merged.put()
        write_card(there.storage, there.identity, merged.files)
        there.storage.close()
    return status


def _rate(there: DataSet, done: Iterable[int]) -> float | None:
    """From the log, which counts for nothing else."""
    found = []
    for shard in sorted(done)[-LATEST:]:
        data = there.storage.read(f"{LOG}/{shard:06d}.jsonl")
        try:
            known = json.loads(data or b"")
            found.append((float(known["began"]), float(known["ended"]), int(known["samples"])))
        except (ValueError, KeyError, TypeError):
            continue
    if not found:
        return None
    spent = max(end for _, end, _ in found) - min(begin for begin, _, _ in found)
    return sum(count for _, _, count in found) / max(1e-3, spent)


def ranges(numbers: Iterable[int]) -> str:
    """Numbers as people write them: 3, 7-9."""
    found: list[list[int]] = []
    for number in sorted(numbers):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return ", ".join(f"{first}" if first == last else f"{first}-{last}" for first, last in found)
