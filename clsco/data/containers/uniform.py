"""Containers with one column for each array: all samples of a shard must have the same ones, of one type and size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.record import Record
from clsco.files.atomic import refuse

Layout = dict[str, tuple["np.dtype[Any]", tuple[int, ...]]]
MOST_SAMPLES, MOST_BYTES = 16, 2**26  # of a block


def block_size(layout: Layout) -> int:
    """Records that are in memory together: 16, or fewer where they have more than 64 MiB."""
    return max(1, min(MOST_SAMPLES, MOST_BYTES // max(record_bytes(layout), 1)))


def record_bytes(layout: Layout) -> int:
    """Bytes of the arrays of a record."""
    return sum(prod(shape) * dtype.itemsize for dtype, shape in layout.values())


def blocks(path: Path, records: Iterable[Record], kind: str) -> Iterator[tuple[Layout, list[Record]]]:
    """The layout of all records, and up to `block_size` of them at a time.

    Raises
    ------
    ImageError
        Two records differ in their layout, or there is none.
    """
    layout: Layout | None = None
    block: list[Record] = []
    for record in records:
        own = {name: (array.dtype, array.shape) for name, array in record.arrays.items()}
        layout = own if layout is None else layout
        if own != layout:
            rule = f"{kind} must have the same arrays in all samples, of one type and size"
            refuse(path, rule, f"{_differing(layout, own)} in sample {record.key}")
        block.append(record)
        if len(block) == block_size(layout):
            yield layout, block
            block = []
    if layout is None:
        refuse(path, f"{kind} must have a sample", "none")
    if block:
        yield layout, block


def _differing(layout: Layout, own: Layout) -> str:
    name = next((name for name in (*layout, *own) if layout.get(name) != own.get(name)), "another order")
    if name not in own:
        return f"no {name}"
    return f"{name} {own[name][0]} {own[name][1]}"
