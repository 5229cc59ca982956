"""Arrays that users give to `clsco.defocus` and `clsco.inpaint`: NumPy's, or pyopencl's of one queue."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.errors import DeviceError, ImageError
from clsco.opencl.device import choose
from clsco.opencl.session import Session, session_of, session_on

MOST_CHANNELS = 16


def on_host(device: str | None, *arrays: Any) -> tuple[Session, list[NDArray[Any]], Callable[[NDArray[Any]], Any]]:
    """Where to work with arrays of any shape, the arrays as NumPy's, and what makes the result one of their kind.

    Where one of them is pyopencl's it is their queue, and the result goes there; else it is the device whose name
    contains `device`. Raises DeviceError for an array without a queue and where there is no such device.
    """
    there = [array for array in arrays if isinstance(array, cl_array.Array)]
    if not there:
        return session_on(choose(device)), [np.asarray(array) for array in arrays], lambda result: result
    queue = there[0].queue
    if queue is None:
        raise DeviceError("image: a pyopencl array must have a queue; got one without")
    host = [array.get(queue) if isinstance(array, cl_array.Array) else np.asarray(array) for array in arrays]
    return session_of(queue), host, partial(cl_array.to_device, queue)


def check_image(image: NDArray[Any]) -> None:
    """Raises ImageError unless it is (rows, columns) or (rows, columns, channels) with a pixel at least."""
    if image.ndim not in (2, 3) or 0 in image.shape or (image.ndim == 3 and image.shape[2] > MOST_CHANNELS):
        raise ImageError(
            f"image: must have the shape (rows, columns) or (rows, columns, 1 to {MOST_CHANNELS}); got {image.shape}"
        )
