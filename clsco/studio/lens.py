"""Figures of the lens (distances and the range in focus) for the inspector and for the strip above the picture."""

from __future__ import annotations

import math
from typing import Any

from clsco.optics.lens import SHARP, Lens
from clsco.optics.lens_path import reference_camera
from clsco.scene.model import Scene
from clsco.studio.tables import BY_FOCAL_LENGTH


def lens_line(scene: Scene) -> dict[str, Any]:
    """Figures for the strip above the picture: `lens_figures` of a point at infinity, and three more in mm.

    These are `pitch`, the pixel pitch; `scale`, the distance s0 that sets the scale of the image; and `ends`, the ends
    of the slider for the focus distance.
    """
    camera = reference_camera(scene)
    ends = [factor * camera.focal_length for factor in BY_FOCAL_LENGTH["focus_distance"]]
    return lens_figures(scene, None) | {
        "pitch": camera.pixel_pitch,
        "scale": camera.normalization_distance,
        "ends": ends,
    }


def lens_figures(scene: Scene, depth: float | None, slopes: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """Figures for the diagram of the lens and a point, mm; infinite values are None.

    depth: depth of the point, None for infinity. slopes: its X / Z and Y / Z. Returns `focus`, the distance in focus;
    `near` and `far`, the distances where |R| = SHARP; `sensor`, the distance of the sensor; `aperture`, the diameter;
    `image`, the distance of the point's image; and `radius`, R of the point in px.
    """
    camera = reference_camera(scene)
    lens = Lens.of(camera, scene.lens)
    power, margin = lens.focus_power, SHARP / lens.blur_scale
    found = {
        "focus": camera.focused_distance,
        "near": 1 / (power + margin),
        "far": 1 / (power - margin) if power > margin else math.inf,
        "focal_length": camera.focal_length,
        "sensor": camera.sensor_distance,
        "aperture": camera.aperture_diameter,
        "depth": math.inf if depth is None else depth,
        "image": math.inf if depth is None else _image_distance(camera.focal_length, depth),
        "radius": float(lens.image_radius(0.0 if depth is None else 1 / depth, *slopes)),
    }
    return {name: value if math.isfinite(value) else None for name, value in found.items()}


def _image_distance(focal_length: float, depth: float) -> float:
    power = 1 / focal_length - 1 / depth
    return 1 / power if power > 0 else math.inf
