"""Images at another size (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def resample(linear: Floats, size: tuple[int, ...], first: int = 0, end: int | None = None) -> Floats:
    """Resample an image to another size with the same outer borders, without aliasing.

    linear: (rows, columns[, channels]), linear. size: (rows, columns). first, end: which rows of it are wanted, by
    default all. Returns size[, channels], >= 0.
    Separable Catmull-Rom cubic (Catmull and Rom 1974; a = -1/2 of Keys 1981), as wide as an output pixel
    where the image shrinks. Each output pixel's weights sum to 1; beyond the border the nearest pixel
    repeats; what rings below 0 is 0. Validated on constants, cosines, mirrored images, and by the mean.
    """
    if linear.shape[:2] == size:
        return linear[first:end]
    wanted = np.arange(size[0])[first:end]
    linear = linear[wanted] if linear.shape[0] == size[0] else resample_rows(linear, size[0], wanted)
    if linear.shape[1] != size[1]:
        linear = np.swapaxes(resample_rows(np.swapaxes(linear, 0, 1), size[1], np.arange(size[1])), 0, 1)
    return np.ascontiguousarray(np.maximum(linear, 0))


def resample_rows(image: Floats, rows: int, wanted: NDArray[np.intp]) -> Floats:
    """The wanted ones of the rows of an image that has `rows` then; see `resample`. Keeps second moments: the cubic has
    none of its own. May be below 0."""
    before = image.shape[0]
    width = max(before / rows, 1.0)
    center = (wanted + 0.5) * before / rows - 0.5
    taps = np.floor(center - 2 * width)[:, None] + np.arange(int(np.ceil(4 * width)) + 2)
    t = np.abs(taps - center[:, None]) / width
    outer = np.where(t < 2, ((2.5 - 0.5 * t) * t - 4) * t + 2, 0)
    weights = np.where(t < 1, (1.5 * t - 2.5) * t * t + 1, outer)
    weights /= weights.sum(axis=1, keepdims=True)
    nearest = np.clip(taps, 0, before - 1).astype(np.intp)
    result = np.zeros((len(wanted), *image.shape[1:]))
    for weight, source in zip(weights.T, nearest.T, strict=True):
        result += weight.reshape(-1, *[1] * (image.ndim - 1)) * image[source]
    return result
