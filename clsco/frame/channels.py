"""Channels of an EXR file of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_COMPONENTS = {
    "color": ("", "RGB"),
    "sharp": ("sharp.", "RGB"),
    "normal": ("N.", "XYZ"),
    **{name: (f"{name}.", "uv") for name in ("flow", "flow_backward", "uv")},
}
_SENSOR = ("raw", "electrons", "noise_sigma", "saturated")
_OTHER_NAMES = {"depth": "Z", "object_id": "id", "alpha": "A"}


def _split(layer: str, names: str, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    return {layer + name: array if array.ndim == 2 else array[..., n] for n, name in enumerate(names)}


def exr_channels(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Name a frame's arrays, by their names in files, as channels of an EXR.

    They are R G B A, Z, sharp.R, N.X, flow.u, uv.u, id, and the others by their own names: coc, or coc.R, coc.G and
    coc.B where the lens tells colors apart; row_time where it is given for each pixel; raw.Y of a sensor, or of three
    planes raw.R and so on; sub-frames are sample_00.R. A gray frame has R, G and B, so that every reader shows it. A is
    the alpha where it was requested, else 1: a photograph covers all of its pixels.
    """
    channels: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        if name == "subframes":
            for number, image in enumerate(array):
                channels |= _split(f"sample_{number:02d}.", "RGB", image)
        elif name in _COMPONENTS:
            channels |= _split(*_COMPONENTS[name], array)
        elif name in _SENSOR or (name == "coc" and array.ndim == 3):
            channels |= _split(f"{name}.", "RGB" if array.ndim == 3 else "Y", array)
        elif array.ndim == 2:
            channels[_OTHER_NAMES.get(name, name)] = array
    if "color" in arrays:
        channels.setdefault("A", np.ones(arrays["color"].shape[:2], arrays["color"].dtype))
    return channels
