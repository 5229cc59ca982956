"""Session of a tab: a scene with its file, its link, and values that survive a reload."""

from __future__ import annotations

import hashlib
import os
import secrets
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from clsco.errors import FileError, SceneError
from clsco.files.atomic import atomic_write_bytes, make_writable_folder
from clsco.resources import ExposedFolderError, private_folder, read_regular, temporary_folder
from clsco.scene.faults import items
from clsco.scene.file import read_mapping, relocated
from clsco.scene.quantities import Location
from clsco.scene.texture_keys import is_drawn
from clsco.studio import store
from clsco.studio.editing import Editor, State
from clsco.studio.folder import below, holds, keep_image
from clsco.studio.store import ConflictError, Linked, moved
from clsco.studio.tables import Table

__all__ = ["ConflictError", "Document"]
IMAGES = "images"  # folder below the root for copies of images of examples


class Document(Editor):
    """A scene that is edited key by key, opened and saved, and shared as a link."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self._digests: dict[Path, str] = {}
        self._saved: tuple[Path | None, Table] = (None, self.table)
        self._kept = self._opened = 0
        self.ends = {"nearest": "200", "farthest": "400"}  # of a focal stack of the visible objects, mm

    @property
    def file(self) -> str:
        """Name of the scene's file, relative to the root; "" without a file."""
        return self.path.relative_to(self.root).as_posix() if self.path is not None else ""

    @property
    def is_saved(self) -> bool:
        """True if the scene equals its file, or is new and unchanged."""
        return self._saved == (self.path, self.table)

    def note_ends(self, ends: dict[str, str]) -> None:
        """Update `ends`."""
        self.ends.update(ends)
        self._tell()

    def open(self, path: Path) -> None:
        """Go to the scene of a file below the root, as an undo step. It may only name examples and files below there.

        Raises SceneError as `clsco.load_sweep`, and changes nothing then.
        """
        target = self.inside(path)
        digest = store.digest_of(target)  # before the file is read: if it changes in between, `save` reports a conflict
        table = read_mapping(str(target), ())
        self.take(self._state_of(table, target))
        self._digests[target] = digest
        self._saved = target, self.table

    def save(self, path: Path | None = None, overwrite: bool = False) -> None:
        """Write the scene to a .toml or .json file below the root, by default its own; comments in the file are kept.

        Raises ConflictError if the file has other content than this session opened or saved, unless `overwrite`;
        SceneError for a missing or wrong name; FileError.
        """
        target, text, table = self._written(path)
        if not overwrite and store.digest_of(target) != self._digests.get(target, ""):
            rule = "is on the disk with other content" if target in self._digests else "is there already"
            raise ConflictError(f"{target.name}: {rule}: overwrite it, or save under another name")
        atomic_write_bytes(target, text.encode())
        self._digests[target] = store.digest_of(target)
        self.state = replace(self.state, table=table, path=target)
        self._saved = target, table
        self._tell()

    def difference(self, path: Path | None = None) -> str:
        """Changes that `save` would make in a file, as a unified diff. Raises SceneError."""
        target, text, _ = self._written(path)
        return store.difference(target, text)

    def share(self) -> str:
        """URL fragment that contains the scene: "#s=..."."""
        return store.link_of(self.table, self.folder, self.root)

    def load_share(self, linked: Linked) -> None:
        """Go to the scene of a link, as an undo step; its missing images become invalid values in `refused`.

        Raises SceneError, and changes nothing then.
        """
        table, missing = linked
        self.take(self._state_of(table, None), missing)

    def remembered(self) -> dict[str, Any]:
        """Data for `resume`: a link of the scene, the file's name below the root, its digest, and invalid values."""
        path = self.path
        return {
            "scene": self.share(),
            "file": self.file,
            "digest": self._digests.get(path, "") if path is not None else "",
            "typed": self.refused,
        }

    def resume(self, linked: Linked, file: str, digest: str) -> None:
        """Go to a scene that `remembered` described, as an undo step. Raises SceneError as `load_share` does."""
        table, missing = linked
        target = self.inside(Path(file)) if file else None
        start = target.parent if target is not None else self.root
        self.take(self._state_of(moved(table, self.root, start), target), missing)
        if target is not None:
            self._digests[target] = digest

    def load_table(self, table: Table, start: Path) -> None:
        """Go to a scene whose file names are relative to the folder `start`, as an undo step. Raises SceneError."""
        if start.is_relative_to(self.root):
            table = moved(table, start, self.root)
        else:
            table = relocated(table, lambda _, name: str(start / name))
        self.take(self._state_of(table, None))

    def keep(self, path: Path) -> None:
        """Save the scene for `recover`, if it has changed since the last call. Raises FileError."""
        if self._kept != self.revision:
            store.keep(self.table, self.folder, path)
            self._kept = self.revision

    def recover(self, path: Path) -> None:
        """Go to a scene saved by `keep`, as an undo step. Raises SceneError."""
        self.load_table(*store.read_kept(path))

    def inside(self, path: Path) -> Path:
        """The path, resolved against the root, with links followed; raises SceneError if it is not below the root."""
        return below(self.root, path)

    def source(self, name: str) -> str:
        """A texture as `clsco.inputs` takes it: the name of a pattern, a color, or an absolute path."""
        return name if is_drawn(name) else str(self.folder / name)

    def _state_of(self, table: Table, path: Path | None) -> State:
        self._opened += 1
        return State(table, ({},) * len(items(table)), path, opened=self._opened)

    def _written(self, path: Path | None) -> tuple[Path, str, Table]:
        """The file to save a scene to, its text, and the table with file names relative to its folder."""
        if path is None and self.path is None:
            raise SceneError("file: must have a name to be saved")
        target = self.inside(path or self.path or Path())
        if target.suffix.lower() not in (".toml", ".json"):
            raise SceneError(f"{target.name}: a scene file must end in .toml or .json")
        table = moved(relocated(self.table, self._copied), self.folder, target.parent)
        return target, store.scene_text(table, target, self.path), table

    def _copied(self, _: Location, name: str) -> str:
        """Name of a file that a saved scene refers to: an example's image is copied below the root."""
        path = Path(name)
        if not path.is_absolute() or path.is_relative_to(self.root):
            return name
        content, copy = path.read_bytes(), f"{IMAGES}/{path.name}"
        target = below(self.root, copy)
        if not target.exists():
            atomic_write_bytes(make_writable_folder(target.parent) / target.name, content)
        elif not holds(target, content):  # another image has this name
            copy = keep_image(self.root, content, path.suffix[1:])
        return os.path.relpath(self.root / copy, self.folder)


KEY, KEY_BYTES = "key", 32


class StateFolder:
    """Folder with data for the next studio with the same root: unsaved scenes, pictures and a secret.

    `path` is `clsco/studio/DIGEST` in XDG_STATE_HOME; if no private folder is possible, a temporary one, which is
    removed when the studio ends.
    """

    def __init__(self, root: Path) -> None:
        digest = hashlib.sha256(os.fsencode(os.path.realpath(root))).hexdigest()[:32]
        try:
            self.path = private_folder("clsco", "studio", digest, kind="state")
        except (ExposedFolderError, OSError, RuntimeError):
            self.path = temporary_folder("studio")

    def read(self, name: str, most: int) -> bytes:
        """Content of a file. Raises OSError if it is missing, not regular, or larger than `most` bytes."""
        return read_regular(self.path / name, most)

    def write(self, name: str, content: bytes) -> None:
        """Write a file atomically. Raises FileError if that fails."""
        atomic_write_bytes(self.path / name, content)  # in a folder that nobody else can write to

    def key(self) -> bytes:
        """A secret of KEY_BYTES random bytes, saved if possible, so that the next studio uses the same secret."""
        with suppress(OSError):
            if len(known := self.read(KEY, KEY_BYTES)) == KEY_BYTES:
                return known
        made = secrets.token_bytes(KEY_BYTES)
        with suppress(FileError):
            self.write(KEY, made)
        return made

    def remove(self, *names: str) -> None:
        """Remove files, if they exist."""
        for name in names:
            with suppress(OSError):
                (self.path / name).unlink()
