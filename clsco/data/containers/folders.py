"""A folder per sample with a file per array: for people, and for tools that read nothing else.

Read back with OpenCV, Pillow, `numpy` and `zstandard`.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from pathlib import Path

from clsco.data.containers.base import ShardReader, whole
from clsco.data.encoding import LARGEST_META, decoded, described, members, parsed_meta, split_name, stored_size
from clsco.data.record import Record, is_wanted
from clsco.resources import read_regular


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder, KEY/ARRAY.EXTENSION and KEY/meta.json; arguments as of a tar."""
    path.mkdir()
    for record in records:
        folder = path / record.key
        folder.mkdir()
        for name, content in members(path, record, raw):
            (folder / name).write_bytes(content)


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
            meta = parsed_meta(folder, read_regular(folder / "meta.json", LARGEST_META))
            names = [each.name for each in folder.iterdir()]
            found = {split[0]: name for name in names if (split := split_name(name)) is not None}
            arrays = {}
            for name in meta["arrays"]:  # whose order is that of the record
                if name in found and is_wanted(name, wanted):
                    extension = found[name].removeprefix(f"{name}.")
                    about = described(folder, meta, name)
                    content = read_regular(folder / found[name], stored_size(about))
                    arrays[name] = decoded(folder, extension, content, about)
        return Record(self.keys[index], arrays, meta)
