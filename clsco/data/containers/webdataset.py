"""WebDataset: a tar with files KEY.ARRAY.EXTENSION; all files of a sample have the same key.

The package `webdataset` reads such files, and so do `tarfile`, `numpy`, `zstandard` and a PNG decoder together.
"""

from __future__ import annotations

import io
import os
import re
import tarfile
from array import array as numbers
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from sys import intern
from typing import BinaryIO

from clsco.data.containers.base import MemberReader, Members, encoded, meta_bytes, translate_errors
from clsco.data.record import Record
from clsco.files.atomic import raise_file_error
from clsco.resources import open_regular, read_at

MOST_EXTENDED = 2**12  # bytes of an extended header, which precedes the header of a file
_RENAMES = re.compile(rb"(^|[ \n])(path|size|linkpath|GNU\.[^=]*)=")


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new tar without user names and times; raw: True to write each array as an uncompressed NPY."""
    with tarfile.open(path, "x", format=tarfile.USTAR_FORMAT) as tar:
        for record in records:
            files = {"meta.json": meta_bytes(record, flat=True)}
            for name, array in record.arrays.items():
                extension, content = encoded(path, array, raw)
                files[f"{name}.{extension}"] = content
            for name, content in files.items():
                entry = tarfile.TarInfo(f"{record.key}.{name}")
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))


def _headers(path: Path, file: BinaryIO) -> Iterator[tuple[str, int, int]]:
    """Name, offset of the content, and size of the content, of each file in a tar. Only headers are read.

    Extended headers that contain nothing but times, as other writers add them, are skipped. `tarfile` is not used,
    because it takes time quadratic in the number of these headers.
    """
    end, place = os.fstat(file.fileno()).st_size, 0
    while (head := read_at(file, 512, place)) != bytes(512):
        checksum = sum(head) - sum(head[148:156]) + 8 * ord(" ")
        if len(head) < 512 or checksum != int(head[148:156].rstrip(b" \0"), 8):
            raise ValueError(f"no header at byte {place}, and no end of the archive before")
        name, _, _ = head[:100].partition(b"\0")
        before, _, _ = head[345:500].partition(b"\0") if head[257:263] == b"ustar\0" else (b"", b"", b"")
        member = (before + b"/" * bool(before) + name).decode("utf-8", "replace")
        kind, size, place = head[156:157], int(head[124:136].rstrip(b" \0") or b"0", 8), place + 512
        extended = read_at(file, min(size, MOST_EXTENDED), place) if kind in (b"x", b"g") else b""
        plain = kind in (b"0", b"\0") or (0 < len(extended) == size and not _RENAMES.search(extended))
        if not plain or not 0 <= size <= end - place:
            raise_file_error(path, "must hold whole, plain files alone", repr(member))
        if not extended:
            yield member, place, size
        place += -(-size // 512) * 512


class TarReader(MemberReader):
    """Records of a tar. Its headers are read once; 24 bytes per file in it stay in memory, and no file stays open."""

    kind = "tar"

    def __init__(self, path: Path) -> None:
        self._names: list[str] = []
        self._places, self._sizes, self._starts = numbers("q"), numbers("q"), numbers("q")
        keys: list[str] = []
        with translate_errors(path, "tar"), open_regular(path) as file:
            for member, place, size in _headers(path, file):
                key, _, name = member.partition(".")
                if not keys or key != keys[-1]:
                    keys.append(key)
                    self._starts.append(len(self._names))
                self._names.append(intern(name))
                self._places.append(place)
                self._sizes.append(size)
        if len(set(keys)) < len(keys):
            raise_file_error(path, "files of a sample must follow each other", "the key of another one")
        self._starts.append(len(self._names))
        super().__init__(path, keys)

    @contextmanager
    def _members(self, index: int) -> Iterator[Members]:
        slots = {self._names[slot]: slot for slot in range(self._starts[index], self._starts[index + 1])}
        if "meta.json" not in slots:
            raise_file_error(self.path, f"sample {self.keys[index]} must have a meta.json", "none")
        with open_regular(self.path) as file:

            def content(name: str, most: int) -> bytes:
                size = self._sizes[slots[name]]
                data = read_at(file, size, self._places[slots[name]]) if size <= most else b""
                if len(data) < size:
                    raise ValueError(f"{size} bytes of {name}, beyond its array or the end of the file")
                return data

            yield slots, content
