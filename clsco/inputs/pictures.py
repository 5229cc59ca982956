"""Layers of pictures with depth, for `clsco.defocus`: linear colors with alpha, and signed blur radii."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.files.color import SRGB, Color
from clsco.files.decoders import decode_once
from clsco.files.images import Picture, check_sizes, image_size, read_rgba
from clsco.inputs.depth_files import read_depth
from clsco.inputs.depth_maps import FARTHEST, DepthValues, map_values
from clsco.inputs.focus import Focus, focus_scene, lens_line
from clsco.inputs.textures import radiance_of
from clsco.optics.lens import LARGEST_BLUR
from clsco.optics.lens_path import lens_at, reference_camera
from clsco.optics.rays import ray_slopes
from clsco.scene.arrays import LayerInput
from clsco.scene.model import Camera, DepthMap, Scene
from clsco.scene.quantities import MIN_LENGTH_MM

Layer = tuple[NDArray[np.float32], NDArray[np.float64]]
"""Premultiplied linear colors and alpha (rows, columns, 4), and signed R (rows, columns) in px."""

SECTIONS = ("title", "camera", "aperture", "psf", "image", "objects")  # parts of a scene that layers depend on
SAME = 1e-3  # largest relative difference between depths of the background
FAR = 1e10  # number that Blender stores for infinitely far


@dataclass(frozen=True, eq=False)
class PictureLayers:
    """Layers of a frame, extended beyond opposite borders by equal margins (rows, columns) of overscan.

    scene: the scene of the layers, focused. is_opaque: True if a layer has no transparent pixel. is_gray: True if no
    layer has color. bits: most per value of an image. notes: names of files, each with a line for the user.
    """

    layers: tuple[Layer, ...]
    scene: Scene
    margin: tuple[int, int]
    is_opaque: bool
    is_gray: bool
    bits: int
    color: Color
    notes: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class _Input:
    """A layer as read, with the margin of its frame. alpha: None if the image is opaque; numbers: those of its depth
    map; moved: number of pixels that have the depth of a covered one.
    """

    item: DepthMap
    picture: Picture
    alpha: NDArray[np.float32] | None
    numbers: NDArray[Any]
    moved: int = 0

    @property
    def covered(self) -> NDArray[np.bool_]:
        return np.ones(self.numbers.shape, np.bool_) if self.alpha is None else self.alpha > 0

    def depth_values(self, scene: Scene) -> DepthValues:
        """Depths of all pixels; infinite if none is covered."""
        if not self.covered.any():
            return DepthValues(np.full(self.numbers.shape, FARTHEST), {}, 0)
        return map_values(scene, self.item.model_copy(update={"soft_edges": "keep"}), self.numbers)

    def rgba(self, transfer: str, to_srgb: bool) -> NDArray[np.float32]:
        linear = radiance_of(self.picture, transfer, to_srgb=to_srgb)
        rgba = np.ones((*linear.shape[:2], 4), np.float32)
        rgba[..., :3] = linear if linear.ndim == 3 else linear[..., None]
        if self.alpha is not None:
            rgba[..., :3] *= 1.0 if self.picture.is_float else self.alpha[..., None]
            rgba[..., 3] = self.alpha
        return rgba


def load_layers(scene: Scene, focus: Focus | None = None, max_blur: float | None = None) -> PictureLayers:
    """Read the layers that the depth maps of a scene are.

    focus: target of the focus in place of the camera's. max_blur: limit in px to which larger |R| are clamped. Depths
    under alpha 0 are not used. Raises FileError as the readers and `inverse_depth` do; SceneError for sections that
    layers do not depend on, and as `focus_scene`.
    """
    plain = Scene.model_construct(objects=scene.objects)
    others = [key for key in Scene.model_fields if key not in SECTIONS and getattr(scene, key) != getattr(plain, key)]
    if others or scene.camera.moves:
        rule = "layers, sequences and a file of image and depth use the sections camera, aperture, psf and image alone"
        raise SceneError(f"defocus: {rule}; got {others[0] if others else 'camera.motion'}")
    items = [item for item in scene.objects if isinstance(item, DepthMap)]
    size = image_size(str(items[0].texture))
    with decode_once():
        inputs = _read_inputs(items, size)
    shape = inputs[0].numbers.shape
    margin = (shape[0] - size[1]) // 2, (shape[1] - size[0]) // 2
    inside = tuple(slice(more, length - more) for more, length in zip(margin, shape, strict=True))
    wide = scene.replace("camera.resolution", list(shape[::-1]))
    of_lens = any(item.unit == "coc" for item in items)
    pinhole = wide.camera.model_copy(update={"aperture_diameter": MIN_LENGTH_MM})  # so that no blur is too large

    def with_camera(camera: Camera) -> list[DepthValues]:
        return [each.depth_values(wide.model_copy(update={"camera": camera})) for each in inputs]

    values = with_camera(wide.camera if of_lens else pinhole)
    seen = [np.where(each.covered, v.inverse_depth, 0.0)[inside] for each, v in zip(inputs, values, strict=True)]
    framed = scene.replace("camera.resolution", list(size))
    if focus is not None:
        framed = focus_scene(framed, lambda _: seen, focus)
        wide = wide.model_copy(update={"camera": framed.camera.model_copy(update={"resolution": shape[::-1]})})
    lens, (x, y) = lens_at(wide, 0.0), ray_slopes(reference_camera(wide), *np.ogrid[: shape[0], : shape[1]])
    radii = [lens.image_radius(each.inverse_depth, x, y) for each in values]
    largest = [float(np.abs(r[each.covered]).max(initial=0.0)) for each, r in zip(inputs, radii, strict=True)]
    if max_blur is None and max(largest) > LARGEST_BLUR:
        with_camera(wide.camera)  # raises an error that says which unit is probable
    most = LARGEST_BLUR if max_blur is None else max_blur
    notes = tuple(_notes(inputs, values, framed, seen, [r[inside] for r in radii], max_blur))
    reach = math.ceil(min(most, max(largest))) + 1  # farther overscan has no effect
    kept = tuple(
        slice(max(more - reach, 0), length - max(more - reach, 0)) for more, length in zip(margin, shape, strict=True)
    )
    colors = list(dict.fromkeys(each.picture.color for each in inputs))
    is_gray = all(each.picture.data.ndim == 2 for each in inputs)
    fits = len(colors) == 1 and colors[0].channels in (0, 1 if is_gray else 3)
    return PictureLayers(
        tuple(
            (each.rgba(scene.image.transfer, len(colors) > 1)[kept], np.clip(r, -most, most)[kept])
            for each, r in zip(inputs, radii, strict=True)
        ),
        framed, (min(margin[0], reach), min(margin[1], reach)), any(each.alpha is None for each in inputs), is_gray,
        max(each.picture.bits for each in inputs), colors[0] if fits else SRGB, notes,
    )  # fmt: skip


def _notes(
    inputs: Sequence[_Input], values: Sequence[DepthValues], scene: Scene, seen: Sequence[NDArray[np.float64]],
    radii: Sequence[NDArray[np.float64]], max_blur: float | None,
) -> Iterator[tuple[str, str]]:  # fmt: skip
    for each, depths, w, radius in zip(inputs, values, seen, radii, strict=True):
        image, depth = str(each.item.texture), str(each.item.depth)
        yield from ((image, note) for note in each.picture.notes())
        if report := depths.report():
            yield depth, report
        if each.moved:
            pixels = "1 partly covered pixel gets" if each.moved == 1 else f"{each.moved} partly covered pixels get"
            yield depth, f"{pixels} the depth of the nearest covered one"
        if w.any():
            yield depth, lens_line(scene, w)
        if max_blur is not None and (count := np.count_nonzero((np.abs(radius) > max_blur) & (w > 0))):
            yield depth, f"R of {count} of {w.size} pixels is clamped to {max_blur:g} px"


def _read_inputs(items: Sequence[DepthMap], size: tuple[int, int]) -> list[_Input]:
    """Read images and depths, all with the largest overscan among the images. size: columns and rows of the frame."""
    read = [read_rgba(str(item.texture), item.texture_layer) for item in items]
    rows, columns = (max(side) for side in zip(*(picture.data.shape[:2] for picture, _ in read), strict=True))
    inputs = []
    for item, (picture, alpha) in zip(items, read, strict=True):
        image, depth = str(item.texture), str(item.depth)
        numbers = read_depth(
            depth, item.depth_layer, image if item.texture_layer is None else LayerInput(image, item.texture_layer)
        )
        check_sizes(str(items[0].texture), size, image, image_size(image))
        is_exr = depth.lower().endswith(".exr")  # whose numbers may have overscan
        check_sizes(image, size, depth, image_size(depth) if is_exr else (numbers.shape[1], numbers.shape[0]))
        numbers, fitted = _fit(numbers, rows, columns), Picture(_fit(picture.data, rows, columns), picture.color)
        if alpha is None:
            inputs.append(_Input(item, fitted, None, numbers))
        else:
            alpha = _fit(alpha, rows, columns)
            zero_is_number = item.unit == "coc" or item.near is not None
            inputs.append(_Input(item, fitted, alpha, *assign_covered_depths(numbers, alpha, zero_is_number)))
    return inputs


def _fit(array: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    """An array cut on opposite sides, or continued as its mirror image, to these rows and columns."""
    for axis, length in enumerate((rows, columns)):
        more = (length - array.shape[axis]) // 2
        if more > 0:
            array = np.pad(array, [(more, more) if n == axis else (0, 0) for n in range(array.ndim)], "symmetric")
        elif more < 0:
            array = array.take(range(-more, array.shape[axis] + more), axis)
    return array


def assign_covered_depths(
    numbers: NDArray[Any], alpha: NDArray[np.float32], zero_is_number: bool = False
) -> tuple[NDArray[Any], int]:  # fmt: skip
    """Replace the depths of partly covered pixels that have the background's, and all under alpha 0.

    A partly covered pixel has the background's depth if it has none, an infinite one, or that of a neighbor under alpha
    0, or of such a pixel; it gets the depth of the nearest covered one. numbers: of the depth file, whose unit does not
    matter, as depths are only compared and copied. zero_is_number: True if 0 is a depth like others. Returns the
    numbers, and how many partly covered pixels have others.
    """
    z, cover = np.pad(numbers, 1, "edge").astype(np.float64), np.pad(alpha, 1, constant_values=np.nan)
    width, z, cover = z.shape[1], z.ravel(), cover.ravel()
    neighbors = (-1, 1, -width, width, -width - 1, -width + 1, width - 1, width + 1)
    lacking = ~np.isfinite(z) | (z >= FAR) | ((z == 0) & (not zero_is_number))
    partly = (cover > 0) & (cover < 1)
    behind = (cover == 0) | (partly & lacking)
    front = np.flatnonzero(behind)
    while front.size:
        reached = []
        for step in neighbors:
            at = front + step
            with np.errstate(invalid="ignore", over="ignore"):
                at = at[partly[at] & ~behind[at] & (np.abs(z[at] - z[front]) <= SAME * np.abs(z[at]))]
            behind[at] = True
            reached.append(at)
        front = np.concatenate(reached)
    known = (cover > 0) & ~behind
    count, front = int(np.count_nonzero(behind & partly)), np.flatnonzero(known & ~lacking)
    if not front.size:  # no depth to copy, unless to pixels under alpha 0
        z[cover == 0] = z[np.argmax(cover > 0)]
        count = 0
    while front.size:
        reached = []
        for step in neighbors:
            at = (front + step)[behind[front + step]]
            z[at] = z[at - step]
            behind[at] = False
            reached.append(at)
        front = np.concatenate(reached)
    return z.reshape(-1, width)[1:-1, 1:-1].astype(numbers.dtype), count
