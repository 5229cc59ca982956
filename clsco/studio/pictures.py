"""Pictures on their way to the browser: the view of a frame, and its bytes behind a header."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.files.png import png_parts
from clsco.files.transfer import encode
from clsco.frame.frame import GREEN, Frame
from clsco.scene.model import Scene

VIEWS = {
    "color": "color",
    "sharp": "sharp",
    "depth": "depth",
    "blur radius": "blur_radius",
    "flow": "flow",
    "normal": "normal",
    "id": "object_id",
    "mask": "mask",
    "missing": "missing",
    "raw": "raw",
    "noise": "noise_sigma",
}
"""Attributes of a frame, by what the studio calls them, in the order of the tabs."""

UNBLURRED = ("depth", "normal", "id")  # views that are the same without blur, which takes the time
DRAGGING, LOSSY, EXACT, PINNED, STACKED, REFERENCE = range(6)
MESSAGE, JPEG, PNG, FLOAT16, FLOAT32 = range(5)
HEADER = struct.Struct("<IBBHHBHHBI")
FIELDS = ("revision", "rung", "view", "width", "height", "encoding", "columns", "rows", "flags", "number")
"""Names of the header's numbers: sizes of the picture, and of the frame. static/protocol.js is made of all these."""

NO_NUMBER = 2**32 - 1
IMAGES = ("color", "sharp")  # views; all others are floats
QUALITY = {DRAGGING: 80, LOSSY: 95}


@dataclass(frozen=True)
class ViewPicture:
    """Picture of a frame, as it is sent to the page.

    Attributes
    ----------
    rung : int
        DRAGGING, LOSSY or EXACT; to compare with these PINNED, an exact picture of another scene, and REFERENCE, one by
        `clsco.reference`; STACKED: one of a focal stack.
    view : str
        One of VIEWS.
    size, full : (int, int)
        Columns and rows of the picture, and of the frame.
    encoding : int
        JPEG or PNG, or FLOAT16 or FLOAT32: little endian, channels last.
    payload : bytes
    seconds : float
        Time that it took to render.
    about : dict, optional
        Further figures of an exact frame, as JSON can hold them.
    is_plain : bool
        Without occlusion.
    eye : str
        "left" or "right" of a stereo pair, else "".
    """

    rung: int
    view: str
    size: tuple[int, int]
    full: tuple[int, int]
    encoding: int
    payload: bytes
    seconds: float
    about: dict[str, Any] | None = None
    is_plain: bool = False
    eye: str = ""

    def packed(self, revision: int, number: int) -> bytes:
        """The bytes for the browser; number: of the frame, or in a focal stack, NO_NUMBER for one without."""
        view = list(VIEWS).index(self.view)
        sizes, flags = (*self.size, self.encoding, *self.full), self.is_plain | (self.eye == "right") << 1
        return HEADER.pack(revision, self.rung, view, *sizes, flags, number) + self.payload


def packed_message(revision: int, content: dict[str, Any]) -> bytes:
    """A message in JSON, behind a header like that of a picture."""
    return HEADER.pack(revision, 0, 0, 0, 0, MESSAGE, 0, 0, 0, NO_NUMBER) + json.dumps(content).encode()


def truth_of(view: str) -> tuple[str, ...]:
    """Outputs that a view needs besides the color."""
    if view == "blur radius":
        return VIEWS[view], "mask"
    return () if view == "color" else (VIEWS[view],)


def picture_of(frame: Frame, scene: Scene, view: str, rung: int, full: tuple[int, int], seconds: float) -> ViewPicture:
    """Encode a view of a frame.

    Images are JPEG, but for EXACT the PNG that `clsco render` writes; all else is floats, for DRAGGING of 16 bits, but
    for codes. The blur radius, of several colors that of green, is NaN where nothing is, which is not in focus. Raises
    SceneError for a view that belongs to a sensor where there is none.
    """
    data: NDArray[Any] | None = getattr(frame, VIEWS[view])
    if data is None:
        raise SceneError(f"view: {view} belongs to scenes with a sensor, which has a panel; got none")
    if view == "blur radius" and data.ndim == 3:
        data = data[..., GREEN]
    if view == "blur radius" and frame.mask is not None:
        data = np.where(frame.mask, data, np.nan)
    if view in IMAGES:
        is_exact = rung >= EXACT
        bits = min(frame.metadata["bits"], 16) if is_exact else 8
        codes = encode(data, bits, scene.image.transfer)
        encoding, payload = (PNG, b"".join(png_parts(codes))) if is_exact else (JPEG, _jpeg(codes, QUALITY[rung]))
    else:
        dtype, encoding = ("<f2", FLOAT16) if rung == DRAGGING and view != "raw" else ("<f4", FLOAT32)
        with np.errstate(over="ignore"):  # infinite in 16 bits
            payload = np.ascontiguousarray(data, dtype).tobytes()
    rows, columns = data.shape[:2]
    return ViewPicture(rung, view, (columns, rows), full, encoding, payload, seconds, eye=frame.eye)


def _jpeg(codes: NDArray[Any], quality: int) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=quality, subsampling=0 if quality > 90 else 2)
    return file.getvalue()
