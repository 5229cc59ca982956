"""Small drawings beside the keys of shutter, aperture and lens: what these do, from the code that renders."""

from __future__ import annotations

from typing import Any

import numpy as np

from clsco.optics.exposure import curve_integral
from clsco.optics.lens_path import reference_camera
from clsco.optics.rays import slopes_at
from clsco.scene.model import Psf, Scene
from clsco.studio.inspector import PLOTTED, point_spread

TIMES = 64  # of a curve
PUPIL_PX, SPREAD_PX = 28.0, 12.0  # |R| of what is drawn
SHARES = (-0.45, 0.0, 0.45)  # of the frame's width and height, where spreads are drawn


def drawings(scene: Scene) -> dict[str, Any]:
    """Data of the drawings.

    Parameters
    ----------
    scene : Scene
        With the resolution of its frame.

    Returns
    -------
    dict
        `curve`: opening of the shutter at equal times, the largest 1; `side` of the plots that follow, px; `pupil`: the
        aperture, as the light of a point before the focal surface shows it; `spreads`: rows of point spread functions
        with R = SPREAD_PX over the frame, from its upper left. Plots are base64 of bytes, the largest of each 255.
    """
    ends = np.linspace(0.0, 1.0, TIMES + 1)
    curve = np.diff(curve_integral(scene.sequence.shutter_curve, ends))
    geometric = scene.model_copy(update={"psf": Psf(model="pillbox")})
    columns, rows = scene.camera.frame_size
    return {
        "curve": (curve / curve.max()).round(4).tolist(),
        "side": 2 * PLOTTED + 1,
        "pupil": _plot(geometric, -PUPIL_PX, 0.0, 0.0),
        "spreads": [[_plot(scene, SPREAD_PX, x * columns, y * rows) for x in SHARES] for y in SHARES],
    }


def _plot(scene: Scene, radius: float, right: float, down: float) -> str:
    """Plot of the light of a point that the frame has there, px from its middle."""
    camera = reference_camera(scene)
    slopes = slopes_at(camera, np.array(right), np.array(-down))
    place, inverse = (float(slopes[0]), float(slopes[1])), 1.0 / camera.focused_distance  # for rims of the lens
    found: str = point_spread(scene, radius, np.zeros(2), place, inverse)["plot"]
    return found
