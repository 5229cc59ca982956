"""A scene that several files look at, and frames in strips beside whole ones."""

from __future__ import annotations

from typing import Any

import numpy as np

import clsco
from clsco.frame.frame import Frame
from clsco.opencl.device import choose
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene

CAMERA: dict[str, Any] = {
    "resolution": [48, 36], "pixel_pitch": 0.1, "aperture_diameter": 20.0, "focus_distance": 250.0,
}  # fmt: skip
BALL: dict[str, Any] = {"shape": "sphere", "center": [3.0, 4.0, 265.0], "radius": 9.0, "texture": "bricks"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 330.0, "texture": "checkerboard"}
# Where something else than the PSF is looked at: compiled in a third of the time.
PLAIN = {"edge": "sampled", "tilt": False, "silhouette_samples": 1}


def assert_strips_agree(wanted: Scene, truth: tuple[str, ...] = ()) -> Frame:
    """All arrays of the first frame have the bits of the whole one where memory is a byte short of it; gives that."""
    memory = device_bytes(prepare(wanted, Request(truth), choose()).plan) - 1
    whole, cut = (clsco.render_frame(wanted, truth=truth, memory=limit) for limit in (None, memory))
    assert cut.metadata["strips"] > whole.metadata["strips"] == 1
    for name, array in whole.arrays().items():
        np.testing.assert_array_equal(cut.arrays()[name], array, err_msg=name, strict=True)
    return whole
