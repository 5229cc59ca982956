"""Channels of a frame's EXR file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.outputs import ATTRIBUTES, OUTPUTS


def _layer_channels(name: str, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Channels of an array with two or three axes, by their names, which begin with the array's."""
    row = OUTPUTS[ATTRIBUTES[name]]
    layer = name if row.layer is None else row.layer
    if array.ndim == 2 and not row.letters:
        return {layer: array}
    letters = row.letters if array.ndim == 2 or len(row.letters) == array.shape[2] else "RGB"
    prefix = f"{layer}." if layer else ""
    return {prefix + letter: array if array.ndim == 2 else array[..., k] for k, letter in enumerate(letters)}


def exr_channels(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """A frame's arrays, by name in files, as channels of an EXR.

    The channels are R G B A, Z, sharp.R, N.X, flow.u, uv.u, id, and the other arrays by their own names: coc, or coc.R,
    coc.G and coc.B if the lens separates colors; row_time as a time per pixel; raw.Y of a sensor, or raw.R and so on
    for three planes; sample_00.R of sub-frames. A gray frame has R, G and B, so that every reader shows it. A is the
    alpha if it was requested, else 1, because a photograph covers all of its pixels.
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
