"""Choice between ellipses and discs for the blur in a distorted image."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from clsco.inputs.pupils import scene_point_spread
from clsco.optics.distortion import DistortedCamera
from clsco.optics.lens_path import reference_camera
from clsco.optics.motion import Eye
from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.circle import Circle
from clsco.optics.rays import ray_slopes
from clsco.plan.decisions import hides_nothing
from clsco.plan.predict import is_forward
from clsco.scene.model import Scene

PLACES = 33  # positions along each axis of the frame at which ellipses are examined
ROUND = 0.01  # fraction of R: discs whose edges are at most this far from those of ellipses replace them
BEYOND = 1.1  # safety factor for positions between PLACES and in the guard band


def elliptic_spread(scene: Scene, psf: PointSpread | None, eye: Eye) -> PointSpread:
    """The PSF of a view of a scene: `psf`, or by default the PSF that the scene specifies.

    If distortion makes its discs ellipses, and the method supports ellipses, `stretched` is set to their margin.
    """
    psf = psf or scene_point_spread(scene)
    off = ellipticity_of(scene)
    plain = type(psf.pupil) is Circle and psf.edge == "integrated" and not psf.rims
    layered = scene.psf.occlusion == "layered" and not hides_nothing(scene)
    by_rays = scene.is_analytic and not layered and not is_forward(scene, eye)
    return replace(psf, stretched=BEYOND * off) if plain and by_rays and off > ROUND else psf


def ellipticity_of(scene: Scene) -> float:
    """Largest distance in the frame between the edges of an ellipse and of a disc of the same area, as a fraction of R;
    0 without distortion.
    """
    camera = reference_camera(scene)
    return _ellipticity(camera) if isinstance(camera, DistortedCamera) else 0.0


@lru_cache(maxsize=16)
def _ellipticity(camera: DistortedCamera) -> float:
    columns, rows = camera.frame_size
    x, y = ray_slopes(camera, np.linspace(0.0, rows - 1.0, PLACES)[:, None], np.linspace(0.0, columns - 1.0, PLACES))
    return float(camera.distortion.ellipticity(x, y).max())
