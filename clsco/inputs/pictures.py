"""Layers of pictures with depth, for `clsco.defocus`: linear colors with alpha, and signed blur radii."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clsco.constants import OPAQUE
from clsco.errors import FileError, SceneError
from clsco.files.color import SRGB, Color
from clsco.files.decoders import decode_once, mirrored
from clsco.files.images import Picture, check_same_size, check_sizes, image_size, read_rgba
from clsco.inputs.depth_files import DEPTH_FORMATS, read_depth
from clsco.inputs.depth_maps import FARTHEST, DepthValues, map_values
from clsco.inputs.focus import Focus, focus_scene, lens_line
from clsco.inputs.textures import radiance_of
from clsco.optics.lens import LARGEST_BLUR
from clsco.optics.lens_path import lens_at, reference_camera
from clsco.optics.rays import ray_slopes
from clsco.scene.model import DepthMap, Scene
from clsco.scene.quantities import MIN_LENGTH_MM

SECTIONS = ("title", "camera", "aperture", "psf", "image", "objects")  # parts of a scene that layers depend on
SAME = 1e-3  # largest relative difference between depths of the background
FAR = 1e10  # number that Blender stores for infinitely far


class PictureLayers(NamedTuple):
    """Layers of a frame: premultiplied linear RGBA (rows, columns, 4), and signed R (rows, columns) in px.

    margin: rows and columns of overscan beyond each border of the frame. scene: that of the layers, focused. is_opaque:
    True if a layer has no transparent pixel. bits: most per value of an image. notes: names of files, each with a line.
    """

    layers: Sequence[tuple[NDArray[np.float32], NDArray[np.float64]]]
    margin: tuple[int, int]
    scene: Scene
    is_opaque: bool
    is_gray: bool
    bits: int
    color: Color
    notes: Sequence[tuple[str, str]]


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
        pictures, alphas, numbers = zip(*(_read_layer(item, size) for item in items), strict=True)
    shape = tuple(max(lengths) for lengths in zip(*(alpha.shape for alpha in alphas), strict=True))
    margin = (shape[0] - size[1]) // 2, (shape[1] - size[0]) // 2
    inside = tuple(slice(more, length - more) for more, length in zip(margin, shape, strict=True))
    alphas = [np.where(a >= OPAQUE, np.float32(1.0), a) for a in (_fit(alpha, shape) for alpha in alphas)]
    wide, framed = (scene.replace("camera.resolution", list(pair)) for pair in (shape[::-1], size))
    of_lens = (focus is None and max_blur is None) or any(item.unit == "coc" for item in items)
    pinhole = {} if of_lens else {"aperture_diameter": MIN_LENGTH_MM}  # so that no depth is too near
    of_depths = wide.model_copy(update={"camera": wide.camera.model_copy(update=pinhole)})
    values, notes, clamped = [], [], []
    for item, picture, alpha, depths in zip(items, pictures, alphas, numbers, strict=True):
        zero_is_number = item.unit == "coc" or item.near is not None
        own, moved = assign_covered_depths(_fit(depths, shape), alpha, zero_is_number)
        own, larger = _clamp(own, item, max_blur) if max_blur and item.unit == "coc" else (own, np.zeros(shape, bool))
        clamped.append(larger & (alpha > 0))
        hard = item.model_copy(update={"soft_edges": "keep"})
        value = map_values(of_depths, hard, own) if alpha.any() else DepthValues(np.full(shape, FARTHEST), {}, 0)
        values.append(value.inverse_depth)
        notes += [(str(item.texture), note) for note in picture.notes()]
        pixels = f"{moved} partly covered pixel{'s get' if moved > 1 else ' gets'} the depth of the nearest covered one"
        notes += [(str(item.depth), note) for note in (value.report(), moved and pixels) if note]
    seen = [np.where(alpha > 0, w, 0.0)[inside] for alpha, w in zip(alphas, values, strict=True)]
    if focus is not None:
        framed = focus_scene(framed, lambda _: seen, focus)
        wide = wide.model_copy(update={"camera": framed.camera.model_copy(update={"resolution": shape[::-1]})})
    lens, (x, y) = lens_at(wide, 0.0), ray_slopes(reference_camera(wide), *np.ogrid[: shape[0], : shape[1]])
    radii, most = [lens.image_radius(w, x, y) for w in values], max_blur or LARGEST_BLUR
    for item, w, radius, already in zip(items, seen, radii, clamped, strict=True):
        if beyond := np.count_nonzero(already[inside] | ((np.abs(radius[inside]) > most) & (w > 0))):
            if max_blur is None:
                raise FileError(f"{item.depth}: blur radii must be at most {most:g} px; got more in {beyond} pixels")
            notes.append((str(item.depth), f"R of {beyond} of {w.size} pixels is clamped to {most:g} px"))
        if w.any():
            notes.append((str(item.depth), lens_line(framed, w)))
    colors = list(dict.fromkeys(picture.color for picture in pictures))
    is_gray = all(picture.data.ndim == 2 for picture in pictures)
    fits = len(colors) == 1 and colors[0].channels in (0, 1 if is_gray else 3)
    layers = []
    for picture, alpha, radius in zip(pictures, alphas, radii, strict=True):
        light = _fit(radiance_of(picture, scene.image.transfer, to_srgb=len(colors) > 1), shape)
        light = np.atleast_3d(light) * (1 if picture.is_float else alpha[..., None])
        rgba = np.concatenate([np.broadcast_to(light, (*shape, 3)), alpha[..., None]], axis=2)
        layers.append((rgba, np.clip(radius, -most, most)))
    covering = [layer for layer in layers if layer[0][..., 3].any()] or layers[:1]
    is_opaque, bits = any(alpha.min() == 1 for alpha in alphas), max(picture.bits for picture in pictures)
    return PictureLayers(covering, margin, framed, is_opaque, is_gray, bits, colors[0] if fits else SRGB, notes)


def _read_layer(item: DepthMap, size: tuple[int, int]) -> tuple[Picture, NDArray[np.float32], NDArray[Any]]:
    """Image, alpha and depths of a layer, with their overscan. size: columns and rows of the frame."""
    image, depth = str(item.texture), str(item.depth)
    check_sizes("the first layer", size, image, image_size(image))
    picture, alpha = read_rgba(image, item.texture_layer)
    numbers = read_depth(depth, item.depth_layer, (image, item.texture_layer))
    is_exr = depth.lower().endswith(".exr")  # whose numbers may have overscan
    check_same_size(image, depth, image_size(depth) if is_exr else numbers.shape[::-1], DEPTH_FORMATS)
    return picture, alpha, numbers


def _fit(array: NDArray[Any], shape: Sequence[int]) -> NDArray[Any]:
    """An array cut on opposite sides, or continued as its mirror image, to these rows and columns."""
    for axis, length in enumerate(shape):
        if length != array.shape[axis]:
            at = np.arange(length) - (length - array.shape[axis]) // 2
            array = array.take(mirrored(at, array.shape[axis]), axis)
    return array


def _clamp(numbers: NDArray[Any], item: DepthMap, most: float) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Numbers whose R, in px, is at most `most` in size, and a mask of those that were larger. No depth has an R beyond
    that of infinity.
    """
    offset = item.offset or 0.0
    radius = numbers * np.float64(item.scale) + offset
    beyond = np.isfinite(radius) & (np.abs(radius) > most)
    return np.where(beyond, (np.copysign(most, radius) - offset) / item.scale, numbers), beyond


def assign_covered_depths(
    numbers: NDArray[Any], alpha: NDArray[np.float32], zero_is_number: bool = False
) -> tuple[NDArray[Any], int]:  # fmt: skip
    """Replace the depths of partly covered pixels that have the background's, and all under alpha 0.

    A partly covered pixel has the background's depth if it has none, an infinite one, or that of a neighbor under alpha
    0, or of such a pixel; it gets the depth of the nearest covered one. numbers: of the depth file, in any unit, as
    they are only compared and copied. zero_is_number: True if 0 is a depth like others. Returns the numbers, and how
    many partly covered pixels have others.
    """
    if alpha.min() == 1:
        return numbers, 0
    z, cover = np.pad(numbers, 1, "edge").astype(np.float64), np.pad(alpha, 1, constant_values=np.nan)
    width, z, cover = z.shape[1], z.ravel(), cover.ravel()
    lacking = ~np.isfinite(z) | (z >= FAR) | ((z == 0) & (not zero_is_number))
    partly = (cover > 0) & (cover < 1)
    behind = (cover == 0) | (partly & lacking)

    def join(source: NDArray[np.intp], at: NDArray[np.intp]) -> NDArray[np.intp]:
        with np.errstate(invalid="ignore", over="ignore"):
            at = at[partly[at] & ~behind[at] & (np.abs(z[at] - z[source]) <= SAME * np.abs(z[at]))]
        behind[at] = True
        return at

    def copy(source: NDArray[np.intp], at: NDArray[np.intp]) -> NDArray[np.intp]:
        source, at = source[behind[at]], at[behind[at]]
        z[at], behind[at] = z[source], False
        return at

    def spread(front: NDArray[np.intp], step: Callable[..., NDArray[np.intp]]) -> None:
        neighbors = (-1, 1, -width, width, -width - 1, -width + 1, width - 1, width + 1)
        while front.size:
            front = np.concatenate([step(front, front + offset) for offset in neighbors])

    spread(np.flatnonzero(behind), join)
    sources, count = np.flatnonzero((cover > 0) & ~behind & ~lacking), int(np.count_nonzero(behind & partly))
    if not sources.size:  # no depth that partly covered pixels could have
        behind[partly], sources, count = False, np.flatnonzero(cover > 0), 0
    spread(sources, copy)
    return z.reshape(-1, width)[1:-1, 1:-1].astype(numbers.dtype), count
