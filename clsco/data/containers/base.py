"""Common interface of containers: shards are written, and read one record at a time."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.record import Record
from clsco.errors import ClscoError
from clsco.files.atomic import refuse


class ShardReader(ABC):
    """The records of a shard, in the order in which they were written.

    Nothing is open before the first record is read; a closed reader opens again. A reader is used by one thread at a
    time.

    Attributes
    ----------
    path : Path
    keys : tuple of str
    """

    def __init__(self, path: Path, keys: Iterable[str]) -> None:
        self.path = path
        self.keys = tuple(keys)

    @abstractmethod
    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read one record.

        Parameters
        ----------
        index : int
            From 0.
        wanted : collection of str, optional
            Names of arrays, whole ones or what they hold; nothing else is read where the format has it apart.

        Raises
        ------
        ImageError
            The shard is damaged.
        """

    def close(self) -> None:  # noqa: B027, some keep nothing open
        """Close open files."""

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, index: int) -> Record:
        return self.record(range(len(self))[index])

    def __iter__(self) -> Iterator[Record]:
        return (self.record(index) for index in range(len(self)))


@dataclass(frozen=True)
class Container:
    """A format that holds the records of a shard in one file, or in one folder.

    Attributes
    ----------
    name : str
        As users give it.
    suffix : str
        End of a shard's name; "" where it is a folder without one.
    write : callable
        Takes a new local path and records; the same records give the same bytes. Few records are in memory at a time.
    read : callable
        Takes a local path and gives a ShardReader. Raises ImageError where it is no whole shard.
    needs : (str, str), optional
        Module that it needs, and the extra of clsco that brings it.
    """

    name: str
    suffix: str
    write: Callable[[Path, Iterable[Record]], None]
    read: Callable[[Path], ShardReader]
    needs: tuple[str, str] | None = None


@contextlib.contextmanager
def whole(path: Path, kind: str) -> Iterator[None]:
    """Turn any error of a codec into an ImageError: each has its own exceptions for damage, and none lists them."""
    try:
        yield
    except ClscoError:
        raise
    except OSError as error:
        rule = f"must be a {kind} that can be read" if error.errno else f"must be a whole {kind}"
        refuse(path, rule, error, error)
    except Exception as error:
        refuse(path, f"must be a whole {kind}", error, error)


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

    Raises ImageError: two records differ in their layout, or there is none.
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
