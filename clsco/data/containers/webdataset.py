"""WebDataset: a tar whose files KEY.ARRAY.EXTENSION belong together by their key.

Read back with the package `webdataset`, and with `tarfile`, `numpy` and `zstandard` alone.
"""

from __future__ import annotations

import io
import os
import stat
import tarfile
from array import array as numbers
from collections.abc import Collection, Iterable
from pathlib import Path
from sys import intern

from clsco.data.containers.base import ShardReader, whole
from clsco.data.encoding import decoded, described, members, parsed_meta, split_name
from clsco.data.record import Record, is_wanted
from clsco.files.atomic import refuse


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new tar, without names of users and times.

    Parameters
    ----------
    path : Path
    records : iterable of Record
    raw : bool
        Each array as NPY.

    Raises
    ------
    ImageError
        A record cannot be encoded.
    OSError
    """
    with tarfile.open(path, "x", format=tarfile.USTAR_FORMAT) as tar:
        for record in records:
            for name, content in members(path, record, raw, flat=True):
                entry = tarfile.TarInfo(f"{record.key}.{name}")
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))


class TarReader(ShardReader):
    """Records of a tar; its headers are read once, and no file stays open. 24 bytes per member are kept."""

    def __init__(self, path: Path) -> None:
        self._names: list[str] = []
        self._places, self._sizes, self._starts = numbers("q"), numbers("q"), numbers("q")
        keys: list[str] = []
        with whole(path, "tar"):
            size = path.stat().st_size
            with tarfile.open(path, "r:") as tar:
                for entry in tar:
                    if not entry.isreg() or entry.issparse() or entry.offset_data + entry.size > size:
                        refuse(path, "must hold whole, plain files alone", repr(entry.name))
                    key, _, name = entry.name.partition(".")
                    if not keys or key != keys[-1]:
                        keys.append(key)
                        self._starts.append(len(self._names))
                    self._names.append(intern(name))
                    self._places.append(entry.offset_data)
                    self._sizes.append(entry.size)
                    tar.members = []  # type: ignore[attr-defined]  # which it keeps
                if tar.offset + 512 > size:
                    raise ValueError("no end of the archive")
        if len(set(keys)) < len(keys):
            refuse(path, "files of a sample must follow each other", "the key of another one")
        self._starts.append(len(self._names))
        super().__init__(path, keys)

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read the members that are wanted."""
        slots = {self._names[slot]: slot for slot in range(self._starts[index], self._starts[index + 1])}
        with whole(self.path, "tar"), open(self.path, "rb", buffering=0) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ValueError("no file")

            def content(name: str) -> bytes:
                size = self._sizes[slots[name]]
                found = os.pread(file.fileno(), size, self._places[slots[name]])
                if len(found) < size:
                    raise ValueError("the end of the file")
                return found

            if "meta.json" not in slots:
                refuse(self.path, f"sample {self.keys[index]} must have a meta.json", "none")
            meta = parsed_meta(self.path, content("meta.json"))
            arrays = {}
            for name in slots:
                found = split_name(name)
                if found is not None and is_wanted(found[0], wanted):
                    about = described(self.path, meta, found[0])
                    arrays[found[0]] = decoded(self.path, found[1], content(name), about)
        return Record(self.keys[index], arrays, meta)
