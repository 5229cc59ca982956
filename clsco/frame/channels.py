"""Channels of an EXR file of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.outputs import ATTRIBUTES, OUTPUTS


def _layer_channels(name: str, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Channels of an array of two or three axes, by its name in files."""
    row = OUTPUTS[ATTRIBUTES[name]]
    layer = name if row.layer is None else row.layer
    if array.ndim == 2 and not row.letters:
        return {layer: array}
    letters = row.letters if array.ndim == 2 or len(row.letters) == array.shape[2] else "RGB"
    prefix = f"{layer}." if layer else ""
    return {prefix + letter: array if array.ndim == 2 else array[..., k] for k, letter in enumerate(letters)}


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
                shown = _layer_channels("color", image)
                channels |= {f"sample_{number:02d}.{letter}": plane for letter, plane in shown.items()}
        elif array.ndim > 1:
            channels |= _layer_channels(name, array)
    if "color" in arrays:
        channels.setdefault("A", np.ones(arrays["color"].shape[:2], arrays["color"].dtype))
    return channels
