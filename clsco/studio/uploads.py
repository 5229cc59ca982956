"""Images that come from the browser into the studio's folder."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

from clsco.errors import ImageError
from clsco.files.atomic import writable_folder, write_whole
from clsco.files.images import read_image

UPLOADS = "uploads"  # folder below the root
KINDS = ("png", "jpg", "jpeg", "tif", "tiff", "exr", "pfm", "npy")


def keep_image(root: Path, content: bytes, kind: str) -> str:
    """Write an image that came from the browser below the root, decoded once, under a name made of its content.

    Returns
    -------
    str
        Its path relative to the root.

    Raises
    ------
    ImageError
        For everything that `clsco.files.images.read_image` refuses, and where it cannot be written.
    """
    if kind not in KINDS:
        raise ImageError(f"image: must be one of {', '.join(KINDS)}; got {kind[:20]!r}")
    path = root / UPLOADS / f"{hashlib.sha256(content).hexdigest()[:20]}.{kind}"
    if not path.exists():
        with tempfile.TemporaryDirectory(prefix="clsco-") as scratch:
            trial = Path(scratch) / path.name
            trial.write_bytes(content)
            try:
                read_image(trial)
            except ImageError as error:
                raise ImageError(str(error).replace(str(trial), "image")) from None
        write_whole(writable_folder(path.parent) / path.name, content)
    return path.relative_to(root).as_posix()
