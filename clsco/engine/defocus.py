"""Defocus of one image by its map of blur radii."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf
from typing import Any, Literal, TypedDict, Unpack, get_args, overload

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY, FUSED, TAP_LANES
from clsco.engine.checks import check_layer, layer_arrays
from clsco.engine.shrinking import Shrinking
from clsco.engine.workspace import BlurWorkspace, shared_buffers
from clsco.errors import SceneError
from clsco.files.transfer import decode_channels, encode_channels, has_alpha
from clsco.frame.strips import Strip
from clsco.inputs.pupils import load_point_spread
from clsco.inputs.soft_edges import LEAST_STEEPEST, assign_soft_edges, steepest_step
from clsco.opencl.arrays import on_host, without_mask
from clsco.opencl.buffers import allocate
from clsco.opencl.session import DeviceLike, Session
from clsco.optics.point_spread import GREEN, PointSpread, exposure_factor, spreads_of_colors
from clsco.optics.resolved_view import guard_band
from clsco.optics.waves import check_waves
from clsco.passes.blur import Image, Maps, Sources
from clsco.passes.job import Job
from clsco.passes.pack import grid_struct
from clsco.passes.static_image import HostImage
from clsco.passes.tables import forget_others
from clsco.plan.buffers import image_buffers
from clsco.plan.device import DeviceFacts
from clsco.plan.image import ImagePlan
from clsco.plan.memory import Limit, device_bytes, fit_strips, limit_of
from clsco.plan.methods import BlurSpec, choose_blur, lens_cells
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
    cells: int | None
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
@overload
def defocus(
    *, layers: Sequence[tuple[NDArray[Any], NDArray[Any]]], psf: PsfLike = None, return_report: Literal[False] = False,
    **options: Unpack[Options],
) -> NDArray[Any]: ...  # fmt: skip
@overload
def defocus(
    *, layers: Sequence[tuple[NDArray[Any], NDArray[Any]]], psf: PsfLike = None, return_report: Literal[True],
    **options: Unpack[Options],
) -> tuple[NDArray[Any], DefocusReport]: ...  # fmt: skip
def defocus(  # noqa: PLR0913, a parameter for each option
    image: NDArray[Any] | cl_array.Array | None = None,
    blur_radius: NDArray[Any] | cl_array.Array | None = None,
    psf: PsfLike = None,
    *,
    layers: Sequence[tuple[NDArray[Any], NDArray[Any]]] = (),
    return_report: bool = False,
    aperture: ApertureLike = None,
    camera: CameraLike = None,
    cells: int | None = None,
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
    layers : sequence of (array (rows, columns, 2 to 16), array (rows, columns)), optional
        Instead of `image` and `blur_radius`, 1 to 8 images that lie over each other, such as a foreground and
        what is behind it, each with its radii. Linear floats, the last channel is alpha from 0 to 1, by which the
        others are multiplied. Where alpha is 0, the radius does not matter. Any order: radii say what is in front; of
        equal ones, the first layer is.
    psf : Psf, mapping or str, optional
        Keys of the scene file's [psf] with their values, or its `model` alone: "pillbox", "gaussian" or "wave".
        Occlusion is "layered" or "none"; by default layered.
    aperture : Aperture, mapping or str, optional
        Keys of the scene file's [aperture] with their values, or its `shape` alone; by default a circle.
    camera : Camera or mapping, optional
        Keys of the scene file's [camera] with their values. Required only for psf.model = "wave" and aberrations, which
        depend on the f-number and the pixel pitch.
    cells : int, optional
        For layered occlusion, cells of the lens along each axis, which near surfaces hide one by one: 1 or 2. By
        default 2 for several layers, and |R| above 6 px, except with aperture.rim and psf.border = "renormalize".
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
        float32, or codes of the image's dtype; a NumPy or pyopencl array, like `image`. For layers, with alpha, which
        is 1 where the last one is opaque.
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
            rule = " or ".join(f'"{kind}"' for kind in get_args(kinds))
            raise SceneError(f"{name}: must be {rule}; got {value!r}")
    model = psf_of(psf).of_images()
    opening, lens_camera = aperture_of(aperture, model), camera_of(camera)
    names, arrays = layer_arrays(image, blur_radius, layers)
    if layers and model.occlusion == "none":
        raise SceneError('psf.occlusion: must be "layered" for layers; got "none"')
    session, arrays, as_given = on_host(device, **dict(zip(names, arrays, strict=True)))
    arrays = [without_mask(*pair) for pair in zip(names, arrays, strict=True)]
    picture = arrays[0]
    if lens_camera is not None and picture.ndim > 1:
        lens_camera = lens_camera.model_copy(update={"resolution": picture.shape[1::-1]})
    spread = load_point_spread(model, opening, camera=lens_camera)
    spreads = spreads_of_colors(spread, model, lens_camera)
    codes = picture.dtype in (np.uint8, np.uint16) and not layers
    factor = exposure_factor(opening, spread) if opening.exposure == "area" else None
    each = []
    for name, picture, radii in zip(names[::2], arrays[::2], arrays[1::2], strict=True):
        linear = decode_channels(picture, "srgb").astype(np.float32) if codes else picture
        radii = _visible_radii(linear, radii) if layers else radii
        check_layer(name.removesuffix("image"), linear, radii, arrays[0].shape, alpha=bool(layers))
        if factor is not None:
            linear = linear * _shares(linear, factor, alpha=bool(layers) or (codes and has_alpha(linear)))
        each.append(_Layer(linear, radii, alpha=bool(layers)))
    each, soft = _assign_edges(each) if soft_edges == "assign" else (each, 0)
    inputs = _Inputs(_near_to_far(each), outside == "mirror" and model.border == "lose")
    with session.reporting():
        limit = limit_of(memory, session.device)
        if limit.set_by_user:
            forget_others(session)
        parts: Iterable[tuple[_Inputs, PointSpread]] = [(inputs, spreads[GREEN])]
        separate = inputs.channels == len(spreads) and len(set(spreads)) > 1
        if separate:  # each color is blurred by itself
            parts = ((inputs.of_color(color), color_psf) for color, color_psf in enumerate(spreads))
        results = [
            _blur_image(session, part, _spec(part, color_psf, model, method, session.device, cells), limit)
            for part, color_psf in parts
        ]
        result = _joined(results, alpha=bool(layers)) if separate else results[0]
        blurred = as_given(encode_channels(result, 8 * arrays[0].dtype.itemsize, "srgb") if codes else result)
    return (blurred, DefocusReport(soft)) if return_report else blurred


@dataclass(frozen=True)
class DefocusReport:
    """Report on the blurring of an image."""

    soft_edges: int  # pixels at the edge between two surfaces whose radius was assigned to one of them


@dataclass(frozen=True)
class _Layer:
    """An image (rows, columns[, channels]), the last channel of which may be alpha, and its map of signed radii."""

    image: NDArray[Any]
    coc: NDArray[Any]
    alpha: bool

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Mask (rows, columns) of the pixels with a surface."""
        return np.asarray(self.image[..., -1] > 0) if self.alpha else np.ones(self.coc.shape, np.bool_)

    @cached_property
    def steepest(self) -> float:
        """Largest step of R between neighbors, px."""
        return steepest_step(self.coc if self.coc.dtype.kind == "f" else self.coc.astype(np.float64))

    def continues_in(self, other: _Layer) -> bool:
        """True if both are parts of one picture: their radii differ by at most FUSED px in pixels that both cover, and
        in most pairs of neighbors.
        """
        here, there = (np.where(each.covered, each.coc.astype(np.float64), np.nan) for each in (self, other))
        steps = []
        for one, two in ((here, there), (there, here)):
            steps += [np.abs(one[:-1] - two[1:]).ravel(), np.abs(one[:, :-1] - two[:, 1:]).ravel()]
        between = np.concatenate(steps)
        between = between[~np.isnan(between)]
        overlapping = np.abs(here - there)[self.covered & other.covered]
        return bool(overlapping.max(initial=0.0) <= FUSED and between.size and np.median(between) <= FUSED)

    def mean_radius(self) -> float:
        """Mean R of what is covered, px; 0 for one image."""
        return float(np.average(self.coc, weights=self.image[..., -1])) if self.alpha and self.covered.any() else 0.0


@dataclass(frozen=True)
class _Inputs:
    """Images with their radii, and properties of all of them.

    layers: one image without alpha, or images with alpha from near to far; mirrored: True if they continue as mirror
    images beyond the border.
    """

    layers: tuple[_Layer, ...]
    mirrored: bool

    @property
    def channels(self) -> int:
        image = self.layers[0].image
        return int(image.shape[2]) if image.ndim == 3 else 1

    @property
    def images(self) -> int:
        """Number of images with alpha."""
        return len(self.layers) if self.layers[0].alpha else 0

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest |R|, px; 0 as the smallest is a lower bound without a search."""
        low, high = min(float(each.coc.min()) for each in self.layers), max(float(e.coc.max()) for e in self.layers)
        return 0.0 if low <= 0.0 <= high else min(abs(low), abs(high)), max(abs(low), abs(high))

    @property
    def brightest(self) -> float:
        """Largest |radiance|."""
        most = max(max(abs(float(each.image.max())), abs(float(each.image.min()))) for each in self.layers)
        return float(np.float32(most))

    def of_color(self, color: int) -> _Inputs:
        """One color of the images, with their alpha."""
        chosen = [color, -1] if self.images else color
        return replace(
            self, layers=tuple(replace(e, image=np.ascontiguousarray(e.image[..., chosen])) for e in self.layers)
        )


def _visible_radii(image: NDArray[Any], radii: NDArray[Any]) -> NDArray[Any]:
    """Radii with 0 where alpha is 0."""
    fits = image.ndim == 3 and radii.shape == image.shape[:2]
    return np.where(image[..., -1] > 0, radii, radii.dtype.type(0)) if fits else radii


def _shares(linear: NDArray[Any], factor: float, alpha: bool) -> NDArray[np.float32]:
    """Factor of each channel; alpha: True if the last one is alpha, which stays."""
    shares = np.full(linear.shape[2:], factor, np.float32)
    if alpha:
        shares[-1] = 1.0
    return shares


def _joined(results: list[NDArray[np.float32]], alpha: bool) -> NDArray[np.float32]:
    """The blurred colors as channels of one image; alpha, if each color has it, is that of green."""
    if not alpha:
        return np.stack(results, axis=-1)
    return np.concatenate([*(result[..., :1] for result in results), results[GREEN][..., 1:]], axis=-1)


def _near_to_far(layers: list[_Layer]) -> tuple[_Layer, ...]:
    """Layers from near to far; parts of one picture become one layer."""
    joined: list[_Layer] = []
    for layer in sorted(layers, key=_Layer.mean_radius):
        if joined and joined[-1].continues_in(layer):
            near = joined.pop()
            image = near.image + (1.0 - near.image[..., -1:]) * layer.image
            layer = _Layer(image, np.where(near.covered, near.coc, layer.coc), alpha=True)
        joined.append(layer)
    return tuple(joined)


def _assign_edges(layers: list[_Layer]) -> tuple[list[_Layer], int]:
    """Assign pixels with a radius between those of two surfaces to one of them; also returns their number."""
    new, count = [], 0
    for layer in layers:
        pixels = np.zeros(0, np.intp)
        if layer.steepest >= LEAST_STEEPEST:
            coc = layer.coc if layer.coc.dtype in (np.float32, np.float64) else layer.coc.astype(np.float64)
            coc = np.where(layer.covered, coc, np.nan) if layer.alpha else coc
            pixels, radii = assign_soft_edges(coc, None, partial(np.asarray, layer.image))
        if len(pixels):
            assigned = layer.coc.astype(np.float64)
            assigned.flat[pixels] = radii
            kind = np.promote_types(layer.coc.dtype, np.float16)
            layer = replace(layer, coc=assigned.astype(kind, copy=False))
        new.append(layer)
        count += len(pixels)
    return new, count


def _spec(
    inputs: _Inputs, psf: PointSpread, model: Psf, method: str, device: DeviceFacts, cells: int | None
) -> BlurSpec:  # fmt: skip
    smallest, largest = inputs.ends
    check_waves(psf, largest)
    one_radius = smallest == largest and model.border == "lose" and not inputs.images
    # Images that lie over each other are blurred even if all is in focus.
    most = max(largest, 1.0) if inputs.images else largest
    blur = choose_blur(method, psf, device, most, inputs.channels, one_radius).value
    layered = model.occlusion == "layered" and blur != "convolve" and inputs.layers[0].steepest > DISCONTINUITY
    layered, widest = layered or inputs.images > 0, inf if inputs.images else largest
    cells = lens_cells(psf, blur, model.border, widest, cells)
    return BlurSpec(
        psf, blur, smallest, largest, tilt=model.tilt, brightest=inputs.brightest, border=model.border,
        layered=layered, cells=cells if layered else 1, images=inputs.images,
    )  # fmt: skip


def _blur_image(session: Session, inputs: _Inputs, spec: BlurSpec, limit: Limit) -> NDArray[np.float32]:
    """Blur the image in as few strips as the memory limit allows."""
    if spec.method == "none":
        return inputs.layers[0].image.astype(np.float32)
    lanes, guard = 2 * TAP_LANES if spec.method == "convolve" else 0, 0
    if inputs.mirrored or spec.layered:  # sheets go on beyond the border, with coverage 0 where it is black
        guard = guard_band(spec.psf, spec.border, spec.largest)
    elif lanes:
        guard = spec.psf.reach(spec.largest)
    rows, columns = inputs.layers[0].coc.shape
    plan = ImagePlan(spec, session.device, rows, columns, inputs.channels, guard + lanes)
    memory = Shrinking(session, limit, lambda smaller: fit_strips(plan, smaller), device_bytes)
    return memory.run(lambda fitting: _blur_strips(session, inputs, fitting))


def _blur_strips(session: Session, inputs: _Inputs, plan: ImagePlan) -> NDArray[np.float32]:
    """Blur the image in the strips of a plan."""
    spec, first = plan.spec, inputs.layers[0]
    shape = first.image.shape if plan.channels > 1 else first.coc.shape
    real: Real = "double" if session.device.has_fp64 else "float"
    # If the image is blurred in one strip, kernels read the caller's arrays, unless they would write to them.
    lends = len(plan.strips) == 1 and not plan.guard_px and spec.border == "lose"
    floats = lends and not spec.layered and np.can_cast(first.coc.dtype, np.float32)
    buffers = shared_buffers(session, plan, ("value", "coc", "valid") if floats else ("value", "coc") if lends else ())
    grids = (grid_struct(plan.rows, plan.columns, plan.guard_px, real, strip) for strip in plan.strips)
    jobs = [Job(strip=s, grid=grid, events=[]) for s, grid in zip(plan.strips, grids, strict=True)]
    space = _ImageWorkspace(session, inputs, plan, jobs[0].grid, buffers, real, floats)
    bounds = space.find_layers(plan.passes, jobs) if len(jobs) > 1 else ()
    out = np.empty(shape, np.float32)
    for job in jobs:
        outputs = space.run(plan.passes, replace(job, bounds=bounds or None))  # keeps lent arrays alive
        outputs["plane"].read(session, out[job.strip.inside])
    return out.reshape(first.image.shape)


class _Source(HostImage):
    """Supplies strips of an image and of its radii; dtype: type of the radii on the device."""

    def __init__(self, session: Session, layer: _Layer, mirrored: bool, plan: ImagePlan, dtype: Any) -> None:
        super().__init__(session, layer.image, plan.guard_px, "symmetric" if mirrored else "constant")
        self.layer, self.dtype, self.one_radius = layer, dtype, plan.spec.method == "convolve"
        self.masked = layer.alpha or (plan.guard_px > 0 and not mirrored)

    def radii(self, strip: Strip) -> dict[str, NDArray[Any]]:
        if self.one_radius:
            return {}
        planes = {"coc": self._around(self.layer.coc, strip).astype(self.dtype, "C", copy=False)}
        if self.masked:
            planes["valid"] = self._around(self.layer.covered.view(np.uint8), strip)
        return planes


class _ImageWorkspace(BlurWorkspace):
    """Runs all passes of an image, or of several that lie over each other, with its map of radii."""

    def __init__(
        self, session: Session, inputs: _Inputs, plan: ImagePlan, grid: Struct, buffers: Mapping[str, cl.Buffer],
        real: Real, floats: bool,
    ) -> None:  # fmt: skip
        maps: Maps = "float" if floats else "wide"
        super().__init__(session, buffers, plan.spec, plan.grid, grid, real, maps)
        dtype = np.float32 if floats else REAL[real]
        self.uploads = [_Source(session, layer, inputs.mirrored, plan, dtype) for layer in inputs.layers]
        others = allocate(session, image_buffers(plan.spec, plan.grid))
        names = ("value", "coc", "valid")
        self.planes = [buffers, *({n: others[f"{n} {k}"] for n in names} for k in range(2, plan.spec.images + 1))]
        if "valid" in buffers:
            cl.enqueue_fill_buffer(session.queue, buffers["valid"], np.ones(1, np.uint8), 0, buffers["valid"].size)

    def static_image(self, job: Job, _: Pass) -> tuple[Image | Sources | tuple[Image, ...]]:
        images = tuple(source.image(job, planes) for source, planes in zip(self.uploads, self.planes, strict=True))
        if self.uploads[0].one_radius:
            return (Sources(None, images[0].value, radius=self.spec.largest),)
        return (images if self.spec.images else images[0],)
