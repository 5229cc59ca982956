"""Inpainting: missing pixels of an image, filled from those around them."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any, overload

import numpy as np
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.errors import ImageError, SceneError
from clsco.inpainting.methods import METHODS, THESIS, Filled, Task, check_method, method_for
from clsco.inpainting.report import Report
from clsco.inpainting.rules import MeanMedian, as_stored, value_span
from clsco.opencl.arrays import check_image, on_host
from clsco.opencl.session import Session

LARGEST = 2.0**60  # in size: squares of differences are then finite in float32


@overload
def inpaint(
    image: NDArray[Any], missing: NDArray[Any], *, method: str = "auto", device: str | None = None,
    progress: Callable[[float], object] | None = None, **constants: Any,
) -> tuple[NDArray[Any], Report]: ...  # fmt: skip
@overload
def inpaint(
    image: cl_array.Array, missing: cl_array.Array, *, method: str = "auto", device: str | None = None,
    progress: Callable[[float], object] | None = None, **constants: Any,
) -> tuple[cl_array.Array, Report]: ...  # fmt: skip
def inpaint(
    image: NDArray[Any] | cl_array.Array,
    missing: NDArray[Any] | cl_array.Array,
    *,
    method: str = "auto",
    device: str | None = None,
    progress: Callable[[float], object] | None = None,
    **constants: Any,
) -> tuple[NDArray[Any] | cl_array.Array, Report]:
    """Fill the missing pixels of an image.

    image: (rows, columns) or (rows, columns, channels), up to 16 channels, uint8, uint16 or floats; what missing pixels
    hold does not matter. missing: (rows, columns), bool, or uint8 of 0 and 255 = missing. method: "mean-median", the
    thesis' (chapter 5), "biharmonic" (`clsco.inpainting.biharmonic`), "texture" (`clsco.inpainting.fse`), or
    "auto", the better of these two (`clsco.inpainting.choice`). device: part of an OpenCL device's name; progress: is
    called with the share that is done, from 0 to 1. constants: of mean-median, as `rules.MeanMedian` names
    them, such as smoothing_rounds=0.
    NumPy arrays, or pyopencl arrays of one queue, which is then worked in.
    Returns an image of the same type and shape, of which known pixels are those that were given (but for those that
    stage 3 of mean-median blends), and the report. An image without missing pixels is copied. Raises ImageError for
    images and masks that cannot be, such as without any known pixel, SceneError, DeviceError.
    Validated bit by bit against `clsco.reference.inpainting.mean_median` (tests/test_inpaint.py).
    """
    session, host, as_given = on_host(device, image, missing)
    with session.telling():
        filled, report = _inpaint(session, *_checked(*host), method, progress, constants)
        return as_given(filled), report


def _checked(picture: NDArray[Any], holes: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    check_image(picture)
    if picture.dtype not in (np.uint8, np.uint16, np.float16, np.float32, np.float64):
        raise ImageError(f"image: must be uint8, uint16, float16, float32 or float64; got {picture.dtype}")
    if holes.shape != picture.shape[:2]:
        raise ImageError(
            f"missing: must have the rows and columns of the image, {picture.shape[:2]}; got {holes.shape}"
        )
    if holes.dtype == np.uint8:
        other = (holes != 0) & (holes != 255)
        if other.any():
            raise ImageError(f"missing: must be 0 or 255 where it is uint8; got {int(other.sum())} other values")
        holes = holes == 255
    if holes.dtype != np.bool_:
        raise ImageError(f"missing: must be bool, or uint8 of 0 and 255; got {holes.dtype}")
    if holes.all():
        raise ImageError("missing: some pixel must be known; got none that is")
    if picture.dtype.kind == "f":
        most = min(LARGEST, float(np.finfo(picture.dtype).max))
        usable = np.abs(picture) <= most  # false for what is not a number
        wrong = int((~usable & ~(holes if picture.ndim == 2 else holes[..., None])).sum())
        if wrong:
            raise ImageError(f"image: known pixels must be finite, and at most 2^60 in size; got {wrong} others")
    return picture, holes


def _inpaint(
    session: Session, image: NDArray[Any], missing: NDArray[np.bool_], method: str,
    progress: Callable[[float], object] | None, constants: dict[str, Any],
) -> tuple[NDArray[Any], Report]:  # fmt: skip
    check_method(method)
    if constants and method != THESIS:
        raise SceneError(f"{next(iter(constants))}: belongs to method {THESIS}; got {method}")
    unknown = constants.keys() - MeanMedian.__dataclass_fields__.keys()
    if unknown:
        wanted = ", ".join(MeanMedian.__dataclass_fields__)
        raise SceneError(f"constants: must be some of {wanted}; got {min(unknown)}")
    chosen, before = MeanMedian(**constants), perf_counter()
    result, done, name = image.copy(), Filled(np.empty(0, np.int64), np.empty((0, 1), np.float32)), method
    if missing.any():
        planes = np.ascontiguousarray(image).reshape(*missing.shape, -1)
        task = Task(planes, missing, value_span(image, missing), chosen, progress or (lambda _: None))
        name = method_for(session, task, method)
        done = METHODS[name](session, task)
        result.reshape(-1, planes.shape[2])[done.pixels] = as_stored(done.values, image.dtype)
    seconds = perf_counter() - before
    device = str(session.device)
    return result, Report(name, device, image.shape, str(image.dtype), int(missing.sum()), seconds, done.stages, chosen)
