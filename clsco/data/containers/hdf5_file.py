"""Reader of HDF5 files by h5py, called in a process with limits (`run_decoder`) because no header bounds its memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, BinaryIO

import h5py
import numpy as np

from clsco.files.decoder_process import Output


def keys(file: BinaryIO) -> Output:
    with _opened(file) as opened:
        return {"keys": sorted(opened)}, []


def meta(file: BinaryIO, key: str) -> Output:
    """Bytes of the JSON text that describes a record."""
    with _opened(file) as opened:
        return {}, [np.frombuffer(bytes(_stored(_stored(opened, key), "meta")[()]), np.uint8)]


def arrays(file: BinaryIO, key: str, names: Sequence[str]) -> Output:
    """Arrays of a record, in the order of `names`."""
    with _opened(file) as opened:
        group = _stored(opened, key)
        return {}, [_stored(group, name)[()] for name in names]


def _opened(file: BinaryIO) -> Any:
    return h5py.File(file.name, "r", locking=False)  # some network file systems have no locks


def _stored(group: Any, name: str) -> Any:
    """Member of a group that is stored in the file itself, not behind a link or in another file."""
    member = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if member is None or (isinstance(member, h5py.Dataset) and (member.external or member.is_virtual)):
        raise ValueError(f"{name} that is not stored in the file itself")
    return member
