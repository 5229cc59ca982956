"""Zarr 3: a group with an array for each array of a sample, (samples, rows, columns[, channels]), and `meta`.

Files are few: each holds the chunks of up to 16 samples (sharding codec). Read back with zarr.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.containers.base import (
    ShardReader,
    block_size,
    blocks,
    chosen,
    confined_arrays,
    meta_bytes,
    parsed_meta,
    translate_errors,
)
from clsco.data.record import Record
from clsco.errors import import_extra, require_extra
from clsco.files.decoder_process import run_decoder
from clsco.resources import open_regular

NEEDS = ("zarr", "data")
LARGEST_TEXTS = 2**28  # bytes of what describes all records
_FILE = "clsco.data.containers.zarr_file"


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records with the same arrays, each of one type and size, to a new folder, compressed by Zstandard 3 or
    `raw`.
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


class ZarrReader(ShardReader):
    """Records of a Zarr group as `write` makes it."""

    def __init__(self, path: Path) -> None:
        require_extra(path, *NEEDS)
        with translate_errors(path, "Zarr group"):
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
        """Read a chunk of each selected array."""
        with translate_errors(self.path, "Zarr group"), open_regular(self.path / "zarr.json") as file:
            meta, layout = parsed_meta(self.path, self._texts[self._ends[index] : self._ends[index + 1]])
            arrays = confined_arrays(f"{_FILE}:arrays", file, chosen(layout, names), row=index)
        return Record(self.keys[index], arrays, meta)
