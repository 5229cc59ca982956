"""Conversion of arrays that users pass to `clsco.defocus` and `clsco.inpaint`, which may be arrays of pyopencl."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.errors import ArgumentError, DeviceError
from clsco.opencl.session import DeviceLike, Session, session_for

MOST_CHANNELS = 16


def on_host(device: DeviceLike, **arrays: Any) -> tuple[Session, list[NDArray[Any]], Callable[[NDArray[Any]], Any]]:
    """The session for a user's arrays, the arrays as NumPy arrays, and a function that converts a result to their kind.

    arrays: by the names that messages give them. If any is a pyopencl array, the session works in the queue of the
    first such array, and results become pyopencl arrays; otherwise the session is on `device`. Masked arrays stay
    masked. Raises DeviceError if the first pyopencl array has no queue or `device` is unknown, ArgumentError if a
    pyopencl array is not contiguous.
    """
    there = {name: array for name, array in arrays.items() if isinstance(array, cl_array.Array)}
    if not there:
        return session_for(device), [np.asanyarray(array) for array in arrays.values()], lambda result: result
    first, queue = next((name, array.queue) for name, array in there.items())
    if queue is None:
        raise DeviceError(f"{first}: a pyopencl array must have a queue; got one without")
    for name, array in there.items():
        if not array.flags.forc:
            raise ArgumentError(f"{name}: a pyopencl array must be contiguous; got strides {array.strides}")
    host = [array.get(queue) if name in there else np.asanyarray(array) for name, array in arrays.items()]
    return session_for(queue), host, partial(cl_array.to_device, queue)


def without_mask(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """The array as a plain array, without the mask of a masked array. Raises ArgumentError if any value is masked."""
    masked = int(np.count_nonzero(np.ma.getmaskarray(array))) if isinstance(array, np.ma.MaskedArray) else 0
    if masked:
        raise ArgumentError(
            f"{name}: must have no masked values; got {masked} of them (clsco.inpaint fills an image's)"
        )
    return np.asarray(array)


def check_image(image: NDArray[Any], where: str = "") -> None:
    """Raise ArgumentError unless the shape is (rows, columns) or (rows, columns, 1 to MOST_CHANNELS), not empty.

    where: beginning of the message.
    """
    if image.ndim not in (2, 3) or 0 in image.shape or (image.ndim == 3 and image.shape[2] > MOST_CHANNELS):
        rule = f"must have the shape (rows, columns) or (rows, columns, 1 to {MOST_CHANNELS})"
        raise ArgumentError(f"{where}image: {rule}; got {image.shape}")
