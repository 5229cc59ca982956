"""State of a studio for the next one: not in the folder that it works in, which may come from a stranger, but in a
private one of the user."""

from __future__ import annotations

import fcntl
import hashlib
import os
import secrets
import tempfile
from contextlib import suppress
from pathlib import Path

from clsco.errors import ClscoError, ImageError
from clsco.files.atomic import write_whole
from clsco.resources import ExposedFolderError, open_regular, private_folder, read_regular

LOCK, KEY = "lock", "key"
KEY_BYTES = 32
_LOCKED = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK


class StateFolder:
    """A private folder for one folder of a studio, by the real path of that; one studio has it at a time.

    Parameters
    ----------
    root : Path
        Folder of the studio.

    Attributes
    ----------
    path : Path
        `clsco/studio/DIGEST` in XDG_STATE_HOME; where no folder is the user's alone, a temporary one, which is lost.
    is_lost : bool
        It is that.

    Raises
    ------
    ClscoError
        Another studio has the folder.
    """

    def __init__(self, root: Path) -> None:
        real = os.path.realpath(root)
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        digest = hashlib.sha256(os.fsencode(real)).hexdigest()[:32]
        try:
            self._take(private_folder("clsco", "studio", digest, kind="state"), real)
        except (ExposedFolderError, OSError, RuntimeError):
            self._temporary = tempfile.TemporaryDirectory(prefix="clsco-studio-", ignore_cleanup_errors=True)
            self._take(Path(self._temporary.name), real)

    def _take(self, path: Path, real: str) -> None:
        """Open a folder and lock it. Raises OSError where that cannot be, ClscoError where another studio has it."""
        self.path = path
        self._handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        self._lock = -1
        try:
            self._lock = os.open(LOCK, _LOCKED, 0o600, dir_fd=self._handle)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._release()
            if isinstance(error, BlockingIOError):
                raise ClscoError(f"{real}: another studio is at work in this folder") from None
            raise

    @property
    def is_lost(self) -> bool:
        return self._temporary is not None

    def read(self, name: str, most: int) -> bytes:
        """Content of a file. Raises OSError where it is not there, no regular one, or larger than `most` bytes."""
        return read_regular(name, most, folder=self._handle)

    def tail(self, name: str, most: int) -> bytes:
        """The end of a file, at most so many bytes. Raises OSError where it is not there, or no regular one."""
        with open_regular(name, folder=self._handle) as file:
            file.seek(max(os.fstat(file.fileno()).st_size - most, 0))
            return file.read(most)

    def write(self, name: str, content: bytes) -> None:
        """Write a file that is whole or absent. Raises ImageError where that cannot be."""
        write_whole(self.path / name, content)  # in a folder that nobody else can look into

    def key(self) -> bytes:
        """A secret that the next studio in the folder has, too, if it can be kept."""
        with suppress(OSError):
            if len(known := self.read(KEY, KEY_BYTES)) == KEY_BYTES:
                return known
        made = secrets.token_bytes(KEY_BYTES)
        with suppress(ImageError):
            self.write(KEY, made)
        return made

    def remove(self, *names: str) -> None:
        """Remove files, where they are there."""
        for name in names:
            with suppress(OSError):
                os.unlink(name, dir_fd=self._handle)

    def close(self) -> None:
        """Let go of the folder."""
        self._release()
        if self._temporary is not None:
            self._temporary.cleanup()

    def _release(self) -> None:
        for handle in (self._lock, self._handle):
            if handle >= 0:
                os.close(handle)
        self._lock = self._handle = -1
