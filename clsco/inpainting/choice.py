"""Choice of an inpainting method for an image: the better one at filling copies of the holes at known pixels."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.inpainting.fse import fill_texture
from clsco.opencl.session import Session

WINDOW = 96  # px, side of the parts of the image that are examined
MOST_WINDOWS = 4
SHIFT = (24, 24)  # px, displacement of the copied holes from the true holes
RIM = 8  # px, border of a window that gets no copied holes, because another window follows it, not the image around it
# Ratio of the errors of "texture" and "biharmonic" above which "biharmonic" is chosen: on photographs, errors in so few
# windows are uncertain by about 1 dB, and "texture" is the safer method; on smooth images the ratio is far larger.
MARGIN = 1.25


def choose_method(
    session: Session, image: NDArray[Any], missing: NDArray[np.bool_]
) -> Literal["biharmonic", "texture"]:
    """The method with the smaller square error at known pixels that are treated as missing, see MARGIN.

    image: (rows, columns, channels), of any type; missing: (rows, columns). At most MOST_WINDOWS windows are examined,
    evenly chosen among those with holes. In each window, a copy of the holes is shifted cyclically by SHIFT, and each
    method fills the copied and the true holes together; windows are stacked in one image, so that few launches suffice.
    If no window is usable, the method is "texture". The cost does not grow with the image.
    """
    windows = _windows(missing)
    if not windows:
        return "texture"
    apart = np.concatenate([_tried(missing[window]) for window in windows])
    holes = np.concatenate([missing[window] for window in windows]) | apart
    if holes.all() or not apart.any():
        return "texture"
    parts = np.concatenate([image[window] for window in windows]).astype(np.float32)
    errors = [
        np.square((fill(session, parts, holes) - parts[holes])[apart[holes]], dtype=np.float64).sum()
        for fill in (fill_texture, fill_biharmonic)
    ]
    return "biharmonic" if errors[1] * MARGIN < errors[0] else "texture"


def _windows(missing: NDArray[np.bool_]) -> list[tuple[slice, slice]]:
    """Windows to examine; along an axis shorter than WINDOW, a window is as long as the image."""
    rows, columns = (range(0, max(size - WINDOW, 0) + 1, WINDOW) for size in missing.shape)
    places = [(slice(i, i + WINDOW), slice(j, j + WINDOW)) for i in rows for j in columns]
    with_holes = [place for place in places if missing[place].any()]
    count = min(MOST_WINDOWS, len(with_holes))
    return [with_holes[(2 * k + 1) * len(with_holes) // (2 * count)] for k in range(count)]


def _tried(holes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of known pixels of a window that are treated as missing."""
    tried = np.roll(holes, SHIFT, axis=(0, 1)) & ~holes
    for axis in (0, 1):
        rim = min(RIM, holes.shape[axis] // 4)
        edge = np.moveaxis(tried, axis, 0)
        edge[:rim] = edge[len(edge) - rim :] = False
    return tried
