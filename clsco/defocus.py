"""The lens by itself: one image and its map of blur radii."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, overload

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.coarse import Coarse, make_spreader
from clsco.coarsening import METHODS, Told, candidates, check_border, checked_tolerance, estimate, sample_places
from clsco.device import Device, Session, choose, described
from clsco.errors import DeviceError, ImageError, SceneError
from clsco.layers import Layers
from clsco.layout import Real, Struct, flat, frame_struct, in_parts, structs
from clsco.optics import LARGEST_BLUR
from clsco.plan import Blur, is_sharp
from clsco.program import build, empty, kernel, launch, upload
from clsco.psf import LANES, reach
from clsco.scene import Psf
from clsco.scenefile import parse_psf
from clsco.spread import PIXELS, Sources, blur_features

MOST_CHANNELS = 16
# Features that only surfaces need.
PLAIN = dict.fromkeys(("SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED", "FILTER", "SUBPIXELS", "OCCLUDED"), 0)


@overload
def defocus(
    image: NDArray[Any], coc: NDArray[Any], psf: Psf | Mapping[str, Any] | None = None,
    *, device: str | None = None, method: str = "auto", tolerance: float | None = None, told: list[Told] | None = None,
) -> NDArray[np.float32]: ...  # fmt: skip
@overload
def defocus(
    image: cl_array.Array, coc: cl_array.Array, psf: Psf | Mapping[str, Any] | None = None,
    *, device: str | None = None, method: str = "auto", tolerance: float | None = None, told: list[Told] | None = None,
) -> cl_array.Array: ...  # fmt: skip
def defocus(
    image: NDArray[Any] | cl_array.Array,
    coc: NDArray[Any] | cl_array.Array,
    psf: Psf | Mapping[str, Any] | None = None,
    *,
    device: str | None = None,
    method: str = "auto",
    tolerance: float | None = None,
    told: list[Told] | None = None,
) -> NDArray[np.float32] | cl_array.Array:
    """Blur an image by a map of signed blur radii, each pixel by its own PSF.

    image: linear light, (rows, columns) or (rows, columns, channels), up to 16 channels; coc: signed R in px, (rows,
    columns), positive behind the focal surface; psf: keys of the scene file's [psf]; device: part of an OpenCL
    device's name; method: "auto", "gather", "scatter", "convolve" (one radius) or an approximation
    (`clsco.coarsening.METHODS`); tolerance: RMS error of white up to which an approximation may be taken where it is
    faster, None for the exact blur; told: gets an entry of which it was and its measured error. NumPy arrays, or
    pyopencl arrays of one queue, which is then worked in. With occlusion = "layered" smaller signed radii, which are
    nearer, hide larger ones where the map jumps (`clsco.layers.Layers`); with any other nothing hides anything.
    Returns float32 of the image's shape, as NumPy or pyopencl array as given. Nothing is known outside of the image,
    so with border = "lose" it darkens where light leaves it; sources have their pixel's center, and the gradient for
    `tilt` comes from differences of `coc`. Raises ImageError, SceneError, DeviceError.
    Validated against `clsco.reference.blur.scatter` and `clsco.reference.layer.layered` to 1e-5
    (tests/test_defocus.py). Equation 2.40.
    """
    model = psf if isinstance(psf, Psf) else parse_psf(psf or {})
    on_device = [a for a in (image, coc) if isinstance(a, cl_array.Array)]
    if on_device:
        queue = on_device[0].queue
        if queue is None:
            raise DeviceError("image: a pyopencl array must have a queue; got one without")
        host = [a.get(queue) if isinstance(a, cl_array.Array) else a for a in (image, coc)]
        return cl_array.to_device(
            queue, _defocus(_session_of(queue), *_checked(*host), model, (method, tolerance), told)
        )
    return _defocus(_session(choose(device)), *_checked(image, coc), model, (method, tolerance), told)


def _checked(image: Any, coc: Any) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    picture, radii = np.asarray(image), np.asarray(coc)
    if picture.ndim not in (2, 3) or 0 in picture.shape or (picture.ndim == 3 and picture.shape[2] > MOST_CHANNELS):
        raise ImageError(
            f"image: must have the shape (rows, columns) or (rows, columns, 1 to {MOST_CHANNELS}); got {picture.shape}"
        )
    if radii.shape != picture.shape[:2]:
        raise ImageError(f"coc: must have the rows and columns of the image, {picture.shape[:2]}; got {radii.shape}")
    for name, array in (("image", picture), ("coc", radii)):
        if array.dtype.kind not in "fiu":
            raise ImageError(f"{name}: must hold real numbers; got {array.dtype}")
        if not np.isfinite(array).all():
            raise ImageError(f"{name}: must be finite; got {int((~np.isfinite(array)).sum())} values that are not")
    if picture.dtype.kind != "f":
        raise ImageError(f"image: must be linear light in floats; got {picture.dtype}")
    largest = float(np.abs(radii).max())
    if largest > LARGEST_BLUR:
        raise ImageError(f"coc: radii must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
    return picture.astype(np.float32, copy=False), radii.astype(np.float64)


# A context and its built programs, kept because they take longer than a small image does.
@lru_cache(maxsize=4)
def _session(device: Device) -> Session:
    return Session(device)


@lru_cache(maxsize=4)
def _session_of(queue: cl.CommandQueue) -> Session:
    return Session(described(queue.device), queue=queue)


def _choose(psf: Psf, method: str, smallest: float, largest: float) -> Blur:
    known = ("auto", "gather", "scatter", "convolve", *METHODS)
    if method not in known:
        raise SceneError(f"method: must be one of {', '.join(known)}; got {method}")
    constant = smallest == largest and psf.border == "lose"
    if method == "convolve" and not constant:
        raise SceneError('method: convolve needs one radius for all pixels and border = "lose"; got many radii')
    check_border(psf, method)
    if is_sharp(psf, largest) and (method == "auto" or method in METHODS):
        return "none"
    if method == "auto":
        return "convolve" if constant else "gather"
    return "scatter" if method == "scatter" else "convolve" if method == "convolve" else "gather"


def _defocus(
    session: Session, image: NDArray[np.float32], coc: NDArray[np.float64], psf: Psf,
    method: tuple[str, float | None], told: list[Told] | None,
) -> NDArray[np.float32]:  # fmt: skip
    """By the method, or the first one that is within the tolerance."""
    name, tolerance = method
    size = np.abs(coc)
    smallest, largest = float(size.min()), float(size.max())
    tried: tuple[tuple[str, float], ...] = ()
    names = [name]
    if tolerance is not None and checked_tolerance(tolerance, name):
        names = [*(() if _choose(psf, name, smallest, largest) == "none" else candidates(psf, size)), name]
    for each in names:
        places = sample_places(*coc.shape) if each in METHODS and (told is not None or tolerance is not None) else None
        blur = _choose(psf, each, smallest, largest)
        result, missed = _blurred(session, image, coc, psf, blur, METHODS.get(each), places)
        rms, at_most = (0.0, 0.0) if missed is None else estimate(missed)
        if each not in METHODS or tolerance is None or at_most <= tolerance:
            break
        tried += ((each, at_most),)
    if told is not None and (each in METHODS or tolerance is not None):
        label, count = (each, 0 if missed is None else len(missed)) if each in METHODS else ("exact", 0)
        told.append(Told(label, tolerance, rms, at_most, count, tried))
    return result


def _blurred(
    session: Session, image: NDArray[np.float32], coc: NDArray[np.float64], psf: Psf, blur: Blur, least: float | None,
    places: NDArray[np.int32] | None,
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:  # fmt: skip
    """The image, and its error at places; least: of an approximation, None for the exact way."""
    if blur == "none":
        return image.copy(), None
    rows, columns = coc.shape
    channels = image.shape[2] if image.ndim == 3 else 1
    size = np.abs(coc)
    smallest, largest = float(size.min()), float(size.max())
    real: Real = "double" if session.device.has_fp64 else "float"
    guard = 0
    if blur == "convolve":
        guard = reach(psf, largest) + 2 * LANES
    camera: Struct = frame_struct(rows, columns, guard, real)
    features = PLAIN | blur_features(blur, psf, largest, real, prepare=True)
    features |= {
        "CHANNELS": channels,
        "TILT": int(psf.tilt and blur != "convolve"),
        "SAMPLED": int(psf.edge == "sampled"),
        "POWERS": 1 if psf.edge == "sampled" and psf.model == "pillbox" else 4,
    }
    program = build(session, ["blur.cl"], features, structs(real), real)
    brightest = float(np.abs(image).max())
    spreader = make_spreader(
        session, program, psf, blur, camera, channels, smallest, largest, 0, real, brightest, features, least, places
    )
    padded = np.pad(flat(image, np.float32), ((0, 0), (guard, guard), (guard, guard)))
    value = upload(session, padded) if psf.border == "lose" else _writable(session, padded)
    spreader.clear()
    if blur == "convolve":
        spreader.add(Sources(None, value), largest, [])
    else:
        radii = upload(session, in_parts(coc, real))
        valid = upload(session, np.ones((rows, columns), np.uint8))
        if psf.occlusion == "layered":
            layers = Layers(session, spreader, features, largest, real, brightest)
            layers.add(value, radii, valid, [])
        else:
            source = empty(session, 16 * rows * columns)
            args = (camera, spreader.struct, radii, valid, source)
            launch(session, kernel(program, "prepare_sources"), (columns, rows), PIXELS, *args)
            spreader.add(Sources(source, value), 0.0, [])
    found = spreader.image([])
    missed = spreader.missed() if isinstance(spreader, Coarse) and places is not None else None
    return (found if image.ndim == 2 or channels > 1 else found[..., None]), missed


def _writable(session: Session, array: NDArray[np.float32]) -> cl.Buffer:
    buffer = empty(session, array.nbytes)
    cl.enqueue_copy(session.queue, buffer, array)
    return buffer
