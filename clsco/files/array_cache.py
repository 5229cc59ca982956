"""Cache on disk of arrays that are slow to compute. Each key has a file with a checksum; damaged files are ignored."""

from __future__ import annotations

import hashlib
import json
import math
import mmap
import os
import secrets
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.resources import ExposedFolderError, open_regular, private_folder

SUFFIX = ".arrays"
MOST_BYTES = 2**29  # largest size of a folder; beyond it, the least recently used files are deleted
SCANS = 16  # number of scans of the folder while this process writes MOST_BYTES
LARGEST = 2**27  # largest size of the arrays of a key, bytes
DIGEST = hashlib.sha256().digest_size


def user_cache(name: str) -> ArrayCache:
    """A cache in the user's cache folder. It stores nothing if the folder cannot be made or is writable by others."""
    try:
        return ArrayCache(private_folder("clsco", name))
    except (ExposedFolderError, OSError, RuntimeError):
        return ArrayCache(None)


class ArrayCache:
    """Named arrays by key. folder: used by this cache alone, also in several processes; None to store nothing."""

    def __init__(self, folder: Path | None) -> None:
        self.folder, self._written = folder, MOST_BYTES

    def get(self, key: str) -> dict[str, NDArray[Any]] | None:
        """The arrays of a key, read-only; None if they are missing or damaged."""
        if self.folder is None:
            return None
        path = _path(self.folder, key)
        try:
            content = _read(path)
            if hashlib.sha256(memoryview(content)[DIGEST:]).digest() != content[:DIGEST]:
                return None
            os.utime(path)
            return _unpacked(content)
        except (OSError, ValueError, AttributeError):  # missing, damaged or of another version
            return None

    def put(self, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Store arrays, unless they are larger than LARGEST; a full disk or a read-only folder is not an error."""
        if self.folder is None or sum(array.nbytes for array in arrays.values()) > LARGEST:
            return
        content, path = _packed(arrays), _path(self.folder, key)
        temporary = path.with_suffix(f".{os.getpid()}-{secrets.token_hex(4)}.part")
        with suppress(OSError):
            try:
                temporary.write_bytes(hashlib.sha256(content).digest() + content)
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
            self._written += len(content)
            if self._written > MOST_BYTES // SCANS:
                self._written = 0
                _shrink(self.folder)


def _path(folder: Path, key: str) -> Path:
    return folder / f"{hashlib.sha256(key.encode()).hexdigest()[:40]}{SUFFIX}"


def _shrink(folder: Path) -> None:
    files = [(path.stat().st_mtime_ns, path.stat().st_size, path) for path in folder.glob(f"*{SUFFIX}")]
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= MOST_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size


def _packed(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Bytes of a file: a line with dtype and shape of each array, then the contents. It is read faster than an NPZ."""
    about = {name: (array.dtype.str, array.shape) for name, array in arrays.items()}
    return b"".join([json.dumps(about).encode(), b"\n", *(array.tobytes() for array in arrays.values())])


def _read(path: Path) -> mmap.mmap:
    """Read a file into memory pages of its own, so that arrays need no copy, and freeing them leaves no gaps."""
    with open_regular(path, 2 * LARGEST) as file:
        content = mmap.mmap(-1, os.fstat(file.fileno()).st_size)  # ValueError for an empty file
        if file.readinto(content) != len(content):
            raise ValueError(f"{path}: must have {len(content)} bytes; got fewer")
        return content


def _unpacked(content: mmap.mmap) -> dict[str, NDArray[Any]]:
    end = content.find(b"\n", DIGEST)
    arrays, at = dict[str, NDArray[Any]](), end + 1
    for name, (kind, shape) in json.loads(content[DIGEST:end]).items():
        count = math.prod(shape)
        array = np.frombuffer(content, kind, count, at) if count else np.empty(0, kind)
        array.flags.writeable = False
        arrays[name] = array.reshape(shape)
        at += array.nbytes
    return arrays
