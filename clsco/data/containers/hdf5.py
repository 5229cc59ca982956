"""HDF5: a group per sample, in it a dataset per array, and `meta`, a string of JSON.

Read back with h5py.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from clsco.data.containers.base import ShardReader, whole
from clsco.data.encoding import LARGEST_META, described, meta_bytes, parsed_meta
from clsco.data.record import Record, is_wanted
from clsco.files.atomic import refuse
from clsco.files.decoders import codec

NEEDS = ("h5py", "data")


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new file.

    Parameters
    ----------
    path : Path
    records : iterable of Record
    raw : bool
        Nothing is compressed; else bytes are shuffled and deflated (gzip 4), which every build of HDF5 reads.
    """
    h5py = codec(path, *NEEDS)
    options = {} if raw else {"shuffle": True, "compression": "gzip", "compression_opts": 4}
    with h5py.File(path, "x", track_order=False) as file:
        for record in records:
            group = file.create_group(record.key)
            text = meta_bytes(record)
            group.create_dataset("meta", data=text, dtype=h5py.string_dtype("utf-8", len(text)), track_times=False)
            for name, array in record.arrays.items():
                chunks = None if raw else array.shape
                made = group.create_dataset(name, data=array, chunks=chunks, track_times=False, **options)
                unit = record.meta["arrays"][name]["unit"]
                if unit:
                    made.attrs["unit"] = unit


class Hdf5Reader(ShardReader):
    """Records of an HDF5 file."""

    def __init__(self, path: Path) -> None:
        self._file: Any = None
        self._h5py = codec(path, *NEEDS)
        with whole(path, "HDF5 file"), self._opened(path) as file:
            keys = sorted(file)
        super().__init__(path, keys)

    def record(self, index: int, wanted: Collection[str] | None = None) -> Record:
        """Read the datasets that are wanted."""
        with whole(self.path, "HDF5 file"):
            if self._file is None:
                self._file = self._opened(self.path)
            group = self._inside(self._file, self.keys[index], self._h5py.Group)
            text = self._inside(group, "meta", self._h5py.Dataset)
            if text.shape != () or text.dtype.kind != "S" or text.dtype.itemsize > LARGEST_META:
                raise ValueError(f"meta of {text.dtype} {text.shape}")
            meta = parsed_meta(self.path, text[()])
            arrays = {}
            for name in meta["arrays"]:
                if is_wanted(name, wanted) and name in group:
                    found = self._inside(group, name, self._h5py.Dataset)
                    about = described(self.path, meta, name)
                    if (found.dtype.newbyteorder("="), found.shape) != (about["dtype"], about["shape"]):
                        raise ValueError(f"{name} of {found.dtype} {found.shape}")
                    arrays[name] = found[()]
        return Record(self.keys[index], arrays, meta)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _opened(self, path: Path) -> Any:
        return self._h5py.File(path, "r", locking=False)  # which some network file systems do not have

    def _inside(self, group: Any, name: str, kind: type[Any]) -> Any:
        """What a group has of this name: in the file itself, not where a link or an external file leads."""
        link = group.get(name, getlink=True)
        found = group[name] if isinstance(link, self._h5py.HardLink) else None
        apart = isinstance(found, self._h5py.Dataset) and (found.external or found.is_virtual)
        if not isinstance(found, kind) or apart:
            refuse(self.path, f"{name} must be a {kind.__name__.lower()} in the file itself", "something else")
        return found
