"""Zarr 3: a group with an array for each array of a sample, (samples, rows, columns[, channels]), and `meta`.

Files are few: each holds the chunks of up to 16 samples (sharding codec). Read back with zarr.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.containers.base import ShardReader, whole
from clsco.data.containers.uniform import block_size, blocks
from clsco.data.encoding import LARGEST, LARGEST_META, described, meta_bytes, parsed_meta
from clsco.data.record import Record, is_wanted
from clsco.files.decoders import codec

NEEDS = ("zarr", "data")
MOST_SAMPLES = 2**20


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder.

    Parameters
    ----------
    path : Path
    records : iterable of Record
        With the same arrays, each of one type and size.
    raw : bool
        Nothing is compressed; else by Zstandard 3.
    """
    zarr = codec(path, *NEEDS)
    compressors = None if raw else zarr.codecs.ZstdCodec(level=3)
    texts: list[bytes] = []
    keys: list[str] = []
    made: dict[str, Any] = {}
    group = zarr.open_group(path, mode="w-", zarr_format=3)
    for layout, block in blocks(path, records, "zarr"):
        first = len(keys)
        keys += [record.key for record in block]
        texts += [meta_bytes(record) for record in block]
        for name, (dtype, shape) in layout.items():
            if name not in made:
                made[name] = group.create_array(
                    name, shape=(0, *shape), dtype=dtype, chunks=(1, *shape), shards=(block_size(layout), *shape),
                    compressors=compressors, filters=None,
                )  # fmt: skip
            made[name].resize((len(keys), *shape))
            made[name][first:] = np.stack([record.arrays[name] for record in block])
    ends = np.cumsum([0, *map(len, texts)], dtype=np.int64)
    for name, values in (
        ("meta", np.frombuffer(b"".join(texts), np.uint8)),
        ("meta_ends", ends),
        ("keys", np.array(list(map(int, keys)), np.int64)),
    ):
        group.create_array(name, data=values, chunks=values.shape, compressors=compressors, filters=None)


class ZarrReader(ShardReader):
    """Records of a Zarr group."""

    def __init__(self, path: Path) -> None:
        self._zarr = codec(path, *NEEDS)
        with whole(path, "Zarr group"):
            self._group = self._zarr.open_group(path, mode="r", zarr_format=3)
            numbers = self._column("keys", np.dtype("i8"), 1, MOST_SAMPLES)[:]
            self._ends = self._column("meta_ends", np.dtype("i8"), 1, MOST_SAMPLES)[:].tolist()
            text = self._column("meta", np.dtype("u1"), 1, min(LARGEST, LARGEST_META * max(len(numbers), 1)))
            self._metas = text[:].tobytes()
            within = all(0 <= first <= end <= len(self._metas) for first, end in pairwise(self._ends))
            if len(self._ends) != len(numbers) + 1 or not within:
                raise ValueError("meta_ends that do not fit meta")
        super().__init__(path, [f"{number:09d}" for number in numbers.tolist()])

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read a chunk of each array that is wanted."""
        with whole(self.path, "Zarr group"):
            meta = parsed_meta(self.path, self._metas[self._ends[index] : self._ends[index + 1]])
            arrays = {}
            for name in meta["arrays"]:
                if is_wanted(name, wanted):
                    about = described(self.path, meta, name)
                    column = self._column(name, about["dtype"], 1 + len(about["shape"]), None)
                    if column.shape != (len(self), *about["shape"]) or column.chunks[1:] != about["shape"]:
                        raise ValueError(f"{name} of shape {column.shape}")
                    arrays[name] = np.ascontiguousarray(column[index])
        return Record(self.keys[index], arrays, meta)

    def _column(self, name: str, dtype: np.dtype[Any], dimensions: int, most: int | None) -> Any:
        """An array of the group: of this type, and of at most so many values."""
        found = self._group[name]
        if not isinstance(found, self._zarr.Array) or (found.dtype, found.ndim) != (dtype, dimensions):
            raise ValueError(f"{name} that is no array of {dtype}")
        if most is not None and found.size > most:
            raise ValueError(f"{found.size} values in {name}")
        return found
