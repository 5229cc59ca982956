"""Access to the folder of a distribution file and the files in it that samples may use."""

from __future__ import annotations

import os
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path, PureWindowsPath
from typing import Any

from clsco.files.atomic import sha256
from clsco.scene.text import shown

MAX_NAME = 1024
MAX_FILES = 100_000
MAX_LOOKED_AT = 1_000_000  # entries of folders that patterns may visit
MAX_DEEP = 32  # nested folders
MAX_BYTES = 2**31  # size of a file
MAX_TOTAL = 2**37  # size of all files together


class RefusedError(Exception):
    """A value breaks a rule; got: text that replaces the checked value in the message, or None."""

    def __init__(self, rule: str, got: Any = None) -> None:
        self.rule, self.got = rule, got
        super().__init__(rule)

    def message(self, key: str, value: Any) -> str:
        """The message `key: rule; got value`."""
        return f"{key}: {self.rule}; got {shown(value) if self.got is None else self.got}"


class Folder:
    """The folder of a distribution file; no file outside of it is read, even through links."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.digests: dict[str, str] = {}
        """SHA-256 of each file that samples may need, by the file's name."""
        self._bytes = self._entries = 0

    def inside(self, name: Any) -> Path:
        """The path of a file in the folder, with links resolved. Raises RefusedError for files that may not be read."""
        if not isinstance(name, str) or not 0 < len(name) <= MAX_NAME or not name.isprintable():
            raise RefusedError(f"must be the name of a file, of at most {MAX_NAME} characters")
        windows = PureWindowsPath(name)
        if Path(name).is_absolute() or windows.drive or windows.root or ".." in windows.parts:
            raise RefusedError("must be a path inside the folder of the distribution file, without ..")
        try:
            path = (self.path / name).resolve(strict=True)
            if not path.is_relative_to(self.path):
                raise RefusedError("must not lead out of the folder of the distribution file by a link")
            if not path.is_file():
                raise RefusedError("must be a file")
        except (OSError, ValueError, RuntimeError):  # RuntimeError: a cycle of links, before Python 3.13
            raise RefusedError("must be an existing file") from None
        return path

    def take(self, name: Any) -> str:
        """Register a file that samples may need; returns its SHA-256. Raises RefusedError."""
        if name in self.digests:
            return self.digests[name]
        path = self.inside(name)
        try:
            size = path.stat().st_size
            self._bytes += size
            if size > MAX_BYTES or self._bytes > MAX_TOTAL:
                raise RefusedError(f"a file must have at most {MAX_BYTES} bytes, and all of them {MAX_TOTAL}", size)
            if len(self.digests) == MAX_FILES:
                raise RefusedError(f"must be at most {MAX_FILES} files in all", "more")
            self.digests[name] = sha256(path)
        except OSError as error:
            raise RefusedError("must be readable", error.strerror) from None
        return self.digests[name]

    def match(self, pattern: Any) -> list[str]:
        """Names of the files that match a pattern like "textures/**/*.png", sorted. Raises RefusedError."""
        if not isinstance(pattern, str) or not 0 < len(pattern) <= MAX_NAME or not pattern.isprintable():
            raise RefusedError('must be a pattern of files, like "textures/**/*.png"')
        windows = PureWindowsPath(pattern)
        parts = pattern.split("/")
        if windows.drive or windows.root or ".." in windows.parts or "" in parts:
            raise RefusedError("must be a pattern inside the folder of the distribution file, without ..")
        if parts.count("**") > 1 or len(parts) > MAX_DEEP:
            raise RefusedError(f"must have ** at most once, and at most {MAX_DEEP} parts")
        names = sorted(self._matches(self.path, parts, ""))
        if not names:
            raise RefusedError("must fit a file")
        return names

    def _matches(self, folder: Path, parts: list[str], before: str) -> Iterator[str]:
        """Names of files below `folder` that match the parts of a pattern; before: prefix of the returned names."""
        if before.count("/") > MAX_DEEP:
            raise RefusedError(f"must not go through more than {MAX_DEEP} folders in each other")
        try:
            with os.scandir(folder) as listed:
                entries = list(self._count(listed))
        except OSError as error:
            raise RefusedError("its folders must be readable", error.strerror) from None
        part, rest = (parts[1], parts[2:]) if parts[0] == "**" and len(parts) > 1 else (parts[0], parts[1:])
        for entry in entries:
            if entry.name.startswith(".") and not part.startswith("."):
                continue
            name = before + entry.name
            if parts[0] == "**" and entry.is_dir(follow_symlinks=False):
                yield from self._matches(folder / entry.name, parts, f"{name}/")
            if not fnmatchcase(entry.name, part):
                continue
            if rest and entry.is_dir(follow_symlinks=False):
                yield from self._matches(folder / entry.name, rest, f"{name}/")
            elif not rest and entry.is_file():
                yield name

    def _count(self, entries: Iterator[os.DirEntry[str]]) -> Iterator[os.DirEntry[str]]:
        for entry in entries:
            self._entries += 1
            if self._entries > MAX_LOOKED_AT:
                raise RefusedError(f"folders must have at most {MAX_LOOKED_AT} entries in all", "more")
            yield entry
