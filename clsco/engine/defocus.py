"""Defocus of one image by its map of blur radii."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict, Unpack, get_args, overload

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY, TAP_LANES
from clsco.engine.shrinking import Shrinking
from clsco.engine.workspace import BlurWorkspace, shared_buffers
from clsco.errors import ArgumentError, SceneError
from clsco.files.transfer import decode_channels, encode_channels, has_alpha
from clsco.frame.strips import Strip
from clsco.inputs.pupils import load_point_spread
from clsco.inputs.soft_edges import LEAST_STEEPEST, assign_soft_edges, steepest_step
from clsco.opencl.arrays import check_image, on_host, without_mask
from clsco.opencl.session import DeviceLike, Session
from clsco.optics.lens import LARGEST_BLUR
from clsco.optics.point_spread import GREEN, PointSpread, exposure_factor, spreads_of_colors
from clsco.optics.resolved_view import guard_band
from clsco.optics.waves import check_waves
from clsco.passes.blur import Image, Maps, Sources
from clsco.passes.job import Job
from clsco.passes.pack import grid_struct
from clsco.passes.static_image import HostImage
from clsco.passes.tables import forget_others
from clsco.plan.device import DeviceFacts
from clsco.plan.image import ImagePlan
from clsco.plan.memory import Limit, device_bytes, fit_strips, limit_of
from clsco.plan.methods import BlurSpec, choose_blur
from clsco.plan.passes import Pass
from clsco.records import REAL, Real, Struct
from clsco.scene.file import ApertureLike, CameraLike, PsfLike, aperture_of, camera_of, psf_of
from clsco.scene.model import Psf

Outside = Literal["mirror", "black"]
SoftEdges = Literal["assign", "keep"]


class Options(TypedDict, total=False):
    """Options of `defocus`."""

    aperture: ApertureLike
    camera: CameraLike
    device: DeviceLike
    method: str
    memory: str | int | None
    outside: Outside
    soft_edges: SoftEdges


@overload
def defocus(
    image: NDArray[Any], blur_radius: NDArray[Any], psf: PsfLike = None, *, return_report: Literal[False] = False,
    **options: Unpack[Options],
) -> NDArray[Any]: ...  # fmt: skip
@overload
def defocus(
    image: NDArray[Any], blur_radius: NDArray[Any], psf: PsfLike = None, *, return_report: Literal[True],
    **options: Unpack[Options],
) -> tuple[NDArray[Any], DefocusReport]: ...  # fmt: skip
@overload
def defocus(
    image: cl_array.Array, blur_radius: cl_array.Array, psf: PsfLike = None, *, return_report: Literal[False] = False,
    **options: Unpack[Options],
) -> cl_array.Array: ...  # fmt: skip
@overload
def defocus(
    image: cl_array.Array, blur_radius: cl_array.Array, psf: PsfLike = None, *, return_report: Literal[True],
    **options: Unpack[Options],
) -> tuple[cl_array.Array, DefocusReport]: ...  # fmt: skip
def defocus(  # noqa: PLR0913, a parameter for each option
    image: NDArray[Any] | cl_array.Array,
    blur_radius: NDArray[Any] | cl_array.Array,
    psf: PsfLike = None,
    *,
    return_report: bool = False,
    aperture: ApertureLike = None,
    camera: CameraLike = None,
    device: DeviceLike = None,
    method: str = "auto",
    memory: str | int | None = None,
    outside: Outside = "mirror",
    soft_edges: SoftEdges = "assign",
) -> Any:
    """Blur an image by a map of signed blur radii, each pixel by its own PSF (equation 2.40).

    Parameters
    ----------
    image : array (rows, columns) or (rows, columns, 1 to 16)
        Linear radiance as floats, or sRGB codes as uint8 or uint16, which are decoded, blurred and encoded again. If
        codes have 2 or 4 channels, the last one is alpha: it is linear, and colors should be premultiplied by it. All
        arrays are NumPy arrays, or pyopencl arrays of one queue, which are copied through the host.
    blur_radius : array (rows, columns), px
        Signed R, at most 512 px, positive behind the focal surface.
    psf : Psf, mapping or str, optional
        Keys of the scene file's [psf] with their values, or its `model` alone: "pillbox", "gaussian" or "wave".
        Occlusion is "layered" or "none"; by default layered.
    aperture : Aperture, mapping or str, optional
        Keys of the scene file's [aperture] with their values, or its `shape` alone; by default a circle.
    camera : Camera or mapping, optional
        Keys of the scene file's [camera] with their values. Required only for psf.model = "wave" and aberrations, which
        depend on the f-number and the pixel pitch.
    device : str, pyopencl.Device, Context or CommandQueue, optional
        Part of a device's name, "cpu" or "gpu", or a pyopencl object to work with. By default the queue of pyopencl
        arrays.
    method : str
        "auto", the default; "gather", "scatter" or "tiles"; or "convolve" if all pixels have one radius.
    memory : int or str, optional
        Limit of the buffers on the device, in bytes or like "1.5GiB"; by default half of the processor's free memory,
        or of a GPU's memory.
    outside : {"mirror", "black"}
        Light from beyond the image's border: by default that of the mirror image, so that uniform radiance stays
        uniform; "black" darkens the border. With psf.border = "renormalize" no such light is added.
    soft_edges : {"assign", "keep"}
        Treatment of pixels at the edge between two surfaces whose radius lies between those of the surfaces, as in
        averaged or blurred depth maps: by default each pixel is assigned to one of the surfaces; "keep" leaves the
        radii as they are.
    return_report : bool
        Also return a `DefocusReport`.

    Returns
    -------
    array of the image's shape
        float32, or codes of the image's dtype; a NumPy or pyopencl array, like `image`.
    DefocusReport
        Only with `return_report`.

    Raises
    ------
    ArgumentError
        An array is invalid, such as one with masked or infinite values.
    SceneError
        Another argument is invalid, such as occlusion = "visibility".
    DeviceError
        The device does not exist, or fails.

    Notes
    -----
    The result equals the frame of a scene with one static depth map with unit = "coc", and the output of `clsco
    defocus`. Sources are at pixel centers, and the gradient for `tilt` comes from differences of `blur_radius`. With
    occlusion = "layered", pixels with smaller signed radii are nearer, and hide others at depth discontinuities. An
    image that needs more than `memory` is blurred in horizontal strips, with the same bits.
    Validated against `clsco.reference.blur.blur.scatter` and `clsco.reference.layered.layered.layered` to 1e-5.

    Examples
    --------
    >>> import clsco
    >>> import numpy as np
    >>> image, blur_radius = np.zeros((24, 32), np.float32), np.full((24, 32), 3.0)
    >>> image[12, 16] = 1.0
    >>> blurred = clsco.defocus(image, blur_radius)
    >>> bool(abs(blurred[12, 16] - 1 / (np.pi * 3.0**2)) < 1e-4), round(float(blurred.sum()), 4)
    (True, 1.0)
    """
    for name, value, kinds in (("outside", outside, Outside), ("soft_edges", soft_edges, SoftEdges)):
        if value not in get_args(kinds):
            names = " or ".join(f'"{kind}"' for kind in get_args(kinds))
            raise SceneError(f"{name}: must be {names}; got {value!r}")
    model = psf_of(psf).of_images()
    opening, lens_camera = aperture_of(aperture, model), camera_of(camera)
    session, (picture, radii), as_given = on_host(device, image=image, blur_radius=blur_radius)
    picture, radii = without_mask("image", picture), without_mask("blur_radius", radii)
    if lens_camera is not None and picture.ndim > 1:
        lens_camera = lens_camera.model_copy(update={"resolution": picture.shape[1::-1]})
    spread = load_point_spread(model, opening, camera=lens_camera)
    spreads = spreads_of_colors(spread, model, lens_camera)
    codes = picture.dtype in (np.uint8, np.uint16)
    linear = decode_channels(picture, "srgb").astype(np.float32) if codes else picture
    if opening.exposure == "area":
        light = np.full(linear.shape[2:], exposure_factor(opening, spread), np.float32)
        if codes and has_alpha(linear):
            light[-1] = 1.0
        linear = linear * light
    inputs = _check_inputs(linear, radii, outside == "mirror" and model.border == "lose")
    inputs, soft = _assign_edges(inputs) if soft_edges == "assign" and inputs.steepest >= LEAST_STEEPEST else (inputs, 0)
    with session.reporting():
        limit = limit_of(memory, session.device)
        if limit.set_by_user:
            forget_others(session)
        parts: Iterable[tuple[_Inputs, PointSpread]] = [(inputs, spreads[GREEN])]
        separate = inputs.channels == len(spreads) and len(set(spreads)) > 1
        if separate:  # each color is blurred by itself
            colors = (replace(inputs, image=np.ascontiguousarray(color)) for color in np.moveaxis(inputs.image, -1, 0))
            parts = zip(colors, spreads, strict=True)
        results = [
            _blur_image(session, part, _spec(part, color_psf, model, method, session.device), limit)
            for part, color_psf in parts
        ]
        result = np.stack(results, axis=-1) if separate else results[0]
        blurred = as_given(encode_channels(result, 8 * picture.dtype.itemsize, "srgb") if codes else result)
    return (blurred, DefocusReport(soft)) if return_report else blurred


@dataclass(frozen=True)
class DefocusReport:
    """Report on the blurring of an image."""

    soft_edges: int  # pixels at the edge between two surfaces whose radius was assigned to one of them


@dataclass(frozen=True)
class _Inputs:
    """An image (rows, columns[, channels]), its map of signed radii, and properties of both.

    smallest, largest: range of |R|, px; steepest: largest step of R between neighbors, px; brightest: largest |radiance|;
    mirrored: True if image and radii continue as mirror images beyond the border.
    """

    image: NDArray[Any]
    coc: NDArray[Any]
    smallest: float
    largest: float
    steepest: float
    brightest: float
    mirrored: bool

    @property
    def channels(self) -> int:
        return int(self.image.shape[2]) if self.image.ndim == 3 else 1


def _check_inputs(picture: NDArray[Any], radii: NDArray[Any], mirrored: bool) -> _Inputs:
    check_image(picture)
    if radii.shape != picture.shape[:2]:
        rule = f"must have the rows and columns of the image, {picture.shape[:2]}"
        raise ArgumentError(f"blur_radius: {rule}; got {radii.shape}")
    ends = []
    for name, array in (("image", picture), ("blur_radius", radii)):
        if array.dtype.kind not in "fiu":
            raise ArgumentError(f"{name}: must hold real numbers; got {array.dtype}")
        ends.append((float(array.min()), float(array.max())))  # not finite if a value is not; needs no mask
        if not np.isfinite(ends[-1]).all():
            raise ArgumentError(f"{name}: must be finite; got {int((~np.isfinite(array)).sum())} values that are not")
    if picture.dtype.kind != "f":
        raise ArgumentError(f"image: must be floats, uint8 or uint16; got {picture.dtype}")
    brightest, largest = (max(abs(low), abs(high)) for low, high in ends)
    if largest > LARGEST_BLUR:
        raise ArgumentError(f"blur_radius: must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
    low, high = ends[1]
    smallest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))  # 0: lower bound without a search
    steepest = 0.0 if low == high else steepest_step(radii.astype(np.float64) if radii.dtype.kind != "f" else radii)
    return _Inputs(picture, radii, smallest, largest, steepest, float(np.float32(brightest)), mirrored)


def _assign_edges(inputs: _Inputs) -> tuple[_Inputs, int]:
    """Assign pixels with a radius between those of two surfaces to one of them; also returns their number."""
    coc_floats = inputs.coc if inputs.coc.dtype in (np.float32, np.float64) else inputs.coc.astype(np.float64)
    pixels, radii = assign_soft_edges(coc_floats, None, lambda: inputs.image)
    if not len(pixels):
        return inputs, 0
    coc = inputs.coc.astype(np.float64)
    coc.flat[pixels] = radii
    coc = coc.astype(np.promote_types(inputs.coc.dtype, np.float16), copy=False)
    return replace(inputs, coc=coc, steepest=steepest_step(coc)), len(pixels)


def _spec(inputs: _Inputs, psf: PointSpread, model: Psf, method: str, device: DeviceFacts) -> BlurSpec:
    check_waves(psf, inputs.largest)
    one_radius = inputs.smallest == inputs.largest and model.border == "lose"
    blur = choose_blur(method, psf, device, inputs.largest, inputs.channels, one_radius).value
    layered = model.occlusion == "layered" and blur != "convolve" and inputs.steepest > DISCONTINUITY
    return BlurSpec(
        psf, blur, inputs.smallest, inputs.largest, tilt=model.tilt, brightest=inputs.brightest, border=model.border,
        layered=layered,
    )  # fmt: skip


def _blur_image(session: Session, inputs: _Inputs, spec: BlurSpec, limit: Limit) -> NDArray[np.float32]:
    """Blur the image in as few strips as the memory limit allows."""
    if spec.method == "none":
        return inputs.image.astype(np.float32)
    lanes, guard = 2 * TAP_LANES if spec.method == "convolve" else 0, 0
    if inputs.mirrored or spec.layered:  # sheets go on beyond the border, with coverage 0 where it is black
        guard = guard_band(spec.psf, spec.border, inputs.largest)
    elif lanes:
        guard = spec.psf.reach(inputs.largest)
    rows, columns = inputs.coc.shape
    plan = ImagePlan(spec, session.device, rows, columns, inputs.channels, guard + lanes)
    memory = Shrinking(session, limit, lambda smaller: fit_strips(plan, smaller), device_bytes)
    return memory.run(lambda fitting: _blur_strips(session, inputs, fitting))


def _blur_strips(session: Session, inputs: _Inputs, plan: ImagePlan) -> NDArray[np.float32]:
    """Blur the image in the strips of a plan."""
    spec, shape = plan.spec, inputs.image.shape if plan.channels > 1 else inputs.coc.shape
    real: Real = "double" if session.device.has_fp64 else "float"
    # If the image is blurred in one strip, kernels read the caller's arrays, unless they would write to them.
    lends = len(plan.strips) == 1 and not plan.guard_px and spec.border == "lose"
    floats = lends and not spec.layered and np.can_cast(inputs.coc.dtype, np.float32)
    buffers = shared_buffers(session, plan, ("value", "coc", "valid") if floats else ("value", "coc") if lends else ())
    grids = (grid_struct(plan.rows, plan.columns, plan.guard_px, real, strip) for strip in plan.strips)
    jobs = [Job(strip=s, grid=grid, events=[]) for s, grid in zip(plan.strips, grids, strict=True)]
    space = _ImageWorkspace(session, inputs, plan, jobs[0].grid, buffers, real, floats)
    bounds = space.find_layers(plan.passes, jobs) if len(jobs) > 1 else ()
    out = np.empty(shape, np.float32)
    for job in jobs:
        outputs = space.run(plan.passes, replace(job, bounds=bounds or None))  # keeps lent arrays alive
        outputs["plane"].read(session, out[job.strip.inside])
    return out.reshape(inputs.image.shape)


class _Source(HostImage):
    """Supplies strips of the image and of its radii; dtype: type of the radii on the device."""

    def __init__(self, session: Session, inputs: _Inputs, plan: ImagePlan, dtype: Any) -> None:
        super().__init__(session, inputs.image, plan.guard_px, "symmetric" if inputs.mirrored else "constant")
        self.inputs, self.dtype, self.one_radius = inputs, dtype, plan.spec.method == "convolve"

    def radii(self, strip: Strip) -> dict[str, NDArray[Any]]:
        if self.one_radius:
            return {}
        planes = {"coc": self._around(self.inputs.coc, strip).astype(self.dtype, "C", copy=False)}
        if self.guard and not self.inputs.mirrored:
            planes["valid"] = self._around(np.ones(self.inputs.coc.shape, np.uint8), strip)
        return planes


class _ImageWorkspace(BlurWorkspace):
    """Runs all passes of an image with its map of radii."""

    def __init__(
        self, session: Session, inputs: _Inputs, plan: ImagePlan, grid: Struct, buffers: Mapping[str, cl.Buffer],
        real: Real, floats: bool,
    ) -> None:  # fmt: skip
        maps: Maps = "float" if floats else "wide"
        super().__init__(session, buffers, plan.spec, plan.grid, grid, real, maps)
        self.source = _Source(session, inputs, plan, np.float32 if floats else REAL[real])
        if "valid" in buffers:
            cl.enqueue_fill_buffer(session.queue, buffers["valid"], np.ones(1, np.uint8), 0, buffers["valid"].size)

    def static_image(self, job: Job, _: Pass) -> tuple[Image | Sources]:
        image, inputs = self.source.image(job, self.buffers), self.source.inputs
        return (Sources(None, image.value, radius=inputs.largest) if self.source.one_radius else image,)
