"""Figures of the lens, distances and the range in focus, for the strip below the picture."""

from __future__ import annotations

import math
from typing import Any

from clsco.optics.lens import SHARP, Lens
from clsco.optics.lens_path import reference_camera
from clsco.scene.model import Scene
from clsco.scene.spread import APERTURE_KEYS


def lens_line(scene: Scene) -> dict[str, Any]:
    """Figures for the strip, mm; infinite values are None.

    Returns `focus`, the distance in focus; `near` and `far`, the distances where |R| = SHARP; `focal_length`;
    `aperture`, the diameter; and `opening`, the keys of [aperture] by which it is drawn.
    """
    camera = reference_camera(scene)
    lens = Lens.of(camera, scene.lens)
    power, margin = lens.focus_power, SHARP / lens.blur_scale
    found = {
        "focal_length": camera.focal_length, "aperture": camera.aperture_diameter, "focus": camera.focused_distance,
        "near": 1 / (power + margin), "far": 1 / (power - margin) if power > margin else math.inf,
    }  # fmt: skip
    opening = {key: getattr(scene.aperture, key) for key in ("shape", *APERTURE_KEYS, "squeeze")}
    return {name: value if math.isfinite(value) else None for name, value in found.items()} | {"opening": opening}
