"""Inpainting: fills the missing pixels of an image from those around them."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any, Literal, TypeVar, overload

import numpy as np
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.errors import ArgumentError, SceneError
from clsco.inpainting.methods import THESIS, Filled, check_method, fill
from clsco.inpainting.report import Report
from clsco.inpainting.rules import MeanMedian, as_stored
from clsco.opencl.arrays import check_image, on_host, without_mask
from clsco.opencl.session import DeviceLike, Session

Array = TypeVar("Array", NDArray[Any], cl_array.Array)
LARGEST = 2.0**60  # largest |value|: squares of differences are then finite in float32


@overload
def inpaint(
    image: Array, mask: Array, *, method: str = "auto", device: DeviceLike = None,
    progress: Callable[[float], object] | None = None, options: MeanMedian | None = None,
    return_report: Literal[False] = False,
) -> Array: ...  # fmt: skip
@overload
def inpaint(
    image: Array, mask: Array, *, method: str = "auto", device: DeviceLike = None,
    progress: Callable[[float], object] | None = None, options: MeanMedian | None = None,
    return_report: Literal[True],
) -> tuple[Array, Report]: ...  # fmt: skip
def inpaint(
    image: NDArray[Any] | cl_array.Array,
    mask: NDArray[Any] | cl_array.Array,
    *,
    method: str = "auto",
    device: DeviceLike = None,
    progress: Callable[[float], object] | None = None,
    options: MeanMedian | None = None,
    return_report: bool = False,
) -> Any:
    """Fill the missing pixels of an image from those around them.

    Parameters
    ----------
    image : array (rows, columns) or (rows, columns, 1 to 16)
        Linear radiance as floats, or sRGB codes as uint8 or uint16, which are filled as codes. Values of missing pixels
        are ignored. In a masked array, pixels with a masked channel are missing too. The arrays are NumPy arrays, or
        pyopencl arrays of one queue, which are copied through the host.
    mask : array (rows, columns)
        bool, True for missing pixels; or uint8, 255 for missing and 0 for known pixels.
    method : str
        "biharmonic", "texture", "auto" for the better of these two, or "mean-median", the method of the thesis (chapter
        5).
    device : str, pyopencl.Device, Context or CommandQueue, optional
        Part of a device's name, "cpu" or "gpu", or a pyopencl object to work with. By default the queue of pyopencl
        arrays.
    progress : callable, optional
        Called with the fraction of the work that is done, from 0 to 1.
    options : clsco.inpainting.rules.MeanMedian, optional
        Constants of the method "mean-median", such as `MeanMedian(smoothing_rounds=0)`.
    return_report : bool
        Also return a `clsco.inpainting.report.Report`.

    Returns
    -------
    array of the image's shape and dtype
        NumPy or pyopencl array, like `image`. Known pixels are unchanged, except those that stage 3 of "mean-median"
        blends; without missing pixels the result is a copy.
    Report
        Only with `return_report`: the method that was used, and measurements of its stages.

    Raises
    ------
    ArgumentError
        An array is invalid, such as an image without any known pixel.
    SceneError
        Another argument is invalid.
    DeviceError
        The device does not exist, or fails.

    Notes
    -----
    Validated bit by bit against `clsco.reference.inpainting` (tests/inpainting).

    Examples
    --------
    >>> import clsco
    >>> import numpy as np
    >>> image = np.add.outer(np.arange(24.0), np.arange(32.0))
    >>> mask = np.zeros(image.shape, bool)
    >>> mask[10:14, 10:14] = True
    >>> filled = clsco.inpaint(np.where(mask, 0.0, image), mask, method="biharmonic")
    >>> bool(abs(filled - image).max() < 1e-3)
    True
    """
    session, (picture, holes), as_given = on_host(device, image=image, mask=mask)
    checked = _check_arrays(picture, without_mask("mask", holes))
    with session.reporting():
        filled, report = _inpaint(session, *checked, method, progress, options)
        result = as_given(filled)
    return (result, report) if return_report else result


def _check_arrays(picture: NDArray[Any], holes: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    check_image(picture)
    if picture.dtype not in (np.uint8, np.uint16, np.float16, np.float32, np.float64):
        raise ArgumentError(f"image: must be uint8, uint16, float16, float32 or float64; got {picture.dtype}")
    if holes.shape != picture.shape[:2]:
        rule = f"must have the rows and columns of the image, {picture.shape[:2]}"
        raise ArgumentError(f"mask: {rule}; got {holes.shape}")
    if holes.dtype == np.uint8:
        invalid = (holes != 0) & (holes != 255)
        if invalid.any():
            raise ArgumentError(f"mask: must be 0 or 255 where it is uint8; got {int(invalid.sum())} other values")
        holes = holes == 255
    if holes.dtype != np.bool_:
        raise ArgumentError(f"mask: must be bool, or uint8 of 0 and 255; got {holes.dtype}")
    if isinstance(picture, np.ma.MaskedArray):
        masked = np.ma.getmaskarray(picture)
        picture, holes = picture.data, holes | (masked.any(axis=2) if masked.ndim == 3 else masked)
    if holes.all():
        raise ArgumentError("mask: some pixel must be known; got none that is")
    if picture.dtype.kind == "f":
        most = min(LARGEST, float(np.finfo(picture.dtype).max))
        usable = np.abs(picture) <= most  # False for NaN
        wrong = int((~usable & ~(holes if picture.ndim == 2 else holes[..., None])).sum())
        if wrong:
            raise ArgumentError(f"image: known pixels must be finite, and at most 2^60 in size; got {wrong} others")
    return picture, holes


def _inpaint(
    session: Session, image: NDArray[Any], missing: NDArray[np.bool_], method: str,
    progress: Callable[[float], object] | None, options: MeanMedian | None,
) -> tuple[NDArray[Any], Report]:  # fmt: skip
    check_method(method)
    if options is not None and method != THESIS:
        raise SceneError(f"options: belong to method {THESIS}; got {method}")
    if not isinstance(options, MeanMedian | None):
        raise SceneError(f"options: must be a MeanMedian; got {type(options).__name__}")
    chosen, before = options or MeanMedian(), perf_counter()
    result, done = image.copy(), Filled(np.empty(0, np.int64), np.empty((0, 1), np.float32), method)
    if missing.any():
        planes = np.ascontiguousarray(image).reshape(*missing.shape, -1)
        done = fill(session, method, planes, missing, chosen, progress or (lambda _: None))
        result.reshape(-1, planes.shape[2])[done.pixels] = as_stored(done.values, image.dtype)
    of_image = str(session.device), image.shape, str(image.dtype), int(missing.sum()), perf_counter() - before
    return result, Report(done.method, *of_image, done.stages, chosen)
