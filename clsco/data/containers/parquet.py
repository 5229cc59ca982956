"""Parquet as the Hugging Face package `datasets` has it: codes and masks as `Image`, floats as `Array2D` and so on.

Columns are `key`, one for each array, and `meta`, a string of JSON. Read back with pyarrow and with `datasets`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers.base import ShardReader, whole
from clsco.data.containers.uniform import Layout, blocks, record_bytes
from clsco.data.encoding import LARGEST, decoded, described, is_png, meta_bytes, parsed_meta, png_bytes
from clsco.data.record import Record, is_wanted
from clsco.files.atomic import refuse
from clsco.files.decoders import codec

NEEDS = ("pyarrow", "data")
_EXTENSION = "ARROW:extension:"  # with the type of `datasets`, which others take for lists of lists
MOST_ROWS = 2**16
GROUP = 2**23  # bytes, about, of a row group, which is what a reader reads at once


def write(path: Path, records: Iterable[Record]) -> None:
    """Write records to a new file.

    Parameters
    ----------
    path : Path
    records : iterable of Record
        With the same arrays, each of one type and size.
    """
    parquet, writer = codec(path, "pyarrow.parquet", "data"), None
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
    """Columns, and what `datasets` makes of them."""
    pyarrow = codec(path, *NEEDS)
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
    pyarrow = codec(path, *NEEDS)
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
    """A column of lists of lists, one for each item of the first dimension."""
    column = pyarrow.array(values.reshape(-1))
    for axis in range(values.ndim - 1, 0, -1):
        count = prod(values.shape[:axis])
        ends = np.arange(count + 1, dtype=np.int32) * np.int32(values.shape[axis])
        column = pyarrow.ListArray.from_arrays(ends, column)
    return column


class ParquetReader(ShardReader):
    """Records of a Parquet file; the row group that was read last is kept."""

    def __init__(self, path: Path) -> None:
        self._file: Any = None
        self._kept: tuple[int, tuple[str, ...], Any] | None = None
        self._parquet = codec(path, "pyarrow.parquet", "data")
        self._places: list[tuple[int, int]] = []
        with whole(path, "Parquet file"), self._parquet.ParquetFile(path) as file:
            about = file.metadata
            for number in range(about.num_row_groups):
                group = about.row_group(number)
                if group.total_byte_size > LARGEST or group.num_rows > MOST_ROWS:
                    rule = f"row groups must have at most {LARGEST} bytes and {MOST_ROWS} rows"
                    refuse(path, rule, f"{group.total_byte_size} and {group.num_rows}")
                self._places += [(number, row) for row in range(group.num_rows)]
            self._names = file.schema_arrow.names
            keys = file.read(["key"])["key"].to_pylist()
        if len(keys) != len(self._places) or not all(isinstance(key, str) for key in keys):
            refuse(path, "must have a key in each row", f"{len(keys)} of {len(self._places)}")
        super().__init__(path, keys)

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read the columns that are wanted."""
        group, row = self._places[index]
        names = tuple(name for name in self._names if name not in ("key", "meta") and is_wanted(name, wanted))
        with whole(self.path, "Parquet file"):
            if self._kept is None or self._kept[:2] != (group, names):
                if self._file is None:
                    self._file = self._parquet.ParquetFile(self.path)
                self._kept = (group, names, self._file.read_row_group(group, ["meta", *names]))
            table = self._kept[2].slice(row, 1)
            meta = parsed_meta(self.path, table["meta"][0].as_py())
            arrays = {name: self._array(table[name], described(self.path, meta, name)) for name in names}
        return Record(self.keys[index], arrays, meta)

    def _array(self, column: Any, about: dict[str, Any]) -> NDArray[Any]:
        dtype, shape = about["dtype"], about["shape"]
        if is_png(dtype.name, shape):
            return decoded(self.path, "png", column[0]["bytes"].as_py(), about)
        values = column.combine_chunks()
        for _ in shape:
            values = values.flatten()
        flat = values.to_numpy(zero_copy_only=False)
        if flat.dtype != dtype:
            raise ValueError(f"{flat.dtype} for {dtype}")
        return np.array(flat.reshape(shape))

    def close(self) -> None:
        """Close the file, and let go of the row group."""
        self._kept = None
        if self._file is not None:
            self._file.close()
            self._file = None
