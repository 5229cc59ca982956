"""Parts of the manifest, and all of them together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clsco.data.manifest import Identity, Merged, numbers_of, parsed_part, part_bytes, part_key, rows_of, shard_numbers
from clsco.data.sets import DataSet, finish
from clsco.data.storage import _Folder, open_storage
from clsco.errors import FileError

IDENTITY = Identity("d", 1, 0, 4, "webdataset", ("color",), "double", (("train", 0.5), ("test", 0.5)), "1.0", "cpu")


def test_what_differs_from_a_set_is_named() -> None:
    assert IDENTITY.differences(IDENTITY.record()) == []
    other = replace(IDENTITY, seed=2, arrays=("color", "depth"))
    assert IDENTITY.differences(other.record()) == [
        "seed must be 1, as in the set; got 2",
        'arrays must be ["color"], as in the set; got ["color", "depth"]',
    ]
    assert other.digest != IDENTITY.digest


def test_shards_hold_all_samples_once() -> None:
    for samples in (range(10), range(3, 10), range(8), range(7, 9)):
        shards = shard_numbers(samples, 4)
        assert [n for shard in shards for n in numbers_of(shard, samples, 4)] == list(samples)


def test_a_part_is_read_as_it_was_written_and_damage_is_found() -> None:
    empty: dict[str, Any] = {"file": "data/000002.tar", "split": "", "parameters": {}, "arrays": {}}
    rows = [{"number": 8 + k, "offset": k, **empty} for k in range(2)]
    failures: list[dict[str, Any]] = [{"number": 10 + k, "error": "e", "scene": None} for k in range(2)]
    data = part_bytes(2, "id", range(8, 12), {"data/000002.tar": (3, "ab")}, rows, failures)
    part = parsed_part(data)
    assert (part.shard, part.numbers, part.made, part.failed) == (2, range(8, 12), 2, 2)
    assert rows_of(data) == (rows, failures)
    with pytest.raises(FileError, match="lines must have the SHA-256"):
        rows_of(data.replace(b'"number":9', b'"number":7'))
    for row, failure in (({"number": 8}, failures[0]), (rows[0], {"number": 10}), ({**rows[0], "offset": -1}, {})):
        with pytest.raises(FileError, match=r"each line must be about a sample; got (no offset|no error|offset -1)"):
            rows_of(part_bytes(2, "id", range(8, 10), {}, [row], [failure]))
    forged = data.replace(b'"made":2', b'"made":3'), data.replace(b"data/", b"../a/")
    for damaged in (b"", b"{}", b"[]", data[:20], *forged):
        with pytest.raises(FileError):
            parsed_part(damaged)


def test_parts_are_merged_in_order_with_failures_apart(tmp_path: Path) -> None:
    storage = open_storage(tmp_path)
    for shard in (1, 0):
        numbers, file = range(2 * shard, 2 * shard + 2), f"data/{shard:06d}.tar"
        row = {"number": numbers[0], "offset": 0, "file": file, "split": "", "parameters": {}, "arrays": {}}
        failure = {"number": numbers[1], "error": "none", "scene": None}
        storage.write(part_key(shard), part_bytes(shard, "id", numbers, {file: (1, "0")}, [row], [failure]))
    merged = Merged(storage)
    for _, data in DataSet(storage, IDENTITY, range(4)).parts():
        merged.add(parsed_part(data), data)
    merged.put()
    assert merged.files == [("data/000000.tar", 1), ("data/000001.tar", 1)]
    for name, numbers_in in (("manifest.jsonl", [0, 2]), ("failed.jsonl", [1, 3])):
        assert [json.loads(text)["number"] for text in (tmp_path / name).read_text().splitlines()] == numbers_in


class CountingFolder(_Folder):
    """A folder that counts how often files are read and folders are listed."""

    reads = lists = 0

    def read(self, key: str) -> bytes | None:
        """Content of a key."""
        self.reads += 1
        return super().read(key)

    def sizes(self, prefix: str) -> dict[str, int]:
        """Keys in a folder."""
        self.lists += 1
        return super().sizes(prefix)


@pytest.mark.parametrize(("shards", "jobs"), [(400, 10), pytest.param(40_000, 1000, marks=pytest.mark.slow)])
def test_jobs_read_their_own_parts_and_the_last_one_all_of_them_once(tmp_path: Path, shards: int, jobs: int) -> None:
    storage, size = CountingFolder(tmp_path), 2
    identity = Identity("d", 1, 0, size, "webdataset", ("depth",), "double", (), "0.1.0", "cpu")
    there = DataSet(storage, identity, range(shards * size))
    there.write({})
    for shard in there.shards:
        failures = [{"number": number, "error": "none", "scene": None} for number in there.numbers(shard)]
        data = part_bytes(shard, identity.digest, there.numbers(shard), {}, [], failures)
        (tmp_path / part_key(shard)).parent.mkdir(exist_ok=True)
        (tmp_path / part_key(shard)).write_bytes(data)
    missing = (tmp_path / part_key(shards - 1)).rename(tmp_path / "missing")
    latest = 64  # entries of the log for the rate
    for job in range(0, jobs, max(1, jobs // 10)):
        own = range(job, shards, jobs)
        storage.reads = storage.lists = 0
        status = finish(there, own)
        assert (len(status.done), status.is_whole) == (len(own) - (shards - 1 in own), False)
        assert storage.reads <= len(own) + latest
        assert storage.lists <= 3
    missing.rename(tmp_path / part_key(shards - 1))
    storage.reads = storage.lists = 0
    assert finish(there, range(jobs - 1, shards, jobs)).is_whole
    assert storage.reads <= shards + latest + 2
    assert storage.lists <= 3
    assert len((tmp_path / "failed.jsonl").read_text().splitlines()) == shards * size
