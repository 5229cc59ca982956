"""NPZ: a folder with one file per sample. NumPy reads such files."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from clsco.data.containers.base import MemberReader, Members, meta_bytes, translate_errors
from clsco.data.record import Record
from clsco.files.archives import member_bytes, npy_bytes, open_archive
from clsco.resources import open_regular


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder as KEY.npz.

    raw: True to compress nothing; else integers and masks are compressed. Floats never are, because deflate takes 0.3 s
    for 10 MB of floats.
    """
    path.mkdir()
    for record in records:
        with zipfile.ZipFile(path / f"{record.key}.npz", "x") as archive:
            members = [("meta.json", meta_bytes(record), True)]
            members += [(f"{name}.npy", npy_bytes(array), array.dtype.kind != "f") for name, array in record.items()]
            for name, content, shrinks in members:
                entry = zipfile.ZipInfo(name)  # its fixed date keeps the time of writing out of the file
                entry.compress_type = zipfile.ZIP_DEFLATED if shrinks and not raw else zipfile.ZIP_STORED
                archive.writestr(entry, content, compresslevel=1)


class NpzReader(MemberReader):
    """Records of a folder of NPZ files."""

    kind = "NPZ"

    def __init__(self, path: Path) -> None:
        with translate_errors(path, "folder"), os.scandir(path) as entries:
            names = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
        super().__init__(path, sorted(name.removesuffix(".npz") for name in names if name.endswith(".npz")))

    def _place(self, index: int) -> Path:
        return self.path / f"{self.keys[index]}.npz"

    @contextmanager
    def _members(self, index: int) -> Iterator[Members]:
        with open_regular(self._place(index)) as file, open_archive(file) as archive:
            yield archive.namelist(), partial(member_bytes, archive)
