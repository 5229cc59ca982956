"""Parquet in the layout of the Hugging Face package `datasets`: codes and masks as `Image`, floats as `Array2D` and so
on.

Columns are `key`, one for each array, and `meta`, a string of JSON. Read back with pyarrow and with `datasets`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers.base import (
    LARGEST,
    Layout,
    ShardReader,
    blocks,
    chosen,
    decoded,
    is_png,
    meta_bytes,
    parsed_meta,
    png_bytes,
    record_bytes,
    stored_size,
    translate_errors,
)
from clsco.data.record import Record
from clsco.errors import import_extra, require_extra
from clsco.files.atomic import raise_file_error
from clsco.files.decoder_process import run_decoder
from clsco.resources import open_regular

NEEDS = ("pyarrow", "data")
_EXTENSION = "ARROW:extension:"  # with the type of `datasets`, which others take for lists of lists
MOST_ROWS = 2**16
MOST_KEYS, MOST_META = 2**25, 2**26  # bytes of all keys, and of what describes the records of a row group
GROUP = 2**23  # bytes, about, of a row group, which is what a reader reads at once
_FILE = "clsco.data.containers.parquet_file"


def write(path: Path, records: Iterable[Record]) -> None:
    """Write records with the same arrays, each of one type and size, to a new file."""
    parquet, writer = import_extra(path, "pyarrow.parquet", "data"), None
    try:
        for layout, block in blocks(path, records, "parquet"):
            schema = _schema(path, layout)
            if writer is None:
                writer = parquet.ParquetWriter(
                    path, schema, compression="zstd", compression_level=3, use_dictionary=False, write_statistics=False
                )
            rows = max(1, GROUP // max(record_bytes(layout), 1))
            for first in range(0, len(block), rows):
                writer.write_table(_table(path, schema, layout, block[first : first + rows]))
    finally:
        if writer is not None:
            writer.close()


def _schema(path: Path, layout: Layout) -> Any:
    """Columns of the file, with the features that `datasets` reads them as."""
    pyarrow = import_extra(path, *NEEDS)
    fields: list[Any] = [("key", pyarrow.string())]
    features: dict[str, Any] = {"key": {"dtype": "string", "_type": "Value"}}
    for name, (dtype, shape) in layout.items():
        if is_png(dtype.name, shape):
            fields.append((name, pyarrow.struct([("bytes", pyarrow.binary()), ("path", pyarrow.string())])))
            features[name] = {"_type": "Image"}
            continue
        kind = pyarrow.from_numpy_dtype(dtype)
        for _ in shape:
            kind = pyarrow.list_(kind)
        extension = f"datasets.features.features.Array{len(shape)}DExtensionType"
        about = {_EXTENSION + "name": extension, _EXTENSION + "metadata": json.dumps((shape, dtype.name))}
        fields.append(pyarrow.field(name, kind, metadata=about))
        features[name] = {"shape": list(shape), "dtype": dtype.name, "_type": f"Array{len(shape)}D"}
    fields.append(("meta", pyarrow.string()))
    features["meta"] = {"dtype": "string", "_type": "Value"}
    return pyarrow.schema(fields, {"huggingface": json.dumps({"info": {"features": features}})})


def _table(path: Path, schema: Any, layout: Layout, block: list[Record]) -> Any:
    pyarrow = import_extra(path, *NEEDS)
    columns: list[Any] = [pyarrow.array([record.key for record in block])]
    for name, (dtype, shape) in layout.items():
        arrays = [record.arrays[name] for record in block]
        if is_png(dtype.name, shape):
            rows = [{"bytes": png_bytes(array), "path": None} for array in arrays]
            columns.append(pyarrow.array(rows, schema.field(name).type))
        else:
            columns.append(_nested(pyarrow, np.stack(arrays)))
    columns.append(pyarrow.array([meta_bytes(record).decode() for record in block]))
    return pyarrow.Table.from_arrays(columns, schema=schema)


def _nested(pyarrow: Any, values: NDArray[Any]) -> Any:
    """A column of nested lists, one per item of the first dimension."""
    column = pyarrow.array(values.reshape(-1))
    for axis in range(values.ndim - 1, 0, -1):
        count = prod(values.shape[:axis])
        ends = np.arange(count + 1, dtype=np.int32) * np.int32(values.shape[axis])
        column = pyarrow.ListArray.from_arrays(ends, column)
    return column


class _Column(NamedTuple):
    """A column of a row group: for bytes, the start of each row and the end; for lists, the values of all rows."""

    places: NDArray[np.int64]
    values: NDArray[Any]

    def row(self, number: int) -> NDArray[np.uint8]:
        """Bytes of a row."""
        return self.values[self.places[number] : self.places[number + 1]]


class ParquetReader(ShardReader):
    """Records of a Parquet file; the row group that was read last stays in memory."""

    def __init__(self, path: Path) -> None:
        self._group: tuple[int, dict[str, _Column]] | None = None
        self._rows: list[tuple[int, int]] = []  # of each record the row group, and the row in it
        require_extra(path, *NEEDS)
        with translate_errors(path, "Parquet file"), open_regular(path) as file:
            about, _ = run_decoder(f"{_FILE}:layout", file, MOST_KEYS)
            for number, (size, rows) in enumerate(about["groups"]):
                if size > LARGEST or rows > MOST_ROWS:
                    rule = f"row groups must have at most {LARGEST} bytes and {MOST_ROWS} rows"
                    raise_file_error(path, rule, f"{size} and {rows}")
                self._rows += [(number, row) for row in range(rows)]
        self._names, keys = tuple(map(str, about["names"])), about["keys"]
        if len(keys) != len(self._rows) or not all(isinstance(key, str) for key in keys):
            raise_file_error(path, "must have a key in each row", f"{len(keys)} of {len(self._rows)}")
        super().__init__(path, keys)

    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        """Read the columns of the selected arrays."""
        group, row = self._rows[index]
        with translate_errors(self.path, "Parquet file"):
            if self._group is None or self._group[0] != group:
                self._group = (group, self._columns(group, ["meta"], MOST_META))
            columns = self._group[1]
            meta, layout = parsed_meta(self.path, bytes(columns["meta"].row(row)))
            layout = {name: about for name, about in chosen(layout, names).items() if name in self._names}
            rows = len(columns["meta"].places) - 1
            if missing := [name for name in layout if name not in columns]:
                most = rows * sum(stored_size(*layout[name]) for name in missing)
                if most > LARGEST:
                    raise ValueError(f"{rows} rows of {most // rows} bytes in a row group")
                columns |= self._columns(group, missing, most)
            arrays = {name: self._array(columns[name], row, rows, *about) for name, about in layout.items()}
        return Record(self.keys[index], arrays, meta)

    def _columns(self, group: int, names: Sequence[str], most: int) -> dict[str, _Column]:
        with open_regular(self.path) as file:
            _, arrays = run_decoder(f"{_FILE}:columns", file, most, group=group, names=list(names))
        pairs = zip(names, arrays[::2], arrays[1::2], strict=True)
        return {name: _Column(places, values) for name, places, values in pairs}

    def _array(
        self, column: _Column, row: int, rows: int, dtype: np.dtype[Any], shape: tuple[int, ...]
    ) -> NDArray[Any]:
        if is_png(dtype.name, shape):
            return decoded(self.path, "png", bytes(column.row(row)), dtype, shape)
        if column.values.dtype != dtype or len(column.values) != rows * prod(shape):
            raise ValueError(f"{len(column.values)} values of {column.values.dtype} for {rows} of {dtype} {shape}")
        return np.array(column.values.reshape(rows, *shape)[row])

    def close(self) -> None:
        """Free the row group."""
        self._group = None
