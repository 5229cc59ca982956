"""Files in a studio's folder: only scenes, images and depth maps, and only within the folder."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from clsco.errors import FileError, SceneError
from clsco.files.atomic import atomic_write_bytes, make_writable_folder
from clsco.files.images import read_image
from clsco.resources import read_regular
from clsco.scene.text import shown

SCENES = (".toml", ".json")
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".pfm", ".npy", ".npz")
MOST = 500  # names in a list
DEEPEST = 4  # nested folders


def below(root: Path, path: str | Path) -> Path:
    """The path, resolved against a folder, with links followed; raises SceneError if it is not below the folder."""
    try:
        target = (root / path).resolve()
    except (OSError, ValueError, RuntimeError):  # not a file name, or a link to itself
        target = root
    if not target.is_relative_to(root) or target == root:
        raise SceneError(f"file: must be below the folder of the studio; got {shown(str(path))}")
    return target


def listed(root: Path, endings: tuple[str, ...]) -> list[str]:
    """Names of at most 500 files with these endings below a folder, relative to it, sorted.

    Hidden files, rendered frames and folders beside them, folders deeper than 4, and links out of the folder are
    omitted.
    """
    return sorted(islice(_found(root.resolve(), endings), MOST))


def _found(root: Path, endings: tuple[str, ...]) -> Iterator[str]:
    for place, folders, names in os.walk(root):
        here = Path(place)
        depth = len(here.relative_to(root).parts)
        is_made = (here / "frame_0000.json").exists() or (here / "dataset.json").exists()  # frames, a data set
        folders[:] = [] if depth >= DEEPEST or is_made else sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = here / name
            if name.startswith((".", "frame_", "dataset.json")) or path.suffix.lower() not in endings:
                continue
            if path.is_symlink() and not path.resolve().is_relative_to(root):
                continue
            yield path.relative_to(root).as_posix()


UPLOADS = "uploads"  # folder below the root
KINDS = ("png", "jpg", "jpeg", "tif", "tiff", "exr", "pfm", "npy")


def keep_image(root: Path, content: bytes, kind: str) -> str:
    """Write an image received from the browser below the root, under a name derived from its content, and return it.

    Raises FileError if `kind` is not one of KINDS, `read_image` rejects the image, or it cannot be written; SceneError
    if a link leads out of the root.
    """
    if kind not in KINDS:
        raise FileError(f"image: must be one of {', '.join(KINDS)}; got {kind[:20]!r}")
    name = f"{UPLOADS}/{hashlib.sha256(content).hexdigest()[:20]}.{kind}"
    if not holds(path := below(root, name), content):
        with tempfile.TemporaryDirectory(prefix="clsco-") as scratch:
            trial = Path(scratch) / path.name
            trial.write_bytes(content)
            try:
                read_image(trial)
            except FileError as error:
                raise FileError(str(error).replace(str(trial), "image")) from None
        atomic_write_bytes(make_writable_folder(path.parent) / path.name, content)
    return name


def holds(path: Path, content: bytes) -> bool:
    """True if a regular file has this content."""
    try:
        return read_regular(path, len(content)) == content
    except OSError:
        return False
