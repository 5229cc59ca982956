"""A folder per sample with a file per array: for people, and for tools that read nothing else.

Read back with OpenCV, Pillow, `numpy` and `zstandard`.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Collection, Iterable
from pathlib import Path

from clsco.data.containers.base import ShardReader, whole
from clsco.data.encoding import LARGEST, decoded, described, members, parsed_meta, split_name
from clsco.data.record import Record, is_wanted
from clsco.files.atomic import refuse


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder, KEY/ARRAY.EXTENSION and KEY/meta.json; arguments as of a tar."""
    path.mkdir()
    for record in records:
        folder = path / record.key
        folder.mkdir()
        for name, content in members(path, record, raw):
            (folder / name).write_bytes(content)


def read_file(path: Path) -> bytes:
    """Content of a plain file that is no link. Raises ImageError for others, OSError where it cannot be read."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)  # to open a pipe would block for ever
    with open(handle, "rb", buffering=0) as file:
        about = os.fstat(handle)
        if not stat.S_ISREG(about.st_mode) or about.st_size > LARGEST:
            refuse(path, f"must be a plain file of at most {LARGEST} bytes", about.st_size)
        return file.read()


class FolderReader(ShardReader):
    """Records of a folder of folders."""

    def __init__(self, path: Path) -> None:
        with whole(path, "folder"), os.scandir(path) as entries:
            keys = sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
        super().__init__(path, keys)

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read the files that are wanted."""
        folder = self.path / self.keys[index]
        with whole(folder, "sample"):
            meta = parsed_meta(folder, read_file(folder / "meta.json"))
            names = [each.name for each in folder.iterdir()]
            found = {split[0]: name for name in names if (split := split_name(name)) is not None}
            arrays = {}
            for name in meta["arrays"]:  # whose order is that of the record
                if name in found and is_wanted(name, wanted):
                    extension = found[name].removeprefix(f"{name}.")
                    content = read_file(folder / found[name])
                    arrays[name] = decoded(folder, extension, content, described(folder, meta, name))
        return Record(self.keys[index], arrays, meta)
