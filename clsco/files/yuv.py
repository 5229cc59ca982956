"""Conversion of red, green and blue codes to the planes of video encoders (ITU-R BT.709, limited range)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

RED, BLUE = 0.2126, 0.0722  # shares of luma
_GREEN = 1 - RED - BLUE
# Rows: Y, Cb, Cr. In 8 bits, luma from 0 to 1 has 219 steps, and a color difference from -1/2 to 1/2 has 224.
_MATRIX = np.array(
    [
        [219 * RED, 219 * _GREEN, 219 * BLUE],
        [-112 * RED / (1 - BLUE), -112 * _GREEN / (1 - BLUE), 112],
        [112, -112 * _GREEN / (1 - RED), -112 * BLUE / (1 - RED)],
    ]
)
_OFFSETS = np.array([16, 128, 128])


def yuv_planes(codes: NDArray[Any], bits: int, blocks: tuple[int, int] = (1, 1)) -> list[NDArray[Any]]:
    """Luma and color differences of an image: Y (rows, columns), and Cb and Cr, smaller by `blocks`, rounded once.

    codes: uint8 or uint16 (rows, columns[, 3]), in the transfer curve that the video states. bits: of the planes, 8 or
    10; they are uint8 or uint16. blocks: rows and columns of pixels that share a color difference, (2, 2) for 4:2:0,
    (1, 2) for 4:2:2; the image consists of whole blocks.

    Color differences are sited as in MPEG-2: on the left of two columns, averaged with weights 1 2 1, and midway
    between two rows. libswscale gives the same from 8-bit codes, but its 10-bit luma from 16-bit codes is too large by
    1.7 codes, at most 3.8.
    """
    top, scale = np.iinfo(codes.dtype).max, 2 ** (bits - 8)
    if codes.ndim == 2:
        luma = codes.astype(np.float32) * np.float32(219 * scale / top)
        planes = np.stack([luma, np.zeros_like(luma), np.zeros_like(luma)])
    else:
        values = codes.reshape(-1, 3).T.astype(np.float32)
        planes = ((_MATRIX * (scale / top)).astype(np.float32) @ values).reshape(3, *codes.shape[:2])
    down, right = blocks
    smaller = [_halved(plane, down, right) for plane in planes[1:]]
    kind = np.uint8 if bits == 8 else np.uint16
    pairs = zip((planes[0], *smaller), _OFFSETS, strict=True)
    return [(plane + np.float32(offset * scale + 0.5)).astype(kind) for plane, offset in pairs]


def _halved(plane: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """A plane sampled at every second column if `right` is 2, and between every two rows if `down` is 2."""
    if right == 2:
        padded = np.pad(plane, ((0, 0), (1, 0)), mode="edge")
        plane = (
            0.25 * padded[:, :-1:2]
            + 0.5 * padded[:, 1::2]
            + 0.25 * np.pad(plane, ((0, 0), (0, 1)), mode="edge")[:, 1::2]
        )
    return 0.5 * (plane[::2] + plane[1::2]) if down == 2 else plane
