"""A folder per sample with a file per array: for people, and for tools that read nothing else.

Read back with OpenCV, Pillow, `numpy` and `zstandard`.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Collection, Iterable
from pathlib import Path

from clsco.data.containers.base import (
    LARGEST_META,
    ShardReader,
    decoded,
    described,
    members,
    meta_bytes,
    npy_array,
    npy_bytes,
    npy_size,
    parsed_meta,
    split_name,
    stored_size,
    whole,
)
from clsco.data.record import Record, is_wanted
from clsco.files.archives import member_bytes, open_archive
from clsco.resources import open_regular, read_regular


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


def write_npz(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new folder, KEY.npz each.

    Without `raw`, masks, codes and numbers of objects are compressed, floats never: deflate takes 0.3 s for 10 MB of
    them.
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


class NpzReader(ShardReader):
    """Records of a folder of NPZ files."""

    def __init__(self, path: Path) -> None:
        with whole(path, "folder"), os.scandir(path) as entries:
            found = (entry.name for entry in entries if entry.is_file(follow_symlinks=False))
            keys = sorted(name.removesuffix(".npz") for name in found if name.endswith(".npz"))
        super().__init__(path, keys)

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read the members that are wanted."""
        path = self.path / f"{self.keys[index]}.npz"
        with whole(path, "NPZ"), open_regular(path) as file, open_archive(file) as archive:
            meta = parsed_meta(path, member_bytes(archive, "meta.json", LARGEST_META))
            arrays = {}
            for member in archive.namelist():
                name = member.removesuffix(".npy")
                if name != member and is_wanted(name, wanted):
                    about = described(path, meta, name)
                    dtype, shape = about["dtype"], about["shape"]
                    arrays[name] = npy_array(member_bytes(archive, member, npy_size(dtype, shape)), dtype, shape)
        return Record(self.keys[index], arrays, meta)
