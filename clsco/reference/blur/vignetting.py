"""Vignetting of a blurred image."""

from __future__ import annotations

import numpy as np

from clsco.optics.vignetting import throughput
from clsco.reference.common.geometry import Array
from clsco.scene.lens import Vignetting
from clsco.scene.model import Camera


def vignette(plane: Array, camera: Camera, kind: Vignetting) -> Array:
    """A plane (m, n, C) of the frame of a camera, darkened as the key of the scene says."""
    return np.asarray(plane * throughput(camera, kind)[..., None])
