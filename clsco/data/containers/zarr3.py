"""Zarr 3: a group with one array (samples, rows, columns[, channels]) for each array of a sample, and `meta`.

A file stores the chunks of up to 16 samples (sharding codec), so that a group has few files. zarr reads such groups.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers import base
from clsco.data.record import Record
from clsco.errors import import_extra
from clsco.files.atomic import raise_file_error
from clsco.files.decoder_process import run_decoder
from clsco.resources import open_regular

NEEDS = ("zarr", "data")
_FILE = "clsco.data.containers.zarr_file"
LARGEST_TEXTS = 2**28  # bytes of the descriptions of all records
MOST_SAMPLES, MOST_BYTES = 16, 2**26  # limits of a block of records, which is in memory


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder; each must have the same arrays, with the same types and shapes.

    raw: True to compress nothing; else arrays are compressed by Zstandard at level 3.
    """
    zarr = import_extra(path, *NEEDS)
    compressors = None if raw else zarr.codecs.ZstdCodec(level=3)
    texts: list[bytes] = []
    keys: list[int] = []
    made: dict[str, Any] = {}
    group = zarr.open_group(path, mode="w-", zarr_format=3)
    for layout, size, block in _blocks(path, records):
        first = len(keys)
        keys += [int(record.key) for record in block]
        texts += [base.meta_bytes(record) for record in block]
        for name, (dtype, shape) in layout.items():
            if name not in made:
                made[name] = group.create_array(
                    name, shape=(0, *shape), dtype=dtype, chunks=(1, *shape), shards=(size, *shape),
                    compressors=compressors, filters=None,
                )  # fmt: skip
            made[name].resize((len(keys), *shape))
            made[name][first:] = np.stack([record.arrays[name] for record in block])
    index: dict[str, NDArray[Any]] = {
        "meta": np.frombuffer(b"".join(texts), np.uint8),
        "meta_ends": np.cumsum([0, *map(len, texts)], dtype=np.int64),
        "keys": np.array(keys, np.int64),
    }
    for name, values in index.items():
        group.create_array(name, data=values, chunks=values.shape, compressors=compressors, filters=None)


def _blocks(path: Path, records: Iterable[Record]) -> Iterator[tuple[base.Layout, int, list[Record]]]:
    """Split records into blocks. For each, yields the layout of all records, the largest number of records in a block,
    and the records of the block. Raises FileError if layouts differ, or there is no record.
    """
    following = iter(records)
    block = list(islice(following, 1))
    if not block:
        raise_file_error(path, "zarr must have a sample", "none")
    layout = _layout_of(block[0])
    size = max(1, min(MOST_SAMPLES, MOST_BYTES // max(base.record_bytes(layout), 1)))
    block += islice(following, size - 1)
    while block:
        for record in block:
            own = _layout_of(record)
            for name in (*layout, *own):
                if layout.get(name) != own.get(name):
                    rule = "zarr must have the same arrays in all samples, of one type and size"
                    got = f"{name} {own[name][0]} {own[name][1]}" if name in own else f"no {name}"
                    raise_file_error(path, rule, f"{got} in sample {record.key}")
        yield layout, size, block
        block = list(islice(following, size))


def _layout_of(record: Record) -> base.Layout:
    return {name: (array.dtype, array.shape) for name, array in record.items()}


class ZarrReader(base.ShardReader):
    """Records of a Zarr group as `write` makes it."""

    def __init__(self, path: Path) -> None:
        with base.translate_errors(path, "Zarr group"):
            for folder, folders, names in os.walk(path):
                for each in (Path(folder, name) for name in (*folders, *names)):
                    if each.is_symlink() or not (each.is_file() or each.is_dir()):
                        raise ValueError(f"a link or a device at {each.relative_to(path)}")
            with open_regular(path / "zarr.json") as file:
                _, (numbers, ends, texts) = run_decoder(f"{_FILE}:index", file, LARGEST_TEXTS)
            within = numbers.ndim == ends.ndim == texts.ndim == 1 and numbers.dtype == ends.dtype == np.int64
            if not within or len(ends) != len(numbers) + 1 or not (np.diff(ends, prepend=0) >= 0).all():
                raise ValueError("meta_ends that do not fit meta")
        self._ends, self._texts = ends.tolist(), texts.tobytes()
        super().__init__(path, [f"{number:09d}" for number in numbers.tolist()])

    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        with base.translate_errors(self.path, "Zarr group"), open_regular(self.path / "zarr.json") as file:
            meta, layout = base.parsed_meta(self.path, self._texts[self._ends[index] : self._ends[index + 1]])
            selected = base.chosen(layout, names)
            arrays = base.confined_arrays(f"{_FILE}:arrays", file, selected, row=index)
        return Record(self.keys[index], arrays, meta)
