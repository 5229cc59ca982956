"""Interface that all containers share: it writes shards, and reads their records one at a time."""

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
from clsco.files.transfer import TRANSFERS
from clsco.scene.text import any_of, shown


class ShardReader(ABC):
    """The records of a shard, in the order in which they were written. Files are open only while a record is read."""

    def __init__(self, path: Path, keys: Iterable[str]) -> None:
        self.path = path
        self.keys = tuple(keys)

    @abstractmethod
    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        """Read one record. Raises FileError if the shard is damaged.

        names: the arrays to read, by full name ("left.depth") or by kind ("depth"); None for all.
        """

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, index: int) -> Record:
        return self.record(range(len(self))[index])

    def __iter__(self) -> Iterator[Record]:
        return (self.record(index) for index in range(len(self)))


@dataclass(frozen=True)
class Container:
    """A format that stores the records of a shard in one file or one folder.

    suffix: end of the name of each shard. write: function that writes records to a new local path; equal records give
    equal bytes. read: function that opens the shard at a local path, and raises FileError if the shard is damaged.
    needs: the module that the format needs, and the extra of clsco that installs this module.
    """

    name: str
    suffix: str
    write: Callable[[Path, Iterable[Record]], None]
    read: Callable[[Path], ShardReader]
    needs: tuple[str, str] | None = None


@contextlib.contextmanager
def translate_errors(path: Path, kind: str) -> Iterator[None]:
    """Turn any error of a codec into a FileError, because codecs raise undocumented errors for damaged files."""
    try:
        yield
    except ClscoError:
        raise
    except Exception as error:
        expected = f"a {kind} that can be read" if isinstance(error, OSError) and error.errno else f"a whole {kind}"
        raise_file_error(path, f"must be {expected}", error, error)


NEEDS = ("imagecodecs", "formats")  # the one package with both Zstandard and PNG of 16 bits in color
LARGEST = 2**31  # bytes of an array
LARGEST_RECORD = 2**32  # bytes of all arrays of a record
LEVEL = 3  # level of Zstandard: reduces arrays to 0.29 of their size, at 500 MB/s
LARGEST_META = 2**26  # bytes of a meta.json
NESTED = ("parameters", "labels", "scene", "arrays", "frames")  # entries of meta.json that are tables or lists
Layout = dict[str, tuple["np.dtype[Any]", tuple[int, ...]]]
"""Type and shape of each array of a record, by the array's name."""
_NAME = re.compile(r"[a-z0-9_]+(\.[a-z0-9_]+)*")
_MEMBER = re.compile(r"(.+)\.(npy\.zst|npy|png)")  # name of an array and extension, such as "left.depth.npy.zst"
_DTYPES = {np.dtype(name).name: np.dtype(name) for name in ("?", "u1", "u2", "i4", "i8", "f2", "f4", "f8")}


def encoded(path: Path, array: NDArray[Any], raw: bool = False) -> tuple[str, bytes]:
    """Extension and content of the file of an array; equal arrays give equal bytes. Raises MissingDependencyError.

    path: file that messages name. raw: True to compress nothing.
    """
    if raw:
        return "npy", npy_bytes(array)
    if is_png(array.dtype.name, array.shape):
        codes = array.astype(np.uint8) * np.uint8(255) if array.dtype == bool else array  # a mask as 0 and 255
        return "png", b"".join(png_parts(codes))
    return "npy.zst", import_extra(path, *NEEDS).zstd_encode(npy_bytes(array), LEVEL)


def decoded(path: Path, extension: str, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Decode an array, exactly as it was before `encoded`. The array is writable. Damaged content raises any error.

    dtype, shape: type and shape that the array must have. They limit the memory that is allocated.
    """
    if extension == "png":
        return _from_png(path, content, dtype, shape)
    if extension == "npy.zst":
        return npy_array(unzstd(path, content, npy_size(dtype, shape)), dtype, shape)
    return npy_array(content, dtype, shape)


def is_png(dtype: str, shape: tuple[int, ...]) -> bool:
    """True if a PNG can store an array of this type and shape: a mask or codes, with one channel or three."""
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
    """The description of a record as one line of JSON. Raises FileError for values that JSON cannot hold.

    flat: True to write each table and list as a string of JSON, because the package `datasets` needs one type for each
    key in all samples, and scenes have different keys.
    """
    try:
        nested = {name: _json(value) for name, value in record.meta.items() if isinstance(value, (dict, list, tuple))}
        return _json({**record.meta, **(nested if flat else {})}).encode()
    except (TypeError, ValueError) as error:
        raise FileError(f"sample {record.key}: must be values that JSON holds; got {error}") from error


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def parsed_meta(path: Path, content: bytes | str) -> tuple[dict[str, Any], Layout]:
    """The content of a meta.json, and the layout of its arrays. Raises FileError, or ValueError for invalid JSON."""
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
    """Type and shape of an array from its entry in meta.json. Raises FileError if they are invalid or too large."""
    if not isinstance(about, dict) or not _NAME.fullmatch(name):
        raise_file_error(path, "arrays must have plain names and be described in meta.json", shown(name))
    dtype = _DTYPES.get(str(about.get("dtype")))
    shape: Any = about.get("shape")
    if dtype is None:
        raise_file_error(path, f"dtype of {name} must be one of {', '.join(_DTYPES)}", shown(about.get("dtype")))
    if about.get("transfer", "linear") not in TRANSFERS:
        raise_file_error(path, f"transfer of {name} must be {any_of(TRANSFERS)}", shown(about["transfer"]))
    plain = isinstance(shape, list) and 1 <= len(shape) <= 5 and all(type(size) is int and size > 0 for size in shape)
    if not plain or prod(shape) * dtype.itemsize > LARGEST:
        raise_file_error(path, f"shape of {name} must be 1 to 5 sizes of at most {LARGEST} bytes in all", shown(shape))
    return dtype, tuple(shape)


def record_bytes(layout: Layout) -> int:
    """Size in bytes of all arrays of a record."""
    return sum(prod(shape) * dtype.itemsize for dtype, shape in layout.values())


def chosen(layout: Layout, names: Collection[str] | None) -> Layout:
    """The arrays of a layout that have one of these full names or kinds; all arrays if `names` is None."""
    return {name: about for name, about in layout.items() if is_named(name, names)}


def confined_arrays(function: str, file: BinaryIO, layout: Layout, **options: Any) -> dict[str, NDArray[Any]]:
    """Read arrays of a record by a function that runs in a process with limits.

    function: name as for `run_decoder`. Raises ValueError if an array has another type or shape than in `layout`.
    """
    _, arrays = run_decoder(function, file, record_bytes(layout), names=list(layout), **options)
    for (name, about), array in zip(layout.items(), arrays, strict=True):
        if (array.dtype, array.shape) != about:
            raise ValueError(f"{name} of {array.dtype} {array.shape}")
    return dict(zip(layout, arrays, strict=True))


Members = tuple[Iterable[str], Callable[[str, int], bytes]]
"""Names of the files that store a record in an archive, and a function that returns the content of one of these files;
it takes the name and the largest size in bytes that the file may have."""


class MemberReader(ShardReader):
    """Reader of records whose arrays are separate files in an archive; kind: name of the format in messages."""

    kind: ClassVar[str]

    @abstractmethod
    def _members(self, index: int) -> contextlib.AbstractContextManager[Members]:
        """Open the archive that stores a record; it is closed at the end of the `with` block."""

    def _place(self, index: int) -> Path:  # noqa: ARG002, used by formats with one archive per record
        return self.path

    def record(self, index: int, names: Collection[str] | None = None) -> Record:
        """Read one record: its meta.json, and the files of the selected arrays. An array without a file is left out."""
        path = self._place(index)
        with translate_errors(path, self.kind), self._members(index) as (members, content):
            meta, layout = parsed_meta(path, content("meta.json", LARGEST_META))
            extensions = {match[1]: match[2] for match in map(_MEMBER.fullmatch, members) if match}
            arrays = {}
            for name, (dtype, shape) in chosen(layout, names).items():
                if extension := extensions.get(name):
                    most = npy_size(dtype, shape) * 9 // 8  # compression makes no data longer by an eighth
                    data = content(f"{name}.{extension}", most)
                    arrays[name] = decoded(path, extension, data, dtype, shape)
        return Record(self.keys[index], arrays, meta)
