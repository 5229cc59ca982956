"""A folder per sample with a file per array: for viewing, and for tools that read only single files.

Read back with OpenCV, Pillow, `numpy` and `zstandard`.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from clsco.data.containers.base import MemberReader, Members, members, meta_bytes, npy_bytes, translate_errors
from clsco.data.record import Record
from clsco.files.archives import member_bytes, open_archive
from clsco.resources import open_regular, read_regular


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder as KEY/ARRAY.EXTENSION and KEY/meta.json; arguments as for a tar."""
    path.mkdir()
    for record in records:
        folder = path / record.key
        folder.mkdir()
        for name, content in members(path, record, raw):
            (folder / name).write_bytes(content)


class FolderReader(MemberReader):
    """Records of a folder of folders."""

    kind = "sample"

    def __init__(self, path: Path) -> None:
        with translate_errors(path, "folder"), os.scandir(path) as entries:
            keys = sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
        super().__init__(path, keys)

    def _place(self, index: int) -> Path:
        return self.path / self.keys[index]

    @contextmanager
    def _members(self, index: int) -> Iterator[Members]:
        folder = self._place(index)
        yield [each.name for each in folder.iterdir()], lambda name, most: read_regular(folder / name, most)


def write_npz(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder as KEY.npz.

    Without `raw`, masks, codes and object numbers are compressed, floats never: deflate takes 0.3 s for 10 MB of them.
    """
    path.mkdir()
    for record in records:
        with zipfile.ZipFile(path / f"{record.key}.npz", "x") as archive:
            content = {"meta.json": (meta_bytes(record), not raw)}
            for name, array in record.arrays.items():
                content[f"{name}.npy"] = (npy_bytes(array), not raw and array.dtype.kind != "f")
            for name, (part, compressed) in content.items():
                entry = zipfile.ZipInfo(name)  # its fixed date keeps the time of writing out of the file
                entry.compress_type = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
                archive.writestr(entry, part, compresslevel=1)


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
