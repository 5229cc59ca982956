"""HDF5: a group per sample, in it a dataset per array, and `meta`, a string of JSON.

Read back with h5py.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers.base import LARGEST_META, ShardReader, described, meta_bytes, parsed_meta, whole
from clsco.data.containers.base import NEEDS as DEFLATE
from clsco.data.record import Record, is_wanted
from clsco.errors import import_extra
from clsco.files.atomic import raise_file_error
from clsco.resources import open_regular

NEEDS = ("h5py", "data")
_FILTERS = [2, 1]  # of HDF5: shuffle, deflate


def write(path: Path, records: Iterable[Record], raw: bool = False) -> None:
    """Write records to a new file.

    Parameters
    ----------
    path : Path
    records : iterable of Record
    raw : bool
        Nothing is compressed; else bytes are shuffled and deflated (gzip 4), which every build of HDF5 reads.
    """
    h5py = import_extra(path, *NEEDS)
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
        self._h5py = import_extra(path, *NEEDS)
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
            arrays, places = {}, set[int]()
            for name in meta["arrays"]:
                if is_wanted(name, wanted) and name in group:
                    found = self._inside(group, name, self._h5py.Dataset)
                    about = described(self.path, meta, name)
                    if (found.dtype.newbyteorder("="), found.shape) != (about["dtype"], about["shape"]):
                        raise ValueError(f"{name} of {found.dtype} {found.shape}")
                    place = self._h5py.h5o.get_info(found.id).addr
                    if place in places:  # one array under many names
                        raise ValueError(f"{name} that another array is as well")
                    places.add(place)
                    arrays[name] = self._array(found)
        return Record(self.keys[index], arrays, meta)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _array(self, found: Any) -> NDArray[Any]:
        """The numbers of a dataset. Its chunk is inflated here: HDF5 would go on beyond what the chunk may hold."""
        properties = found.id.get_create_plist()
        filters = [properties.get_filter(k)[0] for k in range(properties.get_nfilters())]
        if found.chunks is None and not filters:
            return np.asarray(found[()])
        size = found.dtype.itemsize * prod(found.shape)
        if found.chunks != found.shape or filters not in (_FILTERS, []) or found.id.get_num_chunks() != 1:
            raise ValueError(f"{found.name} that is not one chunk, shuffled and deflated")
        if (stored := found.id.get_chunk_info(0).size) > size + size // 8 + 2**10:
            raise ValueError(f"{stored} bytes in the chunk of {found.name}")
        passed_over, content = found.id.read_direct_chunk((0,) * len(found.shape))
        if filters and not passed_over & 2:
            content = import_extra(self.path, *DEFLATE).deflate_decode(content, out=np.empty(size, np.uint8).data)
        if len(content) != size:
            raise ValueError(f"{len(content)} bytes of {size} in {found.name}")
        plain = np.frombuffer(content, np.uint8)
        if filters and not passed_over & 1:
            planes = plain.reshape(found.dtype.itemsize, -1)
            plain = np.empty(planes.shape[::-1], np.uint8)
            for k, plane in enumerate(planes):
                plain[:, k] = plane
        return np.array(plain.reshape(-1).view(found.dtype).reshape(found.shape))

    def _opened(self, path: Path) -> Any:
        open_regular(path).close()
        return self._h5py.File(path, "r", locking=False)  # which some network file systems do not have

    def _inside(self, group: Any, name: str, kind: type[Any]) -> Any:
        """Member of a group that is stored in the file itself, not behind a link or in an external file."""
        link = group.get(name, getlink=True)
        found = group[name] if isinstance(link, self._h5py.HardLink) else None
        apart = isinstance(found, self._h5py.Dataset) and (found.external or found.is_virtual)
        if not isinstance(found, kind) or apart:
            raise_file_error(
                self.path, f"{name} must be a {kind.__name__.lower()} in the file itself", "something else"
            )
        return found
