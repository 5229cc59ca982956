"""Color profiles that LittleCMS makes, and the numbers that tests make them from."""

from __future__ import annotations

from typing import Any

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from clsco.files.transfer import decode

D65 = [0.3127, 0.329, 1.0]
P3, ADOBE = [0.68, 0.32, 1, 0.265, 0.69, 1, 0.15, 0.06, 1], [0.64, 0.33, 1, 0.21, 0.71, 1, 0.15, 0.06, 1]


def made(kind: str = "rgb", **options: Any) -> bytes:
    return bytes(imagecodecs.cms_profile(kind, **options))


def srgb_table(count: int) -> NDArray[np.uint16]:
    """The curve of sRGB at `count` codes."""
    return np.rint(decode((np.arange(count) * 65535 // (count - 1)).astype("u2"), "srgb") * 65535).astype("u2")
