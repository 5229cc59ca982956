"""Arrays on disk that take long to compute: a file for each key, with a checksum; what is damaged is not there."""

from __future__ import annotations

import hashlib
import io
import os
import secrets
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.resources import ExposedFolderError, private_folder

SUFFIX = ".arrays"
MOST_BYTES = 2**29  # of a folder; then the files that were used longest ago go
LARGEST = 2**26  # bytes of a file
DIGEST = hashlib.sha256().digest_size


def user_cache(name: str) -> ArrayCache:
    """A cache in the user's cache folder; it keeps nothing where others could write to it, or it cannot be made."""
    try:
        return ArrayCache(private_folder("clsco", name))
    except (ExposedFolderError, OSError, RuntimeError):
        return ArrayCache(None)


class ArrayCache:
    """Named arrays by a key, in a folder. Several processes may use it at the same time.

    Parameters
    ----------
    folder : Path or None
        Of the cache alone; None for a cache that keeps nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def get(self, key: str) -> dict[str, NDArray[Any]] | None:
        """The arrays of a key; None where they are not there, or not as they were written."""
        if self.folder is None:
            return None
        path = self._path(key)
        try:
            content = path.read_bytes()
            if hashlib.sha256(content[DIGEST:]).digest() != content[:DIGEST]:
                return None
            os.utime(path)
            with np.load(io.BytesIO(content[DIGEST:]), allow_pickle=False) as found:
                return dict(found)
        except (OSError, ValueError):
            return None

    def put(self, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write arrays; a disk that is full, or a folder that cannot be written, is no error."""
        if self.folder is None or sum(array.nbytes for array in arrays.values()) > LARGEST:
            return
        buffer, path = io.BytesIO(), self._path(key)
        np.savez(buffer, **dict[str, Any](arrays))
        content = buffer.getvalue()
        temporary = path.with_suffix(f".{os.getpid()}-{secrets.token_hex(4)}.part")
        with suppress(OSError):
            try:
                temporary.write_bytes(hashlib.sha256(content).digest() + content)
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
            self._shrink()

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:40]}{SUFFIX}"

    def _shrink(self) -> None:
        assert self.folder is not None
        found = [(path.stat().st_mtime_ns, path.stat().st_size, path) for path in self.folder.glob(f"*{SUFFIX}")]
        total = sum(size for _, size, _ in found)
        for _, size, path in sorted(found):
            if total <= MOST_BYTES:
                return
            path.unlink(missing_ok=True)
            total -= size
