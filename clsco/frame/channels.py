"""Channels of a frame's EXR file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.outputs import ATTRIBUTES, OUTPUTS


def channel_names(name: str, planes: int = 1) -> list[str]:
    """Names of the channels of an array of one or more planes; name: that of the array in files."""
    row = OUTPUTS[ATTRIBUTES[name]]
    layer = name if row.layer is None else row.layer
    letters = row.letters if planes in (1, len(row.letters)) else "RGB"
    return [f"{layer}.{letter}" if layer else letter for letter in letters] or [layer]


def _layer_channels(name: str, array: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Channels of an array with two or three axes."""
    if array.ndim == 2:
        return dict.fromkeys(channel_names(name), array)
    return {channel: array[..., k] for k, channel in enumerate(channel_names(name, array.shape[2]))}


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
