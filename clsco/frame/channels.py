"""Channels of an EXR file of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_STEREO = ("disparity", "occluded")
_SENSOR = ("raw", "electrons", "noise_sigma", "saturated")


def _radii(array: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
    if array is None:
        return {}
    return {"coc": array} if array.ndim == 2 else {f"coc.{name}": array[..., n] for n, name in enumerate("RGB")}


def exr_channels(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Name a frame's arrays, by their names in files, as channels of an EXR.

    They are R G B A, Z, coc, sharp.R, N.X, flow.u, id, mask, filled, missing, hidden. Where the lens tells colors apart
    coc.R, coc.G and coc.B stand for coc. A scene that moves has flow_backward.u and flow_occluded, one with textures on
    surfaces uv.u, a stereo pair disparity and occluded; one with a rolling shutter row_time, where it is given for each
    pixel, one with vignetting throughput, and one with a sensor raw.Y, electrons.Y, noise_sigma.Y and saturated.Y, or
    of three planes raw.R and so on; sub-frames are sample_00.R. A gray frame has R, G and B, so that every reader shows
    it. A is the alpha where it was requested, else 1: a photograph covers all of its pixels.
    """
    color, plain = (
        arrays.get("color"),
        (*("mask", "filled", "missing", "hidden", "flow_occluded", "throughput"), *_STEREO),
    )

    def split(layer: str, names: str, array: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
        if array is None:
            return {}
        return {layer + name: array if array.ndim == 2 else array[..., n] for n, name in enumerate(names)}

    alpha = arrays.get("alpha")
    if alpha is None and color is not None:
        alpha = np.ones(color.shape[:2], color.dtype)
    subframes: dict[str, NDArray[Any]] = {}
    for number, image in enumerate(arrays.get("subframes", ())):
        subframes |= split(f"sample_{number:02d}.", "RGB", image)
    single = {"Z": "depth", "id": "object_id"} | {name: name for name in plain}
    single |= {"row_time": "row_time"} if np.ndim(arrays.get("row_time", 0.0)) == 2 else {}
    sensor: dict[str, NDArray[Any]] = {}
    for name in _SENSOR:
        array = arrays.get(name)
        sensor |= split(f"{name}.", "RGB" if array is not None and array.ndim == 3 else "Y", array)
    return {
        **split("", "RGB", color),
        **({} if alpha is None else {"A": alpha}),
        **{channel: arrays[name] for channel, name in single.items() if name in arrays},
        **_radii(arrays.get("coc")),
        **split("sharp.", "RGB", arrays.get("sharp")),
        **split("N.", "XYZ", arrays.get("normal")),
        **split("flow.", "uv", arrays.get("flow")),
        **split("flow_backward.", "uv", arrays.get("flow_backward")),
        **split("uv.", "uv", arrays.get("uv")),
        **sensor,
        **subframes,
    }
