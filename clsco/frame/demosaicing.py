"""Demosaicing: full color from a Bayer mosaic, whose pixels measure one color each."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import import_extra

Array = NDArray[np.float64]
_CORNERS = np.array([[1.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]) / 4
_CROSS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]) / 4
_ROW = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]) / 2
_GREEN, _APRON = 1, 8  # number of the channel; px added around a mosaic, an even number

KERNELS: dict[str, tuple[Array, Array, Array]] = {
    "bilinear": (_CROSS, _ROW, _CORNERS),
    # Malvar, He and Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images", ICASSP
    # 2004, figure 2: bilinear, corrected by the second derivative of the color that was measured.
    "malvar": (
        np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8,
        np.array([[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0], [0, 0, 1, 0, 0]]) / 16,
        np.array([[0, 0, -3, 0, 0], [0, 4, 0, 4, 0], [-3, 0, 12, 0, -3], [0, 4, 0, 4, 0], [0, 0, -3, 0, 0]]) / 16,
    ),
}
"""Three arrays of weights of the neighbors, by method. The first is for green at red and blue pixels. The second is for
red or blue at a green pixel with pixels of that color in its row; it is transposed if they are in its column. The third
is for red at blue pixels and for blue at red pixels."""


def demosaic(plane: NDArray[np.floating], filters: Sequence[int], method: str) -> Array:
    """Red, green and blue of all pixels, (rows, columns, 3), from a plane (rows, columns) of measured values.

    filters: channels of a block of 2 x 2 pixels, row by row; method: bilinear, malvar or menon. The mosaic is extended
    by reflection, which preserves its pattern. Raises MissingDependencyError if menon lacks colour-demosaicing.

    >>> import numpy as np
    >>> from clsco.frame.demosaicing import demosaic
    >>> demosaic(np.array([[0.0, 4.0], [4.0, 8.0]]), (0, 1, 1, 2), "bilinear")[0, 0].tolist()
    [0.0, 4.0, 8.0]
    """
    padded = np.pad(np.asarray(plane, np.float64), _APRON, mode="reflect")
    if method == "menon":
        pattern = "".join("RGB"[channel] for channel in filters)
        colors: Array = menon_function()(padded, pattern)[_APRON:-_APRON, _APRON:-_APRON]
        return colors
    colors = np.empty((*plane.shape, 3))
    for site, measured in enumerate(filters):
        y, x = divmod(site, 2)
        for channel in range(3):
            kernel = _kernel(method, measured, channel, same_row=channel == filters[site ^ 1])
            colors[y::2, x::2, channel] = _weighted(padded, kernel, y, x, colors[y::2, x::2, 0].shape)
    return colors


def _kernel(method: str, measured: int, channel: int, *, same_row: bool) -> Array:
    cross, row, corners = KERNELS[method]
    if channel == measured:
        return np.ones((1, 1))
    if channel == _GREEN:
        return cross
    if measured == _GREEN:
        return row if same_row else row.T
    return corners


def _weighted(padded: Array, kernel: Array, y: int, x: int, size: tuple[int, ...]) -> Array:
    """Weighted sums of neighbors for every second pixel of every second row, from row y and column x on."""
    total, first = np.zeros(size), _APRON - len(kernel) // 2
    for (dy, dx), weight in np.ndenumerate(kernel):
        if weight:
            below, right = first + y + dy, first + x + dx
            total += weight * padded[below : below + 2 * size[0] : 2, right : right + 2 * size[1] : 2]
    return total


def menon_function() -> Any:
    """Demosaicing function of the package colour-demosaicing. Raises MissingDependencyError if it is not installed."""
    with warnings.catch_warnings(), np.printoptions():  # the package changes how all arrays are printed
        warnings.simplefilter("ignore", DeprecationWarning)  # SciPy warns of how the package imports it
        return import_extra("sensor.demosaic", "colour_demosaicing", "sensor").demosaicing_CFA_Bayer_Menon2007
