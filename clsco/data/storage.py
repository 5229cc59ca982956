"""Storage of a data set: a local folder, or an object store that fsspec opens. Writes are atomic."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

from clsco.errors import ClscoError, FileError, import_extra
from clsco.files.atomic import raise_file_error
from clsco.resources import open_regular, read_regular, remove_left, work_name
from clsco.scene.text import brief

MOST_BYTES = 2**30  # largest size of a card or a part of a manifest
LONGEST = 200  # characters of a key
_MISSING = (FileNotFoundError, NotADirectoryError, IsADirectoryError)
Call = TypeVar("Call", bound=Callable[..., Any])


def remove_path(path: Path) -> None:
    """Remove a file, a link or a folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def checked_key(key: str) -> str:
    """Return a key that is inside its storage. Raises FileError for other keys, which untrusted files may contain."""
    parts = key.split("/")
    if len(key) > LONGEST or not key.isprintable() or "\\" in key or any(part in ("", ".", "..") for part in parts):
        raise FileError(f"{brief(key)!a}: a file of a data set must lie in its folder; got another place")
    return key


def _failing(function: Call) -> Call:
    """Decorate a method of a storage: its errors become a FileError with one line that names the storage."""

    @wraps(function)
    def call(self: Any, *args: Any) -> Any:
        try:
            return function(self, *args)
        except ClscoError:
            raise
        except OSError as error:
            place = Path(self.where) / str(args[0]) if args else Path(self.where)
            raise_file_error(place, "the data set must be writable and readable", error, error)
        except Exception as error:
            if self.is_local:
                raise
            got = " ".join(str(error).split()) or type(error).__name__  # clients of stores have errors of their own
            raise FileError(f"{self.where}: the store must answer; got {got}") from OSError(got)

    return call  # type: ignore[return-value]


def _sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk. On Windows, folders cannot be flushed and are skipped."""
    if os.name != "posix" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class _Storage(ABC):
    """Files and folders by key, which is a relative path with "/". All methods raise FileError on failure.

    Each process has a scratch folder for unfinished files. It is in `base`, and its name begins with `prefix`.
    """

    where: str
    base: Path
    prefix: str
    mode: int

    @_failing
    def scratch(self) -> Path:
        """The scratch folder of this process, which is made if it does not exist."""
        path = self.base / work_name(self.prefix)
        path.mkdir(self.mode, parents=True, exist_ok=True)
        return path

    @_failing
    def tidy(self) -> None:
        """Remove temporary files of processes that have ended."""
        remove_left(self.base, self.prefix)

    def close(self) -> None:
        """Remove the temporary files of this process."""
        shutil.rmtree(self.base / work_name(self.prefix), ignore_errors=True)

    @_failing
    def digest(self, key: str) -> str | None:
        """SHA-256 of the content of a key, or None if it does not exist."""
        with suppress(*_MISSING), self._open(key) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
        return None

    @abstractmethod
    def _open(self, key: str) -> Any:
        """The content of a key, as a file open for reading."""


class _Folder(_Storage):
    """A folder; a file is written in a hidden temporary folder, and renamed when it is complete on the disk."""

    is_local = True
    prefix, mode = ".work", 0o777

    def __init__(self, root: Path) -> None:
        self.root = self.base = root.absolute()
        self.where = str(self.root)

    def _path(self, key: str) -> Path:
        """Path of a key. Raises FileError if a link leads out of the set, which is possible in an untrusted set."""
        path = self.root / checked_key(key)
        if not path.parent.resolve().is_relative_to(self.root.resolve()):
            raise_file_error(path, "must lie in the folder of the data set", "a link that leaves it")
        return path

    def _open(self, key: str) -> Any:
        return open_regular(self._path(key))

    @_failing
    def put(self, key: str, path: Path) -> None:
        """Move a file, or a folder of files, from the scratch folder to a key."""
        target = self._path(key)
        for each in path.rglob("*") if path.is_dir() else (path,):
            _sync(each)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        path.replace(target)
        _sync(target.parent)

    @_failing
    def write(self, key: str, data: bytes) -> None:
        path = self.scratch() / f"{secrets.token_hex(4)}.tmp"
        path.write_bytes(data)
        self.put(key, path)

    @_failing
    def read(self, key: str) -> bytes | None:
        """Content of a key, or None if it does not exist."""
        with suppress(*_MISSING):
            return read_regular(self._path(key), MOST_BYTES)
        return None

    def local(self, key: str) -> Path:
        """Path of a local file or folder with the content of a key."""
        path = self._path(key)
        if not path.resolve().is_relative_to(self.root.resolve()):
            raise_file_error(path, "must lie in the folder of the data set", "a link that leaves it")
        return path

    @_failing
    def sizes(self, prefix: str) -> dict[str, int]:
        """Sizes in bytes of all files in the folder `prefix`, by key."""
        folder, sizes = self.root / checked_key(prefix), dict[str, int]()
        for inside, _, names in os.walk(folder):
            for name in names:
                path = Path(inside) / name
                with suppress(FileNotFoundError):  # another process may replace the file
                    sizes[path.relative_to(self.root).as_posix()] = path.lstat().st_size
        return sizes

    @_failing
    def has_others(self) -> bool:
        """True if the storage holds anything that is not hidden."""
        return self.root.is_dir() and any(not path.name.startswith(".") for path in self.root.iterdir())

    @_failing
    def remove(self, key: str) -> None:
        remove_path(self._path(key))


class _Remote(_Storage):
    """An object store, or another file system of fsspec. A file is made locally and sent by one request."""

    is_local = False
    prefix, mode = "clsco-batch", 0o700

    def __init__(self, url: str) -> None:
        self.base = Path(tempfile.gettempdir())
        core = import_extra(url, "fsspec.core", "distributed")
        self.where = url
        try:
            self.system, self.root = core.url_to_fs(url, use_listings_cache=False)
        except (ImportError, ValueError, OSError) as error:
            raise FileError(f"{url}: must be an address that fsspec opens; got {error}") from error

    def _path(self, key: str) -> str:
        return f"{self.root.rstrip('/')}/{checked_key(key)}"

    def _open(self, key: str) -> Any:
        return self.system.open(self._path(key), "rb")

    @_failing
    def put(self, key: str, path: Path) -> None:
        if path.is_dir():
            for each in sorted(each for each in path.rglob("*") if each.is_file()):
                self.system.put_file(str(each), self._path(f"{key}/{each.relative_to(path).as_posix()}"))
            shutil.rmtree(path)
        else:
            self.system.put_file(str(path), self._path(key))
            path.unlink()

    @_failing
    def write(self, key: str, data: bytes) -> None:
        self.system.pipe_file(self._path(key), data)

    @_failing
    def read(self, key: str) -> bytes | None:
        with suppress(FileNotFoundError):
            return self.system.cat_file(self._path(key))
        return None

    @_failing
    def local(self, key: str) -> Path:
        address = hashlib.sha256(self.where.encode()).hexdigest()[:16]
        target = self.scratch() / "read" / address / checked_key(key)
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            self.system.get(self._path(key), str(target), recursive=self.system.isdir(self._path(key)))
        return target

    @_failing
    def sizes(self, prefix: str) -> dict[str, int]:
        self.system.invalidate_cache()
        files = self.system.find(self._path(prefix), detail=True)
        start = len(self.root.rstrip("/")) + 1
        return {name[start:]: int(about["size"]) for name, about in files.items() if about.get("type") != "directory"}

    @_failing
    def has_others(self) -> bool:
        return bool(self.system.find(self.root, maxdepth=2))

    @_failing
    def remove(self, key: str) -> None:
        with suppress(FileNotFoundError):
            self.system.rm(self._path(key), recursive=True)


Storage = _Folder | _Remote


def open_storage(where: str | os.PathLike[str]) -> Storage:
    """The storage in a folder, or at an address such as s3://bucket/set. Raises FileError for an invalid address."""
    text = os.fspath(where).removeprefix("file://")
    return _Remote(text) if "://" in text else _Folder(Path(text))
