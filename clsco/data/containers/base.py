"""Common interface of containers: write shards, and read records one at a time."""

from __future__ import annotations

import contextlib
import json
import re
import struct
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
from clsco.files.archives import npy_array, npy_bytes, npy_size
from clsco.files.atomic import raise_file_error
from clsco.files.decoder_process import run_decoder
from clsco.files.decoders import unzstd
from clsco.files.png import GRAY, RGB, SIGNATURE, png_parts
from clsco.files.strict_json import strict_json


class ShardReader(ABC):
    """The records of a shard, in the order in which they were written. Files are open only while a record is read."""

    def __init__(self, path: Path, keys: Iterable[str]) -> None:
        self.path = path
        self.keys = tuple(keys)

    @abstractmethod
    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        """Read one record. Raises FileError if the shard is damaged.

        names: arrays, by full name or by kind; other arrays are not read if the format stores them apart.
        """

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, index: int) -> Record:
        return self.record(range(len(self))[index])

    def __iter__(self) -> Iterator[Record]:
        return (self.record(index) for index in range(len(self)))


@dataclass(frozen=True)
class Container:
    """A format that holds the records of a shard in one file, or in one folder.

    suffix: end of a shard's name. write: takes a new local path and records, few of which are in memory at a time; the
    same records give the same bytes. read: takes a local path, and raises FileError if the shard is incomplete. needs:
    a module, and the extra of clsco that installs it.
    """

    name: str
    suffix: str
    write: Callable[[Path, Iterable[Record]], None]
    read: Callable[[Path], ShardReader]
    needs: tuple[str, str] | None = None


@contextlib.contextmanager
def translate_errors(path: Path, kind: str) -> Iterator[None]:
    """Turn any error of a codec into a FileError: each raises its own, undocumented ones for damaged files."""
    try:
        yield
    except ClscoError:
        raise
    except Exception as error:
        expected = f"a {kind} that can be read" if isinstance(error, OSError) and error.errno else f"a whole {kind}"
        raise_file_error(path, f"must be {expected}", error, error)


NEEDS = ("imagecodecs", "formats")  # the one package with both Zstandard and PNG of 16 bits in color
LARGEST = 2**31  # bytes of an array
LARGEST_RECORD = 2**32  # and of all arrays of a record
LEVEL = 3  # of Zstandard: 0.29 of the size at 500 MB/s
LARGEST_META = 2**26
NESTED = ("parameters", "labels", "scene", "arrays", "frames")  # in what describes a record
Layout = dict[str, tuple["np.dtype[Any]", tuple[int, ...]]]
_NAME = re.compile(r"[a-z0-9_]+(\.[a-z0-9_]+)*")
_MEMBER = re.compile(r"(.+)\.(npy\.zst|npy|png)")  # array and extension, such as "left.depth.npy.zst"
_DTYPES = {np.dtype(name).name: np.dtype(name) for name in ("?", "u1", "u2", "i4", "i8", "f2", "f4", "f8")}


def encoded(path: Path, array: NDArray[Any], raw: bool = False) -> tuple[str, bytes]:
    """Extension and content of an array's file, always the same; path: for messages. Raises MissingDependencyError."""
    if raw:
        return "npy", npy_bytes(array)
    if is_png(array.dtype.name, array.shape):
        codes = array.astype(np.uint8) * np.uint8(255) if array.dtype == bool else array  # a mask as 0 and 255
        return "png", b"".join(png_parts(codes))
    return "npy.zst", import_extra(path, *NEEDS).zstd_encode(npy_bytes(array), LEVEL)


def decoded(path: Path, extension: str, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Decode a writable array; the exact inverse of `encoded`.

    dtype, shape: expected, as `parsed_meta` gives them; no more memory is allocated. Damage raises any error.
    """
    if extension == "png":
        return _from_png(path, content, dtype, shape)
    if extension == "npy.zst":
        return npy_array(unzstd(path, content, npy_size(dtype, shape)), dtype, shape)
    return npy_array(content, dtype, shape)


def is_png(dtype: str, shape: tuple[int, ...]) -> bool:
    """True if a PNG can hold such an array: a mask or codes, gray or with three channels."""
    return dtype in ("bool", "uint8", "uint16") and (len(shape) == 2 or (len(shape) == 3 and shape[2] == 3))


def _from_png(path: Path, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    if content[:8] != SIGNATURE or content[12:16] != b"IHDR" or len(content) < 33:
        raise ValueError("no PNG")
    columns, rows, bits, color = struct.unpack_from(">IIBB", content, 16)
    expected = (shape[1], shape[0], 16 if dtype == np.uint16 else 8, RGB if len(shape) == 3 else GRAY)
    if (columns, rows, bits, color) != expected or not is_png(dtype.name, shape):
        raise ValueError(f"a PNG of {columns} x {rows}, {bits} bits, color type {color} for {dtype} {shape}")
    data = import_extra(path, *NEEDS).png_decode(content)
    if data.shape != shape:
        raise ValueError(f"pixels of shape {data.shape} for {shape}")
    return data != 0 if dtype == np.bool_ else data


def meta_bytes(record: Record, flat: bool = False) -> bytes:
    """JSON of a record's description, in one line. Raises FileError for values that JSON cannot hold.

    flat: nested tables become strings of JSON, as `datasets` needs one type per key, and scenes differ in theirs.
    """
    try:
        nested = {name: _json(value) for name, value in record.meta.items() if isinstance(value, (dict, list, tuple))}
        return _json({**record.meta, **(nested if flat else {})}).encode()
    except (TypeError, ValueError) as error:
        raise FileError(f"sample {record.key}: must be values that JSON holds; got {error}") from error


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def parsed_meta(path: Path, content: bytes | str) -> tuple[dict[str, Any], Layout]:
    """Content of a meta.json, and types and shapes of the arrays. Raises FileError, or ValueError for invalid JSON."""
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


def record_bytes(layout: Layout) -> int:
    """Size in bytes of all arrays of a record."""
    return sum(prod(shape) * dtype.itemsize for dtype, shape in layout.values())


def chosen(layout: Layout, names: Collection[str] | None) -> Layout:
    """Arrays of a layout with these full names or kinds."""
    return {name: about for name, about in layout.items() if is_named(name, names)}


def confined_arrays(function: str, file: BinaryIO, layout: Layout, **options: Any) -> dict[str, NDArray[Any]]:
    """Arrays of a record, read by a function in a process with limits. Raises ValueError for another layout."""
    _, arrays = run_decoder(function, file, record_bytes(layout), names=list(layout), **options)
    for (name, about), array in zip(layout.items(), arrays, strict=True):
        if (array.dtype, array.shape) != about:
            raise ValueError(f"{name} of {array.dtype} {array.shape}")
    return dict(zip(layout, arrays, strict=True))


Members = tuple[Iterable[str], Callable[[str, int], bytes]]
"""Names of a record's members, and a function that reads a member: (name, most bytes) to its content."""


class MemberReader(ShardReader):
    """Records whose arrays are files of an archive; `kind` names it in messages."""

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
            extensions = {match[1]: match[2] for match in map(_MEMBER.fullmatch, members) if match}
            arrays = {}
            for name, (dtype, shape) in chosen(layout, names).items():
                if extension := extensions.get(name):
                    most = npy_size(dtype, shape) * 9 // 8  # incompressible data grow by less than an eighth
                    data = content(f"{name}.{extension}", most)
                    arrays[name] = decoded(path, extension, data, dtype, shape)
        return Record(self.keys[index], arrays, meta)
