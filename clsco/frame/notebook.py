"""Display of frames, records and data sets in notebooks: one line of text, and a picture."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.png import png_parts
from clsco.files.transfer import encode

LARGEST_SHOWN = 1024  # px, longer side of a picture; a larger image is averaged over squares of pixels


def three_channels(image: NDArray[Any]) -> NDArray[Any]:
    """An image (rows, columns[, 3]) as (rows, columns, 3): gray fills all three channels."""
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def codes_to_show(image: NDArray[np.floating]) -> NDArray[np.uint8]:
    """8-bit sRGB codes (rows, columns, 3) of linear radiance (rows, columns[, 3])."""
    return encode(three_channels(image), 8, "srgb").astype(np.uint8, copy=False)


def png_to_show(image: NDArray[np.floating]) -> bytes:
    """A PNG of linear radiance (rows, columns[, 3]), reduced to the size at which notebooks show it."""
    step = -(-max(image.shape[:2]) // LARGEST_SHOWN)
    if step > 1:
        down, across = (min(step, n) for n in image.shape[:2])  # a strip may be thinner than a square
        rows, columns = image.shape[0] // down, image.shape[1] // across
        squares = image[: rows * down, : columns * across].reshape(rows, down, columns, across, *image.shape[2:])
        image = squares.mean(axis=(1, 3), dtype=np.float32)
    return b"".join(png_parts(codes_to_show(image)))


def html_to_show(line: str, images: Iterable[NDArray[np.floating]] = ()) -> str:
    """Self-contained HTML of a line of text, and of images of linear radiance below it."""
    import base64  # takes 1 ms, as does html, and few frames are shown
    import html

    pictures = (base64.b64encode(png_to_show(image)).decode() for image in images)
    shown = "".join(f'<img alt="" src="data:image/png;base64,{picture}">' for picture in pictures)
    return f"<div><code>{html.escape(line)}</code><br>{shown}</div>"
