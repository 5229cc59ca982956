"""Manifest of a data set: one part for each shard, and all of them together.

A part is a file of JSON lines: the first one describes the shard and its files, then there is a line for each sample
in it, and at last a line for each sample that failed. It is a function of the set and the number of the shard alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

from clsco.data.storage import Storage, checked_key
from clsco.errors import FileError
from clsco.files.strict_json import strict_json

PARTS, MERGED, FAILED, LOG = "manifest", "manifest.jsonl", "failed.jsonl", "log"
CONFLICT = "conflict"  # folder of shards that were made otherwise before
UNSPLIT = "data"  # folder of the shards of a set without splits
AT_ONCE = 16  # parts that are read at the same time


@dataclass(frozen=True)
class Identity:
    """All that decides the bytes of a set besides the number of its samples.

    distribution: its digest; first: number of the first sample; arrays: as they are called in files; precision: of the
    geometry, "double" or "single"; version: of clsco; types: those of arrays that are not stored as by default.
    """

    distribution: str
    seed: int
    first: int
    shard_size: int
    format: str
    arrays: tuple[str, ...]
    precision: str
    splits: tuple[tuple[str, float], ...]
    version: str
    device_family: str
    types: tuple[tuple[str, str], ...] = ()

    @property
    def digest(self) -> str:
        """SHA-256 of all fields."""
        return hashlib.sha256(line(self.record()).encode()).hexdigest()

    def record(self) -> dict[str, Any]:
        """As JSON holds it."""
        found: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return found

    def differences(self, record: Mapping[str, Any]) -> list[str]:
        """Messages on the entries in which another record differs: "seed must be 1, as in the set; got 2"."""
        return [
            f"{name.replace('_', ' ')} must be {_shortened(value)}, as in the set; got {_shortened(record.get(name))}"
            for name, value in self.record().items()
            if record.get(name) != value
        ]


@dataclass(frozen=True)
class ManifestPart:
    """The part of the manifest of a shard, which has `count` samples from number `first` on.

    identity: digest of that of its set; files: key to bytes and SHA-256; rows: SHA-256 of the lines that follow.
    """

    shard: int
    identity: str
    first: int
    count: int
    made: int
    failed: int
    files: Mapping[str, tuple[int, str]]
    rows: str

    @property
    def numbers(self) -> range:
        """Numbers of the part's samples."""
        return range(self.first, self.first + self.count)


def line(value: Mapping[str, Any]) -> str:
    """A line of JSON, always the same for the same value."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def part_key(shard: int) -> str:
    """Storage key of the part of a shard."""
    return f"{PARTS}/{shard:06d}.jsonl"


def part_bytes(
    shard: int, identity: str, numbers: range, files: Mapping[str, tuple[int, str]],
    rows: Sequence[Mapping[str, Any]], failures: Sequence[Mapping[str, Any]],
) -> bytes:  # fmt: skip
    """The content of a part."""
    body = "".join(f"{line(row)}\n" for row in (*rows, *failures)).encode()
    head = ManifestPart(
        shard, identity, numbers.start, len(numbers), len(rows), len(failures), files, hashlib.sha256(body).hexdigest()
    )
    return f"{line(asdict(head))}\n".encode() + body


def parsed_part(data: bytes) -> ManifestPart:
    """The description of a shard from the first line of its part. Raises FileError where it is none."""
    try:
        found = strict_json(data.partition(b"\n")[0])
        files = {checked_key(str(key)): (int(size), str(digest)) for key, (size, digest) in found.pop("files").items()}
        numbers = {name: int(found.pop(name)) for name in ("shard", "first", "count", "made", "failed")}
        part = ManifestPart(**numbers, files=files, identity=str(found.pop("identity")), rows=str(found.pop("rows")))
        counts_agree = min(numbers.values()) >= 0 and part.made + part.failed == part.count
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileError(f"manifest: a part must begin with a line about its shard; got {error!r}") from None
    if found or not counts_agree:
        raise FileError(f"manifest: samples made and failed must add up; got {part.made} + {part.failed}")
    return part


def rows_of(data: bytes) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The samples and the failures of a part. Raises FileError where they are not as its first line says."""
    part = parsed_part(data)
    require_rows(part, data)
    try:
        found = [strict_json(text) for text in data.splitlines()[1:]]
        rows, failures = found[: part.made], found[part.made :]
        if len(found) != part.count or not (all(map(_is_row, rows)) and all(map(_is_failure, failures))):
            raise ValueError("other values, or fewer lines")
    except ValueError as error:
        raise FileError(f"{part_key(part.shard)}: each line must be about a sample; got {error}") from None
    return rows, failures


def _is_row(row: Any) -> bool:
    """True if a row is about a sample that is in a file."""
    if not isinstance(row, dict) or not _is_count(row.get("number")) or not _is_count(row.get("offset")):
        return False
    texts, tables = (row.get("file"), row.get("split")), (row.get("parameters"), row.get("arrays"))
    if not all(isinstance(text, str) for text in texts) or not all(isinstance(table, dict) for table in tables):
        return False
    return all(isinstance(digest, str) for digest in row["arrays"].values())


def _is_failure(row: Any) -> bool:
    """True if a row is about a sample that failed."""
    if not isinstance(row, dict) or not _is_count(row.get("number")) or not isinstance(row.get("error"), str):
        return False
    return "scene" in row and (row["scene"] is None or isinstance(row["scene"], dict))


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value <= 10**12


def require_rows(part: ManifestPart, data: bytes) -> None:
    """Raise FileError where the lines of a part are not those that its first line describes."""
    if hashlib.sha256(data.partition(b"\n")[2]).hexdigest() != part.rows:
        raise FileError(f"{part_key(part.shard)}: lines must have the SHA-256 that the first one names; got another")


def shard_numbers(samples: range, size: int) -> range:
    """Numbers of the shards of a set."""
    return range(samples.start // size, -(-samples.stop // size))


def numbers_of(shard: int, samples: range, size: int) -> range:
    """Numbers of the samples of a shard."""
    return range(max(samples.start, shard * size), min(samples.stop, (shard + 1) * size))


class ManifestParts:
    """The parts of a set in a storage, and which of its shards are done."""

    def __init__(self, storage: Storage) -> None:
        self.storage = storage
        self.keys = sorted(key for key in storage.sizes(PARTS) if key.endswith(".jsonl"))
        self._sizes: dict[str, dict[str, int]] = {}  # of files, by folder

    def read(self, wanted: Iterable[str] | None = None) -> Iterator[tuple[str, bytes]]:
        """Content of parts, in order; several are read at a time."""
        keys = self.keys if wanted is None else list(wanted)
        with ThreadPoolExecutor(AT_ONCE) as threads:
            for start in range(0, len(keys), 8 * AT_ONCE):  # not all of them in memory
                chunk = keys[start : start + 8 * AT_ONCE]
                for key, data in zip(chunk, threads.map(self.storage.read, chunk), strict=True):
                    if data is not None:
                        yield key, data

    def done(
        self, identity: Identity, samples: range, shards: Iterable[int], hashes: bool, faults: list[str],
        merged: Merged | None = None,
    ) -> dict[int, ManifestPart]:  # fmt: skip
        """Shards whose part is there, of this set, with all of their samples, and whose files are whole.

        hashes: files must have the SHA-256 that their part names; else their sizes are compared. A line is added to
        `faults` for each part that is there, but whose shard is not whole; `merged` takes the lines of all that are.
        """
        there, found = set(self.keys), dict[int, ManifestPart]()
        keys, digest = {part_key(shard): shard for shard in shards}, identity.digest
        for key, data in self.read(key for key in keys if key in there):
            wanted = numbers_of(keys[key], samples, identity.shard_size)
            try:
                part = parsed_part(data)
                fault = self._fault(part, data, hashes)
            except FileError as error:
                faults.append(f"{key}: {str(error).partition(': ')[2]}")
                continue
            if part.shard != keys[key] or part.identity != digest:
                faults.append(f"{key}: must be of shard {keys[key]} of this set; got another one's")
            elif part.numbers != wanted:
                rule = f"must have the samples {wanted.start} to {wanted.stop - 1}"
                faults.append(f"{key}: {rule}; got {part.first} to {part.numbers.stop - 1}")
            elif fault:
                faults.append(fault)
            else:
                found[keys[key]] = part
                if merged is not None:
                    merged.add(part, data)
        return found

    def _fault(self, part: ManifestPart, data: bytes, hashes: bool) -> str:
        """Message on the first fault of a part's files, "" for none."""
        if hashes:
            require_rows(part, data)
        for name, (size, digest) in part.files.items():
            got = self.storage.digest(name) if hashes else self._size(name)
            if got is None:
                return f"{name}: must be there, as {part_key(part.shard)} names it; got no such file"
            if got != (digest if hashes else size):
                what = "SHA-256" if hashes else "size"
                return f"{name}: must have the {what} that {part_key(part.shard)} names; got another"
        return ""

    def _size(self, name: str) -> int | None:
        """Bytes of a file; its folder is listed once."""
        folder = name.partition("/")[0]
        if folder not in self._sizes:
            self._sizes[folder] = self.storage.sizes(folder)
        return self._sizes[folder].get(name)


class Merged:
    """Lines of all parts of a set, one after the other, and the files of its splits. Parts are added in order.

    Lines are in the scratch folder of the storage until `put`.
    """

    def __init__(self, storage: Storage) -> None:
        self.storage = storage
        self.files: dict[str, list[tuple[str, int]]] = {}
        """Split to files with the number of samples in them; "" of a set without splits."""
        self.paths = {key: storage.scratch() / key for key in (MERGED, FAILED)}
        for path in self.paths.values():
            path.write_bytes(b"")

    def add(self, part: ManifestPart, data: bytes) -> None:
        """Add a part."""
        lines = data.partition(b"\n")[2].splitlines(keepends=True)
        for key, own in ((MERGED, lines[: part.made]), (FAILED, lines[part.made :])):
            if own:
                with open(self.paths[key], "ab") as file:
                    file.writelines(own)
        for split, listed in files_of(part, data).items():
            self.files.setdefault(split, []).extend(listed)

    def put(self) -> None:
        """Write `manifest.jsonl` and `failed.jsonl`."""
        for key, path in self.paths.items():
            self.storage.put(key, path)


def files_of(part: ManifestPart, data: bytes) -> dict[str, list[tuple[str, int]]]:
    """Files of a part by their splits, with the number of samples in them. Raises FileError where it is damaged."""
    counts: dict[str, int] = {}
    if len(part.files) == 1 and (only := next(iter(part.files))).count("/") == 1:
        counts[only] = part.made
    else:
        for row in rows_of(data)[0]:
            counts[row["file"]] = counts.get(row["file"], 0) + 1
    found: dict[str, list[tuple[str, int]]] = {}
    for file, count in sorted(counts.items()):
        split = file.partition("/")[0]
        found.setdefault("" if split == UNSPLIT else split, []).append((file, count))
    return found


def _shortened(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 64 else f"{text[:61]}..."
