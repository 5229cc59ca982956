"""Depth, blur radius and flow as colors, with one scale for all frames of a clip."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import FileError

Picture = NDArray[np.uint8]
# Every 15th of the 256 colors of viridis, perceptually uniform, by N. Smith, S. van der Walt and E. Firing (CC0),
# in matplotlib since 1.5.
VIRIDIS = (
    "440154 481769 472a7a 433d84 3d4e8a 355e8d 2e6d8e 297b8e 23898e 1f978b 21a585 2eb37c 46c06f 65cb5e 89d548 b0dd2f "
    "d8e219 fde725"
)
# Hues, each with the number of colors from it to the next, as in the color wheel of S. Baker et al., "A Database and
# Evaluation Methodology for Optical Flow", IJCV 2011: red, yellow, green, cyan, blue, magenta, and red again.
_WHEEL = ((15, (255, 0, 0)), (6, (255, 255, 0)), (4, (0, 255, 0)), (11, (0, 255, 255)), (13, (0, 0, 255)),
          (6, (255, 0, 255)))  # fmt: skip


@dataclass(frozen=True)
class FrameView:
    """Display of an output in colors.

    extent: returns one or more numbers for an array; the maxima of these over all arrays of a
    clip are the scale; paint: called with an array and the scale, returns 8-bit RGB; label: returns a text that states
    the scale.
    """

    extent: Callable[[NDArray[Any]], tuple[float, ...]]
    paint: Callable[[NDArray[Any], tuple[float, ...]], Picture]
    label: Callable[[tuple[float, ...]], str]

    def scale(self, arrays: Iterable[NDArray[Any]]) -> tuple[float, ...]:
        """The scale of all arrays of a clip."""
        return tuple(np.max([self.extent(array) for array in arrays], axis=0).tolist())


def _require(array: NDArray[Any], name: str, also: float | None = None) -> NDArray[Any]:
    """Mask of finite numbers. Raises FileError if any number is neither finite nor `also`."""
    finite: NDArray[Any] = np.isfinite(array)
    if not (finite if also is None else finite | (array == also)).all():
        raise FileError(f"view: {name} must be finite{'' if also is None else f' or {also}'}; got other numbers")
    return finite


def _depth_extent(depth: NDArray[Any]) -> tuple[float, ...]:
    seen = depth[_require(depth, "depth", np.inf)]
    return (-float(seen.min()), float(seen.max())) if seen.size else (-np.inf, -np.inf)


def _paint(values: NDArray[Any], scale: tuple[float, ...]) -> Picture:
    """Colors of depth or blur radii: dark near the camera, bright far from it; black without a surface."""
    seen = np.isfinite(values)
    painted = viridis(np.where(seen, values, 0.0), -scale[0], scale[-1])
    return np.where(seen[..., None], painted, np.uint8(0))


def _depth_label(scale: tuple[float, ...]) -> str:
    if not np.isfinite(scale).all():
        return "depth: nothing is there, black"
    return f"depth: viridis from {-scale[0]:.6g} mm (dark) to {scale[1]:.6g} mm (bright); nothing is black"


def _radius_extent(radius: NDArray[Any]) -> tuple[float, ...]:
    seen = radius[_require(radius, "coc", np.inf)]
    return (float(np.abs(seen).max(initial=0.0)),)


def _flow_extent(flow: NDArray[Any]) -> tuple[float, ...]:
    known = _require(flow, "flow", np.inf).all(axis=-1)  # flow may be inf with a rolling shutter
    return (float(np.hypot(*flow[known].T).max(initial=0.0)),)


def _radius_label(scale: tuple[float, ...]) -> str:
    ends = f"{0.0 - scale[0]:.6g} px (dark, near) to {scale[0]:.6g} px (bright, far)"
    return f"coc: viridis from {ends}; nothing is black"


def _flow_label(scale: tuple[float, ...]) -> str:
    return f"flow: Middlebury color wheel, white for none to full color for {scale[0]:.6g} px"


VIEWS = {
    "depth": FrameView(_depth_extent, _paint, _depth_label),
    "coc": FrameView(_radius_extent, _paint, _radius_label),
    "flow": FrameView(_flow_extent, lambda flow, scale: flow_colors(flow, scale[0]), _flow_label),
}
"""Displays by the name of their array in files, which is that of the view."""


def viridis(values: NDArray[Any], low: float, high: float) -> Picture:
    """Colors (rows, columns, 3) of numbers (rows, columns), from dark at `low` to bright at `high`.

    They are interpolated between 18 of the 256 colors of viridis; within 5 codes of all of them
    (tests/frame/test_views.py).
    """
    table = np.array([list(bytes.fromhex(color)) for color in VIRIDIS.split()], np.float64)
    span = high - low
    share = np.clip((values.astype(np.float64) - low) / span, 0, 1) if 0 < span < np.inf else np.zeros(values.shape)
    place = share * (len(table) - 1)
    channels = [np.interp(place, np.arange(len(table)), table[:, channel]) for channel in range(3)]
    return (np.stack(channels, axis=-1) + 0.5).astype(np.uint8)


def flow_colors(flow: NDArray[Any], longest: float) -> Picture:
    """Colors (rows, columns, 3) of displacements (rows, columns, 2) in px, x right, y down.

    The hue shows the direction, full color is reached at the length `longest`, and pixels that are not finite are
    black. Validated against a transcription of Middlebury's C++ (tests/frame/test_views.py).
    """
    known = np.isfinite(flow).all(axis=2, keepdims=True)
    x, y = np.moveaxis(np.where(known, flow, 0.0).astype(np.float64), 2, 0) / (longest if longest > 0 else 1.0)
    wheel = _wheel()
    place = (np.arctan2(-y, -x) / np.pi + 1) / 2 * (len(wheel) - 1)
    first = np.floor(place).astype(np.intp)
    share = (place - first)[..., None]
    hue = (1 - share) * wheel[first] + share * wheel[(first + 1) % len(wheel)]
    strength = np.minimum(np.hypot(x, y), 1.0)[..., None]
    painted: Picture = (255 * known * (1 - strength * (1 - hue))).astype(np.uint8)
    return painted


def _wheel() -> NDArray[np.float64]:
    """Colors of the 55 hues of the color wheel, (55, 3), from 0 to 1."""
    hues = [color for _, color in _WHEEL]
    steps = []
    for (count, color), after in zip(_WHEEL, (*hues[1:], hues[0]), strict=True):
        rising = np.floor(255 * np.arange(count) / count)[:, None]
        up = np.sign(np.subtract(after, color))
        steps.append(np.asarray(color) + up * rising)
    return np.concatenate(steps) / 255
