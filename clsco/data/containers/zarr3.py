"""Zarr 3: a group with an array for each array of a sample, (samples, rows, columns[, channels]), and `meta`.

Files are few: each holds the chunks of up to 16 samples (sharding codec). Read back with zarr.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers.base import (
    LARGEST_META,
    ShardReader,
    block_size,
    blocks,
    described,
    meta_bytes,
    parsed_meta,
    stored_size,
    whole,
)
from clsco.data.record import Record, is_wanted
from clsco.errors import import_extra, require_extra
from clsco.files.decoders import unzstd
from clsco.resources import open_regular, read_at, read_regular

NEEDS = ("zarr", "data")
CHECKSUM = ("google_crc32c", "data")
MOST_SAMPLES = 2**20
LARGEST_JSON, LARGEST_TEXTS = 2**16, 2**28  # bytes of what describes an array, and all records
_TYPES = {
    "bool": "?", "uint8": "u1", "uint16": "u2", "int32": "i4", "int64": "i8", "float16": "f2", "float32": "f4",
    "float64": "f8",
}  # fmt: skip


def crc32c(content: bytes) -> int:
    """CRC-32C of bytes."""
    import google_crc32c

    return int(google_crc32c.value(content))


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
    zarr = import_extra(path, *NEEDS)
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


@dataclass(frozen=True)
class _ArrayColumn:
    """An array of a group, in the one form in which `write` makes them.

    Attributes
    ----------
    folder : Path
    shape : tuple of int
    dtype : dtype
    rows : int
        Size of the first dimension in a file.
    is_sharded, is_packed : bool
        Each row is a chunk by itself; chunks are compressed.
    """

    folder: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    rows: int
    is_sharded: bool
    is_packed: bool

    def whole(self) -> NDArray[Any]:
        """All values of an array that is one chunk."""
        if self.is_sharded or self.rows != self.shape[0]:
            raise ValueError(f"{self.folder.name} that is not one chunk")
        with self._opened(0) as file:
            return self._unpacked(file.read(self._stored(self.shape)), self.shape)

    def row(self, index: int) -> NDArray[Any]:
        """A row of an array whose rows are chunks, from the place that the file of its rows names at its end."""
        shape = self.shape[1:]
        if not self.is_sharded:
            raise ValueError(f"{self.folder.name} without a chunk for each sample")
        try:
            file = self._opened(index // self.rows)
        except FileNotFoundError:  # nothing but zeros
            return np.zeros(shape, self.dtype)
        with file:
            size = os.fstat(file.fileno()).st_size
            places = read_at(file, 16 * self.rows + 4, max(0, size - 16 * self.rows - 4))
            if crc32c(places[:-4]) != int.from_bytes(places[-4:], "little"):
                raise ValueError(f"a wrong checksum of the places in {self.folder.name}")
            place, count = np.frombuffer(places, "<u8", 2 * self.rows).reshape(-1, 2)[index % self.rows].tolist()
            if place == count == 2**64 - 1:
                return np.zeros(shape, self.dtype)
            if count > self._stored(shape) or place > size:
                raise ValueError(f"{count} bytes of sample {index} in {self.folder.name}")
            return self._unpacked(read_at(file, count, place), shape)

    def _opened(self, number: int) -> BinaryIO:
        path = self.folder.joinpath("c", str(number), *"0" * (len(self.shape) - 1))
        if not path.resolve().is_relative_to(self.folder.parent.resolve()):
            raise ValueError(f"{path.name} that is a link out of the group")
        return open_regular(path)

    def _stored(self, shape: tuple[int, ...]) -> int:
        return stored_size({"dtype": self.dtype, "shape": shape})

    def _unpacked(self, content: bytes, shape: tuple[int, ...]) -> NDArray[Any]:
        size = prod(shape) * self.dtype.itemsize
        plain = unzstd(self.folder, content, size) if self.is_packed else content
        if len(plain) != size:
            raise ValueError(f"{len(plain)} bytes of {size} in {self.folder.name}")
        return np.frombuffer(plain, self.dtype.newbyteorder("<")).reshape(shape).astype(self.dtype)


def _parsed_column(folder: Path) -> _ArrayColumn:
    """Read type and shape from `zarr.json` of an array.

    Raises ValueError, KeyError or TypeError for what `write` does not make.
    """
    about = json.loads(read_regular(folder / "zarr.json", LARGEST_JSON))
    codecs, rows = about["codecs"], about["chunk_grid"]["configuration"]["chunk_shape"]
    is_sharded = codecs[0]["name"] == "sharding_indexed"
    dtype, shape = np.dtype(_TYPES[about["data_type"]]), tuple(about["shape"])
    if not all(type(size) is int and size >= 0 for size in (*shape, *rows)) or not shape or rows[0] < 1:
        raise ValueError(f"{folder.name} of shape {shape} in chunks of {rows}")
    if is_sharded:
        inner = codecs[0]["configuration"]
        ends = (inner["index_location"], [each["name"] for each in inner["index_codecs"]], inner["chunk_shape"])
        if len(codecs) > 1 or ends != ("end", ["bytes", "crc32c"], [1, *shape[1:]]) or rows[0] > MOST_SAMPLES:
            raise ValueError(f"{folder.name} in shards of another kind")
        codecs = inner["codecs"]
    names = [each["name"] for each in codecs]
    little = codecs[0].get("configuration", {}).get("endian", "little") == "little"
    if names not in (["bytes"], ["bytes", "zstd"]) or not little or rows[1:] != list(shape[1:]):
        raise ValueError(f"{folder.name} compressed by {' '.join(map(str, names))} in chunks of {rows}")
    encoding, storage = about["chunk_key_encoding"], about.get("storage_transformers")
    if encoding["name"] != "default" or encoding.get("configuration", {}).get("separator", "/") != "/" or storage:
        raise ValueError(f"{folder.name} in files of other names")
    if about["fill_value"]:
        raise ValueError(f"{folder.name} that is {about['fill_value']} where nothing is")
    return _ArrayColumn(folder, shape, dtype, rows[0], is_sharded, len(names) > 1)


class ZarrReader(ShardReader):
    """Records of a Zarr group as `write` makes it. The package zarr would unpack whatever a chunk holds."""

    def __init__(self, path: Path) -> None:
        require_extra(path, *CHECKSUM)
        self._columns: dict[str, _ArrayColumn] = {}
        with whole(path, "Zarr group"):
            if json.loads(read_regular(path / "zarr.json", LARGEST_JSON))["node_type"] != "group":
                raise ValueError("no group")
            numbers = self._values(path, "keys", np.dtype("i8"), MOST_SAMPLES)
            self._ends = self._values(path, "meta_ends", np.dtype("i8"), MOST_SAMPLES + 1).tolist()
            text = self._values(path, "meta", np.dtype("u1"), min(LARGEST_TEXTS, LARGEST_META * max(len(numbers), 1)))
            self._metas = text.tobytes()
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
                    if name not in self._columns:
                        self._columns[name] = _parsed_column(self.path / name)
                    column = self._columns[name]
                    if (column.dtype, column.shape) != (about["dtype"], (len(self), *about["shape"])):
                        raise ValueError(f"{name} of {column.dtype} and shape {column.shape}")
                    arrays[name] = column.row(index)
        return Record(self.keys[index], arrays, meta)

    def _values(self, path: Path, name: str, dtype: np.dtype[Any], most: int) -> NDArray[Any]:
        """All values of an array of one dimension: of this type, and at most so many."""
        found = _parsed_column(path / name)
        if (found.dtype, len(found.shape)) != (dtype, 1) or found.shape[0] > most:
            raise ValueError(f"{name} of {found.dtype} and shape {found.shape}")
        return found.whole()
