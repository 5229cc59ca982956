"""What is known of a pixel of a frame, of its point spread function, and of the lens."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.transfer import encode
from clsco.frame.frame import Frame
from clsco.optics.lens import blur_radius, blur_scale, focus_distance, focus_power
from clsco.optics.psf import reach, weights
from clsco.scene.model import Scene
from clsco.studio.moments import eye_of

SHARP = 0.5  # px, |R| up to which a point counts as in focus
PLOTTED = 32  # px from the center of the plot to its border


def inspected(frame: Frame, scene: Scene, x: int, y: int) -> dict[str, Any]:
    """All that a frame holds of a pixel, and what follows from it.

    Parameters
    ----------
    frame : Frame
        With its ground truth.
    scene : Scene
    x, y : int
        Column and row.

    Returns
    -------
    dict
        `index` and `eye` of the frame; `values` by name, as JSON can hold them, None for what is infinite; `psf` and
        `lens` as `point_spread` and `lens_figures` give them, of the pixel's depth.
    """
    values: dict[str, Any] = {"x": x, "y": y}
    values["codes"] = _plain(encode(frame.color[y, x], min(frame.metadata["bits"], 16), scene.image.transfer))
    for name in (
        "color", "sharp", "depth", "blur_radius", "normal", "flow", "object_id", "mask", "filled", "missing", "hidden",
        "flow_occluded", "uv",
    ):  # fmt: skip
        array = getattr(frame, name)
        if array is not None:
            values[name] = _plain(array[y, x])
    known = values.get("object_id", -1)
    if known >= 0:
        item = scene.objects[known]
        values["object"] = item.name or item.shape
    radius, depth = values.get("blur_radius"), values.get("depth")
    if radius is not None and scene.psf.model == "gaussian":
        values["sigma"] = scene.psf.sigma_ratio * abs(radius)
    found: dict[str, Any] = {"index": frame.index, "eye": eye_of(frame), "values": values}
    found["lens"] = lens_figures(scene, depth)
    if radius is not None and values["mask"]:
        found["psf"] = point_spread(scene, radius)
    return found


def point_spread(scene: Scene, radius: float) -> dict[str, Any]:
    """The point spread function of the scene's lens at a signed blur radius, px.

    Returns
    -------
    dict
        `reach`, px: how far weights are from the center; `plot`: base64 of (2 PLOTTED + 1)^2 weights in 8 bits, the
        largest 255; `largest`; `sum`; `centroid`, px; `rms`, px, per axis, which is |R| / 2 of a large disc.
    """
    psf = scene.psf.through(scene.aperture)
    far = max(reach(psf, abs(radius)), 1)
    axis = np.arange(-far, far + 1, dtype=np.float64)
    dx, dy = np.meshgrid(axis, axis)
    table = weights(psf, dx, dy, np.full_like(dx, radius))
    total = float(table.sum())
    center = float((table * dx).sum() / total), float((table * dy).sum() / total)
    second = float((table * ((dx - center[0]) ** 2 + (dy - center[1]) ** 2)).sum() / total)
    plot = np.zeros((2 * PLOTTED + 1, 2 * PLOTTED + 1))
    inside = min(far, PLOTTED)
    size = slice(PLOTTED - inside, PLOTTED + inside + 1), slice(far - inside, far + inside + 1)
    plot[size[0], size[0]] = table[size[1], size[1]]
    codes = np.round(255 * plot / plot.max()).astype(np.uint8)
    return {
        "plot": base64.b64encode(codes.tobytes()).decode(),
        "largest": float(table.max()),
        "sum": total,
        "centroid": [round(part, 9) + 0.0 for part in center],
        "rms": math.sqrt(second / 2),
        "radius": radius,
        "reach": far,
    }


def lens_figures(scene: Scene, depth: float | None) -> dict[str, Any]:
    """Distances in mm that the diagram of the thin lens shows.

    Returns
    -------
    dict
        `focus`, `near` and `far`: in focus, and where |R| is SHARP; `focal_length`, `sensor`, `aperture`; `depth` and
        `image` of the point, and its `radius`, px. None: infinite.
    """
    camera = scene.camera
    power, margin = focus_power(camera), SHARP / blur_scale(camera)
    found = {
        "focus": focus_distance(camera),
        "near": 1 / (power + margin),
        "far": 1 / (power - margin) if power > margin else math.inf,
        "focal_length": camera.focal_length,
        "sensor": camera.sensor_distance,
        "aperture": camera.aperture_diameter,
        "depth": math.inf if depth is None else depth,
        "image": math.inf if depth is None else _image_distance(camera.focal_length, depth),
        "radius": float(blur_radius(camera, 0.0 if depth is None else 1 / depth)),
    }
    return {name: value if math.isfinite(value) else None for name, value in found.items()}


def _image_distance(focal_length: float, depth: float) -> float:
    power = 1 / focal_length - 1 / depth
    return 1 / power if power > 0 else math.inf


def _plain(value: NDArray[Any] | np.generic) -> Any:
    """Numbers and lists for JSON; None for what is not finite."""
    if isinstance(value, np.ndarray) and value.ndim:
        return [_plain(part) for part in value]
    plain = value.item()
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
