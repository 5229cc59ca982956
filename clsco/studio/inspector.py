"""Figures of a pixel of a frame, of the PSF at the pixel, and of the lens."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.transfer import encode
from clsco.frame.frame import GREEN, Frame
from clsco.inputs.pupils import scene_point_spread
from clsco.optics.exposure import middle_time, pixel_time
from clsco.optics.lens import SHARP, Lens
from clsco.optics.lens_path import camera_at, reference_camera
from clsco.optics.motion import poses_at, rest_center
from clsco.optics.rays import places_of, slopes_at
from clsco.reference.blur.blur import tilt_factor, within_rim
from clsco.reference.common.geometry import blur_gradient, pixel_tilt
from clsco.reference.spreads import behind_rims, spread_weights
from clsco.scene.model import Scene
from clsco.studio.pictures import eye_of, small_views

PLOTTED = 32  # px from the center of a plot to its border


def inspected(frame: Frame, scene: Scene, x: int, y: int, is_tilted: bool = False) -> dict[str, Any]:
    """All outputs of a frame, which has all ground truth, at a pixel, and figures derived from them.

    Returns `index` and `eye` of the frame; and `values` of the outputs by name, where None stands for infinity. If
    the pixel shows a surface, also `psf`, the result of `point_spread`, and `unmeasured`, the reason why the response
    of the pixel's source cannot be measured, if there is one. is_tilted: True if weights depend on the gradient of R.
    """
    values: dict[str, Any] = {"x": x, "y": y}
    values["codes"] = _plain(encode(frame.color[y, x], min(frame.metadata["bits"], 16), scene.image.transfer))
    size = {"resolution": frame.color.shape[1::-1]}  # a scene without a resolution has that of its texture
    scene = scene.model_copy(update={"camera": scene.camera.model_copy(update=size)})
    for name in (
        "color", "sharp", "depth", "blur_radius", "normal", "flow", "object_id", "mask", "filled", "missing", "hidden",
        "flow_occluded", "uv", "raw", "electrons", "noise_sigma", "saturated",
    ):  # fmt: skip
        array = getattr(frame, name)
        if array is not None:
            values[name] = _plain(array[y, x])
    known = values.get("object_id", -1)
    if known >= 0:
        item = scene.objects[known]
        values["object"] = item.name or item.shape
    radius, depth = values.get("blur_radius"), values.get("depth")
    radius = radius[GREEN] if isinstance(radius, list) else radius
    if radius is not None:
        values |= {name: length * abs(radius) for name, length in scene_point_spread(scene).pupil.lengths.items()}
    found: dict[str, Any] = {"index": frame.index, "eye": eye_of(frame), "values": values}
    whole = scene
    if scene.lens_moves:
        camera = camera_at(scene, middle_time(scene.sequence, frame.index))
        scene = scene.model_copy(update={"camera": camera, "lens": scene.lens and scene.lens.at_rest})
    across, up, _ = _ray(frame, scene, x, y)
    if radius is not None and values["mask"]:
        gradient = radius_gradient(frame, scene, x, y) if is_tilted else np.zeros(2)
        found["psf"] = point_spread(scene, radius, gradient, (across, up), 1.0 / depth if depth else 0.0)
        source = source_of(frame, whole, x, y)
        if isinstance(source, str):
            found["unmeasured"] = source
    return found


def focus_point(frame: Frame) -> tuple[int, int]:
    """Column and row of the pixel in focus that is nearest to the center, or else of a pixel with the least |R|."""
    assert frame.blur_radius is not None
    radius = np.abs(frame.blur_radius[..., GREEN] if frame.blur_radius.ndim == 3 else frame.blur_radius)
    radius = radius if frame.mask is None else np.where(frame.mask, radius, np.inf)
    rows, columns = np.nonzero(radius <= max(0.5 * SHARP, float(radius.min())))
    nearest = np.argmin(np.hypot(rows - 0.5 * radius.shape[0], columns - 0.5 * radius.shape[1]))
    return int(columns[nearest]), int(rows[nearest])


def overview(frame: Frame, scene: Scene) -> dict[str, Any]:
    """Small views of a frame with all ground truth; `ranges` of the visible objects: name, depth in mm of which 1, 50
    and 99 % of their pixels are nearer, None for infinity, and mean color; and `ends` of a focal stack of them, mm.
    """
    assert frame.depth is not None
    assert frame.object_id is not None
    assert frame.sharp is not None
    ranges = []
    for number, item in enumerate(scene.objects):
        seen = frame.object_id < 0 if item.is_background else frame.object_id == number
        if seen.any():
            ends = np.percentile(frame.depth[seen], (1, 50, 99), method="nearest")
            light = np.broadcast_to(frame.sharp[seen].mean(axis=0), 3)
            codes = encode(light / max(float(light.max()), 1e-6) * 0.7, 8, "srgb")
            name = item.name or item.shape.replace("_", " ")
            ranges.append([name.capitalize(), *map(_plain, ends), f"#{bytes(codes.astype(np.uint8)).hex()}"])
    depths = [depth for _, near, _, far, _ in ranges for depth in (near, far) if depth is not None] or [250.0]
    near, far = min(depths), max(depths)
    near, far = (near, far) if far > 1.02 * near else (0.8 * near, 1.6 * far)
    ends = {"nearest": f"{near:.4g}", "farthest": f"{far:.4g}"}
    return {"ranges": ranges, "views": small_views(frame, scene), "ends": ends}


def source_of(frame: Frame, scene: Scene, x: int, y: int) -> tuple[int, int, int] | str:
    """The source, in the reference pose, of the point visible in a pixel at the middle of the exposure.

    Returns column, row and object, as arguments for `clsco.response`; or the reason why there is no such source.
    """
    if scene.stereo is not None:
        return "not of a stereo pair"
    assert frame.depth is not None
    assert frame.object_id is not None
    number, depth = int(frame.object_id[y, x]), float(frame.depth[y, x])
    if number < 0 or not math.isfinite(depth):
        return "no surface"
    if frame.hidden is not None and frame.hidden[y, x]:
        return "the point is hidden at t = 0"
    if not scene.moves:
        return x, y, number
    rows, columns = frame.depth.shape
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    sized = scene.model_copy(update={"camera": scene.camera.model_copy(update={"resolution": (columns, rows)})})
    time = pixel_time(sized, frame.index, x, y)
    pose, center = poses_at(scene, time)[number], rest_center(scene.objects[number])
    point = depth * np.array([*slopes_at(camera_at(scene, time), x - middle[0], middle[1] - y), 1.0])
    rest = center + (point - center - pose.shift) @ pose.rotation
    if rest[2] <= 0:
        return "the point is behind the lens at t = 0"
    right, up = places_of(reference_camera(scene), rest[0] / rest[2], rest[1] / rest[2])
    column, row = np.rint(middle + np.array([right, -up])).astype(int).tolist()
    if not (0 <= column < columns and 0 <= row < rows):
        return "the point is beside the frame at t = 0"
    return column, row, number


def _ray(frame: Frame, scene: Scene, x: int, y: int) -> NDArray[np.float64]:
    """Ray through a pixel: slopes right and up, and 1."""
    rows, columns = frame.color.shape[:2]
    return np.array([*slopes_at(reference_camera(scene), x - (columns - 1) / 2, (rows - 1) / 2 - y), 1.0])


def radius_gradient(frame: Frame, scene: Scene, x: int, y: int) -> NDArray[np.float64]:
    """Gradient of R at a pixel, (right, down), px per px, computed from depth and normal; 0 without a surface."""
    assert frame.depth is not None
    assert frame.normal is not None
    normal, depth = frame.normal[y, x].astype(np.float64), float(frame.depth[y, x])
    ray = _ray(frame, scene, x, y)
    facing = float(normal @ ray)
    if not math.isfinite(depth) or facing == 0.0:
        return np.zeros(2)
    # On the tangent plane 1/Z is linear in the direction of the ray.
    camera = reference_camera(scene)
    slope, lens = normal[:2] / (facing * depth), Lens.of(camera, scene.lens)
    return blur_gradient(camera, lens, slope, ray, np.array(1.0 / depth))


def point_spread(
    scene: Scene, radius: float, gradient: NDArray[np.float64], slopes: tuple[float, float], inverse: float
) -> dict[str, Any]:  # fmt: skip
    """Figures of the PSF of the scene's lens: those of `figures_of`, for weights as of `clsco.psf`, and `radius`.

    radius: signed R, px. gradient: gradient of R (right, down), px per px, which tilts the weights. slopes: X / Z and
    Y / Z of the source; rims, and aberrations that vary over the frame, depend on them. inverse: 1 / Z of the source,
    1/mm.
    """
    psf = scene_point_spread(scene)
    slope, spread = pixel_tilt(gradient, radius, psf.diffracted)
    camera = reference_camera(scene)
    (columns, rows), (right, up) = camera.frame_size, places_of(camera, *slopes)
    weights = spread_weights(psf, float(spread), (0.5 * (columns - 1) + float(right), 0.5 * (rows - 1) - float(up)))
    far = weights.shape[0] // 2
    if psf.rims:
        lens, place = Lens.of(camera, scene.lens), np.array([slopes])
        weights = behind_rims(lens, psf, place, np.array([inverse]), np.array([[radius]]), weights[None, None])[0, 0]
    offset = np.arange(-far, far + 1, dtype=np.float64)
    x, y = within_rim(psf, offset, offset[:, None], spread)
    return figures_of(weights * tilt_factor(x, y, slope), far, far) | {"radius": radius}


def figures_of(spread: NDArray[np.floating], column: int, row: int) -> dict[str, Any]:
    """Figures of weights (rows, columns): how the light of a source at `column`, `row` is spread.

    Returns the `largest` weight and the `sum` of weights; `plot`, base64 of the (2 PLOTTED + 1)^2 weights around the
    source, as bytes with a maximum of 255; and `reach`, the largest distance, in rows or columns, between the source
    and a byte that is not 0. Unless the sum is 0, also `centroid`, its offset (right, down) from the source, px, and
    `rms`, the standard deviation along each axis, px, which is |R| / 2 for a large disc.
    """
    rows, columns = spread.shape
    found: dict[str, Any] = {"largest": float(spread.max()), "sum": float(spread.sum(dtype=np.float64))}
    plot = np.zeros((2 * PLOTTED + 1, 2 * PLOTTED + 1))
    top, left = max(row - PLOTTED, 0), max(column - PLOTTED, 0)
    part = spread[top : row + PLOTTED + 1, left : column + PLOTTED + 1]
    start = top - row + PLOTTED, left - column + PLOTTED
    plot[start[0] : start[0] + part.shape[0], start[1] : start[1] + part.shape[1]] = part
    codes = np.round(255 * np.clip(plot / max(found["largest"], 1e-30), 0, 1)).astype(np.uint8)
    at = np.abs(np.argwhere(codes) - PLOTTED)
    found |= {"plot": base64.b64encode(codes.tobytes()).decode(), "reach": int(at.max(initial=0))}
    if found["sum"] <= 0.0:
        return found
    share = spread / found["sum"]
    axes = (np.arange(columns) - column, share.sum(axis=0)), (np.arange(rows) - row, share.sum(axis=1))
    center = [float(offset @ weight) for offset, weight in axes]
    square = [float((offset - c) ** 2 @ weight) for (offset, weight), c in zip(axes, center, strict=True)]
    found["centroid"] = [round(part, 9) + 0.0 for part in center]
    found["rms"] = [math.sqrt(max(part, 0.0)) for part in square]
    return found


def _plain(value: NDArray[Any] | np.generic) -> Any:
    """Numbers and lists for JSON; None for numbers that are not finite."""
    if isinstance(value, np.ndarray) and value.ndim:
        return [_plain(part) for part in value]
    plain = value.item()
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
