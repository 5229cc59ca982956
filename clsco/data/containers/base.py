"""Common interface of containers: write shards, and read records one at a time."""

from __future__ import annotations

import contextlib
import json
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsco.data.record import Record, is_named
from clsco.errors import ClscoError, FileError, import_extra
from clsco.files.archives import npy_array as npy_array
from clsco.files.archives import npy_bytes as npy_bytes
from clsco.files.archives import npy_size as npy_size
from clsco.files.atomic import raise_file_error
from clsco.files.decoder_process import run_decoder
from clsco.files.decoders import unzstd
from clsco.files.png import GRAY, RGB, SIGNATURE, png_parts
from clsco.files.strict_json import strict_json


class ShardReader(ABC):
    """The records of a shard, in the order in which they were written.

    Files are opened for the first record; a closed reader opens them again. A reader is for one thread at a time.
    """

    def __init__(self, path: Path, keys: Iterable[str]) -> None:
        self.path = path
        self.keys = tuple(keys)

    @abstractmethod
    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        """Read one record. Raises FileError if the shard is damaged.

        names: arrays, by full name or by kind; other arrays are not read if the format stores them apart.
        """

    def close(self) -> None:  # noqa: B027, some leave nothing open
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

    suffix: end of a shard's name, "" for a folder without one. write: takes a new local path and records, few of which
    are in memory at a time; the same records give the same bytes. read: takes a local path, and raises FileError if the
    shard is incomplete. needs: a module, and the extra of clsco that installs it.
    """

    name: str
    suffix: str
    write: Callable[[Path, Iterable[Record]], None]
    read: Callable[[Path], ShardReader]
    needs: tuple[str, str] | None = None


@contextlib.contextmanager
def translate_errors(path: Path, kind: str) -> Iterator[None]:
    """Turn any error of a codec into a FileError: each codec raises its own exceptions for damaged files,
    undocumented.
    """
    try:
        yield
    except ClscoError:
        raise
    except OSError as error:
        rule = f"must be a {kind} that can be read" if error.errno else f"must be a whole {kind}"
        raise_file_error(path, rule, error, error)
    except Exception as error:
        raise_file_error(path, f"must be a whole {kind}", error, error)


Layout = dict[str, tuple["np.dtype[Any]", tuple[int, ...]]]
MOST_SAMPLES, MOST_BYTES = 16, 2**26  # of a block


def block_size(layout: Layout) -> int:
    """Records per block in memory: 16, or fewer if they exceed 64 MiB."""
    return max(1, min(MOST_SAMPLES, MOST_BYTES // max(record_bytes(layout), 1)))


def record_bytes(layout: Layout) -> int:
    """Size in bytes of all arrays of a record."""
    return sum(prod(shape) * dtype.itemsize for dtype, shape in layout.values())


def blocks(path: Path, records: Iterable[Record], kind: str) -> Iterator[tuple[Layout, list[Record]]]:
    """The layout of all records, with up to `block_size` records at a time.

    Raises FileError: two records have different layouts, or there is no record.
    """
    layout: Layout | None = None
    block: list[Record] = []
    for record in records:
        own = {name: (array.dtype, array.shape) for name, array in record.arrays.items()}
        layout = own if layout is None else layout
        if own != layout:
            rule = f"{kind} must have the same arrays in all samples, of one type and size"
            raise_file_error(path, rule, f"{_differing(layout, own)} in sample {record.key}")
        block.append(record)
        if len(block) == block_size(layout):
            yield layout, block
            block = []
    if layout is None:
        raise_file_error(path, f"{kind} must have a sample", "none")
    if block:
        yield layout, block


def _differing(layout: Layout, own: Layout) -> str:
    name = next((name for name in (*layout, *own) if layout.get(name) != own.get(name)), "another order")
    if name not in own:
        return f"no {name}"
    return f"{name} {own[name][0]} {own[name][1]}"


NEEDS = ("imagecodecs", "formats")  # the one package with both Zstandard and PNG of 16 bits in color
EXTENSIONS = ("npy.zst", "npy", "png")
LARGEST = 2**31  # bytes of an array
LARGEST_RECORD = 2**32  # and of all arrays of a record
LEVEL = 3  # of Zstandard: 0.29 of the size at 500 MB/s
LARGEST_META = 2**26
NESTED = ("parameters", "labels", "scene", "arrays", "frames")  # in what describes a record
_NAME = re.compile(r"[a-z0-9_]+(\.[a-z0-9_]+)*")
_DTYPES = {np.dtype(name).name: np.dtype(name) for name in ("?", "u1", "u2", "i4", "i8", "f2", "f4", "f8")}


def encoded(path: Path, array: NDArray[Any], raw: bool = False) -> tuple[str, bytes]:
    """Extension, one of `EXTENSIONS`, and content of the file of an array; path: for messages.

    The same array gives the same bytes. Raises FileError: the extra `formats` is missing.
    """
    if raw:
        return "npy", npy_bytes(array)
    if is_png(array.dtype.name, array.shape):
        return "png", png_bytes(array)
    return "npy.zst", import_extra(path, *NEEDS).zstd_encode(npy_bytes(array), LEVEL)


def decoded(path: Path, extension: str, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Decode a writable array; the exact inverse of `encoded`.

    dtype, shape: expected, as `parsed_meta` gives them; no more memory is allocated. Damage raises any error of a
    codec, which readers turn into a FileError.
    """
    if extension == "png":
        return _from_png(path, content, dtype, shape)
    if extension == "npy.zst":
        return npy_array(unzstd(path, content, npy_size(dtype, shape)), dtype, shape)
    return npy_array(content, dtype, shape)


def stored_size(dtype: np.dtype[Any], shape: tuple[int, ...]) -> int:
    """Upper bound of an array's bytes, compressed or not: incompressible data grow by less than an eighth."""
    return npy_size(dtype, shape) * 9 // 8


def is_png(dtype: str, shape: tuple[int, ...]) -> bool:
    """True if a PNG can hold such an array: a mask or codes, gray or with three channels."""
    return dtype in ("bool", "uint8", "uint16") and (len(shape) == 2 or (len(shape) == 3 and shape[2] == 3))


def png_bytes(array: NDArray[Any]) -> bytes:
    """PNG file of codes, or of a mask as 0 and 255."""
    return b"".join(png_parts(array.astype(np.uint8) * np.uint8(255) if array.dtype == bool else array))


def _from_png(path: Path, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    if content[:8] != SIGNATURE or content[12:16] != b"IHDR" or len(content) < 33:
        raise ValueError("no PNG")
    columns, rows = int.from_bytes(content[16:20], "big"), int.from_bytes(content[20:24], "big")
    bits, color = content[24], content[25]
    expected = (shape[1], shape[0], 16 if dtype == np.uint16 else 8, RGB if len(shape) == 3 else GRAY)
    if (columns, rows, bits, color) != expected or not is_png(dtype.name, shape):
        raise ValueError(f"a PNG of {columns} x {rows}, {bits} bits, color type {color} for {dtype} {shape}")
    data = import_extra(path, *NEEDS).png_decode(content)
    if data.shape != shape:
        raise ValueError(f"pixels of shape {data.shape} for {shape}")
    return data != 0 if dtype == np.bool_ else data


def meta_bytes(record: Record, flat: bool = False) -> bytes:
    """JSON of a record's description, in one line. Raises FileError for values that JSON cannot hold.

    flat: nested tables become strings of JSON, as `datasets` needs one type per key and scenes differ in theirs.
    """
    try:
        nested = {name: _json(value) for name, value in record.meta.items() if isinstance(value, (dict, list, tuple))}
        return _json({**record.meta, **(nested if flat else {})}).encode()
    except (TypeError, ValueError) as error:
        raise FileError(f"sample {record.key}: must be values that JSON holds; got {error}") from error


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def parsed_meta(path: Path, content: bytes | str) -> tuple[dict[str, Any], Layout]:
    """Parse the meta.json of a record: its content, and the types and shapes of the arrays. Raises FileError, or
    ValueError for invalid JSON.
    """
    if len(content) > LARGEST_META:
        raise_file_error(path, f"meta.json must have at most {LARGEST_META} bytes", len(content))
    meta = strict_json(content)
    if isinstance(meta, dict) and isinstance(meta.get("arrays"), str):  # flat
        meta |= {name: strict_json(meta[name]) for name in NESTED if isinstance(meta.get(name), str)}
    if not isinstance(meta, dict) or not isinstance(meta.get("arrays"), dict):
        raise_file_error(path, "meta.json must be an object with arrays", type(meta).__name__)
    layout = {name: _layout_of(path, name, about) for name, about in meta["arrays"].items()}
    if (total := record_bytes(layout)) > LARGEST_RECORD:
        raise_file_error(path, f"arrays of a sample must have at most {LARGEST_RECORD} bytes in all", total)
    return meta, layout


def _layout_of(path: Path, name: str, about: Any) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of an array from its entry in meta.json. Raises FileError for values that no record has."""
    if not isinstance(about, dict) or not _NAME.fullmatch(name):
        raise_file_error(path, "arrays must have plain names and be described in meta.json", repr(name))
    dtype = _DTYPES.get(str(about.get("dtype")))
    shape: Any = about.get("shape")
    if dtype is None:
        raise_file_error(path, f"dtype of {name} must be one of {', '.join(_DTYPES)}", repr(about.get("dtype")))
    plain = isinstance(shape, list) and 1 <= len(shape) <= 5 and all(type(size) is int and size > 0 for size in shape)
    if not plain or prod(shape) * dtype.itemsize > LARGEST:
        raise_file_error(path, f"shape of {name} must be 1 to 5 sizes of at most {LARGEST} bytes in all", shape)
    return dtype, tuple(shape)


def chosen(layout: Layout, names: Collection[str] | None) -> Layout:
    """Arrays of a layout selected by full name or by kind."""
    return {name: about for name, about in layout.items() if is_named(name, names)}


def confined_arrays(function: str, file: BinaryIO, layout: Layout, **options: Any) -> dict[str, NDArray[Any]]:
    """Arrays of a record, read by a function in a process with limits. Raises ValueError for other types, shapes or
    more bytes than in the layout.
    """
    _, arrays = run_decoder(function, file, record_bytes(layout), names=list(layout), **options)
    for (name, about), array in zip(layout.items(), arrays, strict=True):
        if (array.dtype, array.shape) != about:
            raise ValueError(f"{name} of {array.dtype} {array.shape}")
    return dict(zip(layout, arrays, strict=True))


def split_name(member: str) -> tuple[str, str] | None:
    """Array and extension of a member such as "left.depth.npy.zst"; None for a member that is not an array."""
    for extension in EXTENSIONS:
        if member.endswith(f".{extension}"):
            return member.removesuffix(f".{extension}"), extension
    return None


Members = tuple[Iterable[str], Callable[[str, int], bytes]]
"""Names of a record's members, and a function that reads a member: (name, most bytes) to its content."""


class MemberReader(ShardReader):
    """Records whose arrays are members: files of a folder or of an archive; `kind` names it in messages."""

    kind: ClassVar[str]

    @abstractmethod
    def _members(self, index: int) -> contextlib.AbstractContextManager[Members]:
        """Open the members of a record."""

    def _place(self, index: int) -> Path:  # noqa: ARG002, of formats with a file for each record
        return self.path

    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        """Read the members of the selected arrays."""
        path = self._place(index)
        with translate_errors(path, self.kind), self._members(index) as (members, content):
            meta, layout = parsed_meta(path, content("meta.json", LARGEST_META))
            extensions = dict(split for member in members if (split := split_name(member)) is not None)
            arrays = {}
            for name, (dtype, shape) in chosen(layout, names).items():
                if extension := extensions.get(name):
                    data = content(f"{name}.{extension}", stored_size(dtype, shape))
                    arrays[name] = decoded(path, extension, data, dtype, shape)
        return Record(self.keys[index], arrays, meta)
