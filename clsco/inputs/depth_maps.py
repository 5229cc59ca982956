"""Conversion of depth files to the inverse depth of each pixel's surface, in float64; pure except for reading files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import FileError
from clsco.inputs.textures import load_texture
from clsco.optics.lens import LARGEST_BLUR, Lens, blur_radius
from clsco.optics.lens_path import reference_camera
from clsco.optics.rays import slopes_at
from clsco.scene.arrays import ArrayInput, Input, LayerInput
from clsco.scene.model import Camera, DepthMap, Scene
from clsco.scene.quantities import MIN_LENGTH_MM

Array = NDArray[np.float64]

ZERO_IS_MISSING = ("mm", "m", "disparity")
FARTHEST = 1e-12  # inverse depth in 1/mm of an infinitely far surface; 0 means no surface
ONE_SURFACE = 1.1  # largest ratio of the depths at both ends of a gap at which the ends belong to one surface
ROUNDING = 1e-6  # share of the radius at infinity by which rounded radii (float32: a few times 2^-24) may exceed it


@dataclass(frozen=True, eq=False)
class DepthValues:
    """Depths of a map, in clsco's units.

    inverse_depth: (rows, columns), 1/mm, > 0; 0 where the map has no surface. The other fields count pixels.
    missing: pixels without a surface, by the value in the file: "zero", "negative", "NaN" or "infinite".
    far: pixels with an infinitely far surface, whose inverse depth is `FARTHEST`.
    soft: pixels whose depth was between those of two surfaces, and that have been assigned to one of them.
    """

    inverse_depth: Array
    missing: Mapping[str, int]
    far: int
    soft: int = 0

    @property
    def invalid(self) -> int:
        """Number of pixels without a surface."""
        return sum(self.missing.values())

    def report(self) -> str:
        """One line: the numbers of pixels without depth (by reason), infinitely far, and at soft edges; "" if there are
        none.
        """
        why = _listed(self.missing)
        size, verb = self.inverse_depth.size, "is" if self.far == 1 else "are"
        parts = [f"{self.invalid} of {size} pixels have no depth ({why})"] if why else []
        if self.far:
            subject = f"{self.far}" if parts else f"{self.far} of {size} pixels"
            parts.append(f"{subject} {verb} infinitely far")
        if self.soft:
            subject = f"{self.soft}" if parts else f"{self.soft} of {size} pixels"
            parts.append(f"{subject} at soft edges {'gets' if self.soft == 1 else 'get'} the depth of one side")
        return ", ".join(parts)


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)


def inverse_depth(raw: NDArray[Any], item: DepthMap, camera: Camera, where: str = "depth") -> DepthValues:
    """Turn the numbers of a depth file into inverse depth.

    raw: (rows, columns), integers or float64. item: defines unit, scale and the like of `raw`. where: name of the map
    in error messages.

    unit         inverse depth w of v = raw scale + offset   no surface               missing code   infinitely far
    mm, m        1 / v                                       v = 0, negative, NaN     0              +inf, also 1e10 m
    inverse_mm,  v                                           v negative, NaN, +inf    none           v = 0
    inverse_m
    disparity    p v / (baseline s0), v in px                v = 0, negative, NaN,    0              -
                                                             +inf
    coc          K - v / kappa, v the signed R in px         NaN, infinite            none           R = kappa K

    K and kappa are focus_power and blur_scale of `clsco.optics.lens.Lens`. A missing code is an integer that marks
    unmeasured pixels, whatever the offset, such as 0 in KITTI's PNGs of scale 1/256; files of floats mark them by NaN,
    Middlebury's PFMs by inf. If near and far are set, the finite numbers are scaled to that range, and no number marks
    missing pixels. Surfaces at infinity, or farther than 1e12 mm, get 1e-12 per mm, and are blurred as at infinity.

    Raises FileError if no pixel has a surface, unless no_depth is "far"; if |R| exceeds 512 px, with a guess of the
    intended unit; if a depth is below 1e-6 mm; if a blur radius (coc) is larger than the radius at infinity, which no
    depth has; and if near and far are set, but all numbers are equal. Validated against the formulas in exact
    fractions, and by converting analytic depth to every unit and back.
    """
    unit, nowhere = item.unit, np.zeros(raw.shape, np.bool_)
    with np.errstate(over="ignore"):
        value: Array = raw * np.float64(item.scale)
        value += item.offset or 0.0
    zero = raw == 0 if raw.dtype.kind in "iu" and unit in ZERO_IS_MISSING and item.near is None else nowhere
    if item.near is not None:
        unit = "inverse_mm" if unit.startswith("inverse") else "mm"
        value = _in_range(value, unit, item.near, item.far or math.inf, where)
    signed = unit == "coc"
    if unit in ZERO_IS_MISSING:
        zero = zero | (value == 0)
    kinds = {
        "zero": zero,
        "negative": nowhere if signed else (value < 0) & ~zero,
        "NaN": np.isnan(value),
        "infinite": nowhere if unit in ("mm", "m") else np.isinf(value) if signed else value == np.inf,
    }
    missing = {name: int(np.count_nonzero(kind)) for name, kind in kinds.items()}
    valid = ~np.logical_or.reduce(list(kinds.values()))
    if not valid.any() and item.no_depth == "far":
        return DepthValues(np.zeros(raw.shape), missing, 0)
    if not valid.any():
        raise FileError(f"{where}: at least one pixel must have a depth; got {_listed(missing).lower()}")
    value = value[valid]
    w = _convert(value, unit, camera, item.baseline)
    if item.depth_kind == "ray":
        w *= _ray_lengths(raw.shape, camera)[valid]
    _check_blur(w, value, unit, item.scale if item.near is None else None, camera, where)
    if unit == "coc":
        _check_reach(value, camera, where)
    far = int(np.count_nonzero(w <= FARTHEST))
    np.maximum(w, FARTHEST, out=w)
    result = w.reshape(raw.shape) if w.size == raw.size else np.zeros(raw.shape)
    if w.size < raw.size:
        result[valid] = w
    return DepthValues(result, missing, far)


def fill_depth(w: Array) -> Array:
    """Inverse depth (rows, columns) in 1/mm with pixels that have none (0) filled from their surroundings.

    Across a gap in a row, and in a column, w is interpolated linearly between the nearest known pixels, as on a plane;
    if these belong to two surfaces, w is that of the farther pixel, so that no surface grows over an edge. The values
    from row and column are averaged, weighted by the inverse width of their gaps; if they belong to two surfaces, the
    narrower gap decides, or for equal gaps the farther surface. Validated on tilted planes (exact) and on steps.
    """
    for _ in range(2):  # a pixel whose row and column are empty has pixels of the first round in both
        along, width = _across(w)
        down, height = (array.T for array in _across(w.T))
        total = 1 / width + 1 / height
        mean = (along / width + down / height) / np.where(total > 0, total, 1.0)
        nearer, farther = np.maximum(along, down), np.minimum(along, down)
        narrower = np.where(width == height, farther, np.where(width < height, along, down))
        w = np.where(w > 0, w, np.where(nearer <= ONE_SURFACE * farther, mean, narrower))
    return w


def _across(w: Array) -> tuple[Array, Array]:
    """w of every pixel, interpolated between the nearest known pixels in its row, and the distance of these two in px.

    A pixel with known pixels on one side only gets w of the nearest one, and twice the distance to it. Pixels in rows
    without known pixels get 0 and inf.
    """
    column = np.broadcast_to(np.arange(w.shape[1]), w.shape)
    left = np.maximum.accumulate(np.where(w > 0, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(w > 0, column, w.shape[1])[:, ::-1], axis=1)[:, ::-1]
    on_left, on_right = left >= 0, right < w.shape[1]
    before, after = (np.take_along_axis(w, np.clip(at, 0, w.shape[1] - 1), axis=1) for at in (left, right))
    before, after = np.where(on_left, before, after), np.where(on_right, after, before)
    both, gap = on_left & on_right, np.maximum(right - left, 1)
    nearer, farther = np.maximum(before, after), np.minimum(before, after)
    plane = before + np.where(both, (column - left) / gap, 0.0) * (after - before)
    between = np.where(nearer <= ONE_SURFACE * farther, plane, farther)
    outside = 2.0 * np.where(on_left, column - left, right - column)  # weighted like the middle of a gap
    width = np.where(both, gap, np.where(on_left | on_right, outside, np.inf))
    return np.where(on_left | on_right, between, 0.0), width


def _load(scene: Scene, item: DepthMap) -> Array:
    def image() -> NDArray[np.float32]:
        return load_texture(item.inputs()["texture"], scene.image.transfer, scene.camera.resolution).radiance

    return map_values(scene, item, depth_numbers(item.inputs()["depth"]), image).inverse_depth


def load_scene_depths(
    scene: Scene, load: Callable[[Scene, DepthMap], Array] = _load
) -> tuple[Array | None, ...]:  # fmt: skip
    """Inverse depth (rows, columns) in 1/mm of every object that is a depth map, None for others.

    The scene needs a resolution. load: returns the inverse depth of an object. Raises FileError for the first file that
    cannot be read, differs in size from the frame, or does not fit the camera.
    """
    return tuple(load(scene, item) if isinstance(item, DepthMap) else None for item in scene.objects)


def depth_numbers(source: Input) -> NDArray[Any]:
    """Numbers (rows, columns) of a depth file or an array, read-only for callers. Raises the errors of `read_depth`."""
    if isinstance(source, ArrayInput):
        return source.array
    from clsco.inputs.depth_files import read_depth

    return read_depth(source, source.layer if isinstance(source, LayerInput) else None)


def map_values(
    scene: Scene, item: DepthMap, raw: NDArray[Any], image: Callable[[], NDArray[np.float32]] | None = None
) -> DepthValues:
    """Depths of a depth map in a scene, and counts of the special values in its file or array.

    scene: a scene with a resolution. raw: numbers of the object's file or array. image: returns the object's radiance,
    called only if edges are soft (`assign_soft_edges`); if None, depths alone decide. Pixels without depth become
    infinitely far with no_depth = "far"; otherwise they are filled from their surroundings (`fill_depth`), or have no
    surface with fill.method = "none". Raises FileError if the frame has another size, and as `inverse_depth`.
    """
    from clsco.files.images import check_sizes

    name = str(item.depth)
    check_sizes("the frame", scene.camera.frame_size, name, (raw.shape[1], raw.shape[0]))
    values = inverse_depth(raw, item, reference_camera(scene), name)
    if item.soft_edges == "assign":
        stored = raw.astype(np.float64, copy=False) if item.unit in ("mm", "m") else None
        values = _without_soft_edges(values, stored, scene.camera, image)
    if values.invalid and item.no_depth == "far":
        if (radius := abs(float(blur_radius(scene.camera, FARTHEST)))) > LARGEST_BLUR:
            rule = f"{name}: the blur radius must be at most {LARGEST_BLUR:g} px"
            raise FileError(f"{rule}; got {radius:.4g} px at infinity, where no_depth puts {values.invalid} pixels")
        w = values.inverse_depth
        return replace(values, inverse_depth=np.where(w > 0, w, FARTHEST))
    if not values.invalid or scene.fill.method == "none":
        return values
    return replace(values, inverse_depth=fill_depth(values.inverse_depth))


def _without_soft_edges(
    values: DepthValues, depth: Array | None, camera: Camera, image: Callable[[], NDArray[np.float32]] | None
) -> DepthValues:
    """Assign the pixels of soft edges to one of the two surfaces.

    depth: numbers of the file if they are not linear in the blur radius, else None. image: as for `map_values`.
    """
    from clsco.inputs.soft_edges import assign_soft_edges  # 1 ms, and few scenes have depth maps

    w, per_px = values.inverse_depth, abs(Lens.of(camera).blur_scale)
    radius = w * per_px
    if values.invalid:
        radius[w == 0] = np.nan
        depth = None if depth is None else np.where(w > 0, depth, np.nan)
    pixels, radii = assign_soft_edges(radius, depth, image)
    if not len(pixels):
        return values
    w = w.copy()
    w.flat[pixels] = np.maximum(radii / per_px, FARTHEST)
    return replace(values, inverse_depth=w, soft=len(pixels))


def _in_range(value: Array, unit: str, near: float, far: float, where: str) -> Array:
    """Finite numbers scaled so that, in `unit`, the nearest depth is `near` and the farthest `far`, mm."""
    finite = np.isfinite(value)
    if not finite.any():
        return value
    low, high = float(value[finite].min()), float(value[finite].max())
    if low == high:
        raise FileError(f"{where}: near and far need numbers that differ; got {low:g} alone")
    first, last = (near, far) if unit == "mm" else (1 / far, 1 / near)
    share = (value[finite] - low) / (high - low)
    value[finite] = (1 - share) * first + share * last
    return value


def _convert(value: Array, unit: str, camera: Camera, baseline: float | None) -> Array:
    """Inverse depth in 1/mm of valid values; 0 or negative for infinitely far ones."""
    with np.errstate(over="ignore", divide="ignore"):  # a value that overflows is too near, and rejected for that
        if unit == "disparity":
            return value * (camera.pixel_pitch / ((baseline or 1.0) * camera.normalization_distance))
        if unit == "coc":
            lens = Lens.of(camera)
            return lens.focus_power - value / lens.blur_scale
        if unit in ("inverse_mm", "inverse_m"):
            return value * (1.0 if unit == "inverse_mm" else 1e-3)
        return np.asarray((1.0 if unit == "mm" else 1e-3) / value)


def _ray_lengths(shape: tuple[int, ...], camera: Camera) -> Array:
    """Ratio of the distance along each pixel's ray to the depth along the axis, (rows, columns)."""
    rows, columns = shape
    x, y = slopes_at(camera, np.arange(columns) - (columns - 1) / 2, (rows - 1) / 2 - np.arange(rows)[:, None])
    return np.asarray(np.sqrt(1.0 + x**2 + y**2))


def _check_blur(w: Array, value: Array, unit: str, scale: float | None, camera: Camera, where: str) -> None:
    """Raise FileError if a blur radius is too large. scale: the depth map's, None with `near` and `far`."""
    # The radius is linear in w, so that the largest is at the smallest or the largest w.
    largest, at = max((abs(float(blur_radius(camera, w[at]))), -int(at)) for at in (w.argmin(), w.argmax()))
    if largest > LARGEST_BLUR:
        count = np.count_nonzero(np.abs(blur_radius(camera, w)) > LARGEST_BLUR)
        cause = _probable_cause(value, unit, scale, camera) if scale else "near, or the camera, is probably wrong"
        raise FileError(
            f"{where}: the blur radius must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px at {value[-at]:.4g} "
            f"{unit}, and more than that limit in {count} of {w.size} pixels ({cause})"
        )
    if w.max() > 1 / MIN_LENGTH_MM:
        raise FileError(f"{where}: depth must be at least {MIN_LENGTH_MM:g} mm; got {1 / w.max():.4g} mm")


def _probable_cause(value: Array, unit: str, scale: float, camera: Camera) -> str:
    """Hint for the error about too large blur radii: the probable unit of the numbers, or what else may be wrong.

    A unit is likely if it makes no radius too large, and if its range of radii is at least a tenth of the largest range
    among such units.
    """
    at_infinity = abs(float(blur_radius(camera, 0.0)))
    if at_infinity > LARGEST_BLUR:
        return f"the camera has {at_infinity:.4g} px at infinity: aperture_diameter or pixel_pitch is probably wrong"
    spans: dict[str, float] = {}
    for other in ("mm", "m", "inverse_m", "inverse_mm"):
        if other != unit and value.min() >= 0:
            radius = blur_radius(camera, _convert(value[value > 0], other, camera, None))
            if np.abs(radius).max() <= LARGEST_BLUR:
                spans[other] = float(np.ptp(radius))
    likely = [other for other, span in spans.items() if 10 * span >= max(spans.values())]
    if not likely:
        return "no unit makes it less: scale, or the camera, is probably wrong"
    hint = f"the depth is probably in {likely[0]}: give unit {likely[0]}"
    if likely[0].startswith("inverse") or unit in ("disparity", "coc"):
        return hint
    inverse = unit if unit.startswith("inverse") else "inverse_m"  # numbers alone do not say which end is near
    lens = Lens.of(camera)
    nearest = lens.focus_power + LARGEST_BLUR / lens.blur_scale
    most = abs(scale) * nearest / float(_convert(value.max(), inverse, camera, None))
    scaled = "" if inverse in spans else f" with a scale below {most:.2g}"
    return f"{hint}; or where larger numbers are nearer, {inverse}{scaled}"


def _check_reach(radius: Array, camera: Camera, where: str) -> None:
    """Raise an error if a blur radius exceeds the camera's at infinity, which no depth has, by more than rounding."""
    at_infinity, largest = float(blur_radius(camera, 0.0)), float(radius.max())
    if largest > at_infinity + ROUNDING * abs(at_infinity):
        rule = f"radii must be at most {at_infinity:.6g} px, which the camera has at infinity"
        if at_infinity > 0:
            opening = camera.aperture_diameter * largest / at_infinity * 1.001
            rule += f", or its aperture_diameter at least {opening:.4g} mm"
        count = np.count_nonzero(radius > at_infinity)
        raise FileError(f"{where}: {rule}; got {largest:.6g} px, and {count} pixels above the limit")
