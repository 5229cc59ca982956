"""Manifest of a data set: one part for each shard, and a merged file.

A part is a file of JSON lines: the first line describes the shard and its files, and each further line describes a
sample or, after these, a failed sample. A part depends only on the set and the shard's number.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from clsco.data.fields import NUMBER, SHORT, checked_json
from clsco.data.storage import Storage, checked_key
from clsco.errors import FileError
from clsco.files.atomic import naming
from clsco.scene.text import brief

PARTS, MERGED, FAILED, LOG = "manifest", "manifest.jsonl", "failed.jsonl", "log"
CONFLICT = "conflict"  # folder of shards whose bytes differ from those of the same shard in the set
UNSPLIT = "data"  # folder of the shards of a set without splits
_PART = {
    "shard": NUMBER, "identity": str, "first": NUMBER, "count": NUMBER, "made": NUMBER, "failed": NUMBER,
    "files": {SHORT: (NUMBER, SHORT)}, "rows": str,
}  # fmt: skip
_ROW = {"number": NUMBER, "offset": NUMBER, "file": SHORT, "split": SHORT, "parameters": dict, "arrays": {SHORT: SHORT}}
_FAILURE = {"number": NUMBER, "error": str, "scene": dict | None}


@dataclass(frozen=True)
class Identity:
    """Everything that the bytes of a set depend on, except its number of samples."""

    distribution: str  # digest of the distribution
    seed: int
    first: int  # number of the first sample
    shard_size: int
    format: str
    arrays: tuple[str, ...]  # names as in files
    precision: str  # of the geometry, "double" or "single"
    splits: tuple[tuple[str, float], ...]
    version: str  # of clsco
    device_family: str
    types: tuple[tuple[str, str], ...] = ()  # names and types of arrays that are not stored in their default type

    @property
    def digest(self) -> str:
        return hashlib.sha256(line(self.record()).encode()).hexdigest()

    def record(self) -> dict[str, Any]:
        """The fields as JSON types."""
        record: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return record

    def differences(self, record: Mapping[str, Any]) -> list[str]:
        """Messages on entries that differ in another record: "seed must be 1, as in the set; got 2"."""
        return [
            f"{name.replace('_', ' ')} must be {_text(value)}, as in the set; got {_text(record.get(name))}"
            for name, value in self.record().items()
            if record.get(name) != value
        ]


@dataclass(frozen=True)
class ManifestPart:
    """A shard's part of the manifest, for `count` samples from number `first`."""

    shard: int
    identity: str  # digest of the set's `Identity`
    first: int
    count: int
    made: int
    failed: int
    files: Mapping[str, tuple[int, str]]  # (size, SHA-256) by key
    rows: str  # SHA-256 of the lines that follow

    @property
    def numbers(self) -> range:
        return range(self.first, self.first + self.count)


def line(value: Mapping[str, Any]) -> str:
    """A mapping as one line of JSON, which depends only on the content and order of the mapping."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def part_key(shard: int) -> str:
    """Storage key of a shard's part."""
    return f"{PARTS}/{shard:06d}.jsonl"


def part_bytes(
    shard: int, identity: str, numbers: range, files: Mapping[str, tuple[int, str]],
    rows: Sequence[Mapping[str, Any]], failures: Sequence[Mapping[str, Any]],
) -> bytes:  # fmt: skip
    """The content of a shard's part."""
    body = "".join(f"{line(row)}\n" for row in (*rows, *failures)).encode()
    head = ManifestPart(
        shard, identity, numbers.start, len(numbers), len(rows), len(failures), files, hashlib.sha256(body).hexdigest()
    )
    return f"{line(asdict(head))}\n".encode() + body


def parsed_part(data: bytes) -> ManifestPart:
    """The description of a shard from the first line of its part. Raises FileError if the line is invalid."""
    rule = "manifest: a part must begin with a line about its shard"
    head = checked_json(data.partition(b"\n")[0], _PART, rule)
    files = {checked_key(key): (size, digest) for key, (size, digest) in head["files"].items()}
    part = ManifestPart(**{name: head[name] for name in _PART} | {"files": files})
    if part.made + part.failed != part.count:
        raise FileError(f"manifest: samples made and failed must add up; got {part.made} + {part.failed}")
    return part


def rows_of(data: bytes) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The lines of a part on samples and on failed samples. Raises FileError if they contradict its first line."""
    part = parsed_part(data)
    require_rows(part, data)
    lines, rule = data.splitlines()[1:], f"{part_key(part.shard)}: each line must be about a sample"
    if len(lines) != part.count:
        raise FileError(f"{rule}; got {len(lines)} of {part.count} lines")
    rows = [checked_json(text, _ROW, rule) for text in lines[: part.made]]
    return rows, [checked_json(text, _FAILURE, rule) for text in lines[part.made :]]


def require_rows(part: ManifestPart, data: bytes) -> None:
    """Raise FileError if the lines of a part contradict its first line."""
    if hashlib.sha256(data.partition(b"\n")[2]).hexdigest() != part.rows:
        raise FileError(f"{part_key(part.shard)}: lines must have the SHA-256 that the first one names; got another")


def shard_numbers(samples: range, size: int) -> range:
    """Numbers of the shards of a set; size: samples of a whole shard."""
    return range(samples.start // size, -(-samples.stop // size))


def numbers_of(shard: int, samples: range, size: int) -> range:
    """Numbers of the samples of a shard; size: samples of a whole shard."""
    return range(max(samples.start, shard * size), min(samples.stop, (shard + 1) * size))


class Merged:
    """Merges the lines and files of parts, which are added in order. Lines stay in the scratch folder until `put`."""

    def __init__(self, storage: Storage) -> None:
        self.storage = storage
        self.files: list[tuple[str, int]] = []  # names, each with its number of samples
        self.paths = {key: storage.scratch() / key for key in (MERGED, FAILED)}
        for path in self.paths.values():
            path.write_bytes(b"")

    def add(self, part: ManifestPart, data: bytes) -> None:
        lines = data.partition(b"\n")[2].splitlines(keepends=True)
        for key, own in ((MERGED, lines[: part.made]), (FAILED, lines[part.made :])):
            if own:
                with naming(self.paths[key]), open(self.paths[key], "ab") as file:
                    file.writelines(own)
        self.files += files_of(part, data)

    def put(self) -> None:
        """Write `manifest.jsonl` and `failed.jsonl`."""
        for key, path in self.paths.items():
            self.storage.put(key, path)


def files_of(part: ManifestPart, data: bytes) -> list[tuple[str, int]]:
    """Names of the files of a part, each with its number of samples, in order. Raises FileError for a damaged part."""
    if len(part.files) == 1 and (only := next(iter(part.files))).count("/") == 1:
        return [(only, part.made)]
    return sorted(Counter(row["file"] for row in rows_of(data)[0]).items())


def files_by_split(files: Iterable[tuple[str, int]]) -> dict[str, list[tuple[str, int]]]:
    """Group files by split, and keep their order; in a set without splits, the only key is ""."""
    by_split: dict[str, list[tuple[str, int]]] = {}
    for file, count in files:
        split = file.partition("/")[0]
        by_split.setdefault("" if split == UNSPLIT else split, []).append((file, count))
    return {split: by_split[split] for split in sorted(by_split)}


def _text(value: Any) -> str:
    return brief(value if isinstance(value, str) else json.dumps(value), 64)
