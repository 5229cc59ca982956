"""Resampling of images to another size (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AT_A_TIME = 2**16  # number of values processed at a time, so that they stay in the cache of the processor


def resample(
    linear: Floats, size: tuple[int, ...], first: int = 0, end: int | None = None, part: tuple[int, int] | None = None
) -> Floats:
    """Resample an image to another size with the same outer borders, without aliasing.

    linear: (rows, columns[, channels]), linear. size: (rows, columns) of the result. first, end: range of result rows
    to compute, by default all. part: if `linear` holds only the rows from `rows_for`, the number of its first row and
    the number of rows of the whole image. Returns an array size[, channels].

    The filter is the Catmull-Rom cubic (Catmull and Rom 1974; a = -1/2 of Keys 1981); if the image shrinks, it is
    widened to the output pixels. The weights of each output pixel sum to 1; beyond the border the nearest pixel
    repeats; values below 0 become 0. An image that has the size already stays as it is. Validated on constants,
    cosines, mirrored images, and by the mean.
    """
    if linear.shape[:2] == size:
        return linear[first:end]
    numbers = np.arange(size[0])[first:end]
    above, before = part or (0, linear.shape[0])
    linear = linear[numbers - above] if before == size[0] else resample_rows(linear, size[0], numbers, above, before)
    if linear.shape[1] != size[1]:
        linear = np.swapaxes(resample_rows(np.swapaxes(linear, 0, 1), size[1], np.arange(size[1])), 0, 1)
    return np.ascontiguousarray(np.maximum(linear, 0))


def rows_for(before: int, rows: int, first: int, end: int) -> tuple[int, int]:
    """First row and end of the rows of an image that rows `first` to before `end` of its resampled version depend on.

    before, rows: number of rows of the image and of its resampled version.
    """
    if before == rows:
        return first, end
    taps, _ = _taps(before, rows, np.array([first, end - 1]))
    return max(int(taps.min()), 0), min(int(taps.max()) + 1, before)


def _taps(before: int, rows: int, numbers: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Taps of the rows `numbers` of an image resampled from `before` to `rows` rows.

    Returns the numbers of the source rows to sum, (numbers, taps), and their distances from the resampled row in units
    of the cubic's argument.
    """
    width = max(before / rows, 1.0)
    center: Floats = (numbers + 0.5) * before / rows - 0.5
    taps: Floats = np.floor(center - 2 * width)[:, None] + np.arange(int(np.ceil(4 * width)) + 2)
    return taps, np.abs(taps - center[:, None]) / width


def resample_rows(
    image: NDArray[np.floating], rows: int, numbers: NDArray[np.intp], above: int = 0, before: int | None = None
) -> Floats:
    """Rows `numbers` of an image resampled to `rows` rows, as in `resample`; the result may be negative.

    above, before: the two numbers in `part` of `resample`. Second moments are preserved, as the cubic's own is 0.
    """
    before = image.shape[0] if before is None else before
    taps, t = _taps(before, rows, numbers)
    outer = np.where(t < 2, ((2.5 - 0.5 * t) * t - 4) * t + 2, 0)
    weights = np.where(t < 1, (1.5 * t - 2.5) * t * t + 1, outer)
    weights /= weights.sum(axis=1, keepdims=True)
    used = weights.any(axis=0)
    weights, nearest = weights[:, used], np.clip(taps[:, used], 0, before - 1).astype(np.intp) - above
    flat = np.ascontiguousarray(image).reshape(len(image), -1)
    result = np.zeros((len(numbers), flat.shape[1]))
    step = max(1, AT_A_TIME // flat.shape[1])
    for start in range(0, len(numbers), step):
        total, here = result[start : start + step], slice(start, start + step)
        first, term = nearest[here].min(), np.empty_like(total)
        part = flat[first : nearest[here].max() + 1].astype(np.float64, copy=False)
        for weight, source in zip(weights[here].T, nearest[here].T, strict=True):
            np.take(part, source - first, axis=0, out=term, mode="clip")  # the default mode would copy
            term *= weight[:, None]
            total += term
    return result.reshape(len(numbers), *image.shape[1:])
