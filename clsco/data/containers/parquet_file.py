"""Reader of Parquet columns by pyarrow, called in a process with limits (`run_decoder`) because no header bounds its
memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
import pyarrow  # type: ignore[import-untyped]
import pyarrow.parquet as parquet  # type: ignore[import-untyped]
from numpy.typing import NDArray

pyarrow.set_cpu_count(1)
pyarrow.set_io_thread_count(1)


def layout(file: BinaryIO) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Bytes and rows of each row group, names of columns, and the key of each row."""
    with parquet.ParquetFile(file) as opened:
        about = opened.metadata
        groups = [about.row_group(number) for number in range(about.num_row_groups)]
        return {
            "groups": [(group.total_byte_size, group.num_rows) for group in groups],
            "names": opened.schema_arrow.names,
            "keys": opened.read(["key"], use_threads=False)["key"].to_pylist(),
        }, []


def columns(file: BinaryIO, group: int, names: Sequence[str]) -> tuple[dict[str, Any], list[NDArray[Any]]]:
    """Columns of a row group: for texts and pictures, the start and end of each row's bytes, and the bytes; for lists,
    their count and values.
    """
    arrays: list[NDArray[Any]] = []
    with parquet.ParquetFile(file) as opened:
        for name in names:
            table = opened.read_row_group(group, [name], use_threads=False)
            column = table[name].combine_chunks()
            if pyarrow.types.is_struct(column.type):
                column = column.field("bytes")
            if pyarrow.types.is_list(column.type):
                while pyarrow.types.is_list(column.type):
                    column = column.flatten()
                arrays += [np.array([len(column)], np.int64), column.to_numpy(zero_copy_only=False)]
            else:
                if column.null_count:
                    raise ValueError(f"{name} that is not there in each row")
                column = column.cast(pyarrow.large_binary())
                _, ends, content = column.buffers()
                places = np.frombuffer(ends, np.int64)[column.offset : column.offset + len(column) + 1]
                arrays += [places, np.frombuffer(content or b"", np.uint8)[: places[-1]]]
    return {}, arrays
