"""Atomic writing of files, and one-line errors on why a file could not be written."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NoReturn

from clsco.errors import FileError, MissingDependencyError
from clsco.resources import open_regular, work_name

AnyPath = str | os.PathLike[str]


def raise_file_error(path: Path | str, rule: str, got: object, cause: Exception | None = None) -> NoReturn:
    """Raise FileError with the line `path: rule; got value`. If `got` is an OSError, only its reason is shown."""
    where = str(path)
    if isinstance(got, OSError):
        got = got.strerror or got
    value = " ".join(str(got).split()) or type(got).__name__
    raise FileError(f"{where if where.isprintable() else ascii(where)}: {rule}; got {value}") from cause


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that is renamed to `path` once it is complete on disk; until then, an older file remains.
    Raises FileError if the folder, the disk or a codec fails, and leaves no file.
    """
    temporary = _temporary(path)
    try:
        with open(temporary, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except (OSError, ValueError, RuntimeError) as error:  # the last two come from paths, JSON and OpenEXR
        raise_file_error(path, "the file must be writable", error, error)
    finally:
        with contextlib.suppress(OSError, ValueError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Give an OSError the name of the file that the block writes, which errors of write and flush lack."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or os.fspath(path)
        raise


def atomic_write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically. Raises FileError as `atomic_write`."""
    with atomic_write(path) as file:
        file.write(content)


@contextlib.contextmanager
def atomic_folder(folder: Path, name: str) -> Iterator[Path]:
    """Create a hidden folder. Its files move to `folder` at the end of the block, or are removed after an error.

    name: name of the files in messages.
    """
    temporary = _temporary(folder / name)
    try:
        temporary.mkdir()
        yield temporary
        for path in sorted(temporary.iterdir()):
            path.replace(folder / path.name)
    except (FileError, MissingDependencyError) as error:
        raise type(error)(str(error).replace(str(temporary), str(folder))) from error
    except (OSError, ValueError) as error:
        raise_file_error(folder / name, "the files must be writable", error, error)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_file(path: Path) -> None:
    """Remove a file if it exists. Raises FileError if it cannot be removed."""
    try:
        path.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        raise_file_error(path, "the file must be replaceable", error, error)


def make_writable_folder(path: AnyPath) -> Path:
    """Make a folder and its parents, and check that files can be created in it. Raises FileError if they cannot."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = _temporary(path / "probe")
        probe.touch(exist_ok=False)
        probe.unlink()
    except (OSError, ValueError) as error:
        raise_file_error(path, "must be a folder that can be written", error, error)
    return path


def is_same_place(path: AnyPath, other: AnyPath) -> bool:
    """True if two paths, existing or not, are equal after symbolic links are resolved; cycles of links are kept."""
    return os.path.realpath(path) == os.path.realpath(other)


def sha256(path: Path) -> str:
    """SHA-256 of a file's content in hexadecimal. Raises OSError if it cannot be read."""
    with open_regular(path, follow=True) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_digests(key: str, path: Path) -> dict[str, tuple[int, str]]:
    """Size in bytes and SHA-256, by key, of a file (`key`) or of each file in a folder (`key`/NAME). Raises OSError."""
    inside = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    keys = (key if each == path else f"{key}/{each.relative_to(path).as_posix()}" for each in inside)
    return {name: (each.stat().st_size, sha256(each)) for name, each in zip(keys, inside, strict=True)}


def _temporary(path: Path) -> Path:
    """A hidden, unique path in the same folder, because a file can be renamed atomically only within its folder."""
    return path.parent / work_name(f".{path.name}", secrets.token_hex(4))
