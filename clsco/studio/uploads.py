"""Images that come from the browser into the studio's folder."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

from clsco.errors import ImageError
from clsco.files.atomic import writable_folder, write_whole
from clsco.files.images import read_image
from clsco.resources import read_regular
from clsco.studio.folder import below

UPLOADS = "uploads"  # folder below the root
KINDS = ("png", "jpg", "jpeg", "tif", "tiff", "exr", "pfm", "npy")


def keep_image(root: Path, content: bytes, kind: str) -> str:
    """Write an image that came from the browser below the root, decoded once, under a name made of its content.

    Returns: its path relative to the root. Raises ImageError for everything that `clsco.files.images.read_image`
    refuses, and where it cannot be written; SceneError: a link would have it written outside of the root.
    """
    if kind not in KINDS:
        raise ImageError(f"image: must be one of {', '.join(KINDS)}; got {kind[:20]!r}")
    name = f"{UPLOADS}/{hashlib.sha256(content).hexdigest()[:20]}.{kind}"
    if not holds(path := below(root, name), content):
        with tempfile.TemporaryDirectory(prefix="clsco-") as scratch:
            trial = Path(scratch) / path.name
            trial.write_bytes(content)
            try:
                read_image(trial)
            except ImageError as error:
                raise ImageError(str(error).replace(str(trial), "image")) from None
        write_whole(writable_folder(path.parent) / path.name, content)
    return name


def holds(path: Path, content: bytes) -> bool:
    """Test whether a regular file has this content."""
    try:
        return read_regular(path, len(content)) == content
    except OSError:
        return False
