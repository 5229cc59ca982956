"""Bounds that touch a surface leave its picture as it is: no slit along what they touch, sharp or blurred."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clsco.scene.model import Scene
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

CAMERA: dict[str, Any] = {"resolution": [64, 64], "pixel_pitch": 0.07, "f_number": 2.0, "focus_distance": 262.0}
WALL = {"shape": "plane", "distance": 330.0, "texture": "#ffffff"}
BODY: dict[str, Any] = {"center": [0.0, 0.0, 275.0], "rotation": [20.0, 30.0, 10.0], "texture": "#404040"}
WIDE = [-40.0, 40.0]
NINE, BEYOND, ENDS = [-9.0, 9.0], [-9.001, 9.001], [-14.0, 14.0]
TUBE = BODY | {"shape": "cylinder", "radius": 9.0}
BALL = BODY | {"shape": "sphere", "radius": 9.0}
EGG = BODY | {"shape": "ellipsoid", "semi_axes": [9.0, 7.0, 5.0]}
ROUND = BODY | {"shape": "quadric", "coefficients": [1, 1, 1, 0, 0, 0, 0, 0, 0, -81]}
BOARD = BODY | {"shape": "plane", "distance": 275.0}
del BOARD["center"]
# The object, bounds that touch it, and others that cut the same and touch nothing, None for no bounds at all.
CASES: dict[str, tuple[dict[str, Any], Any, Any]] = {
    "tube": (TUBE, [NINE, ENDS, NINE], [WIDE, ENDS, WIDE]),
    "tube, just beyond": (TUBE, [BEYOND, ENDS, BEYOND], [WIDE, ENDS, WIDE]),
    "ball": (BALL, [NINE] * 3, None),
    "half of a ball": (BALL, [NINE, NINE, [0.0, 9.0]], [WIDE, WIDE, [0.0, 40.0]]),
    "egg": (EGG, [NINE, [-7.0, 7.0], [-5.0, 5.0]], None),
    "quadric": (ROUND, [NINE] * 3, None),
    "plane": (BOARD, [NINE, NINE, [0.0, 5.0]], [NINE, NINE, [-5.0, 5.0]]),
}


def scene(item: dict[str, Any], bounds: Any) -> Scene:
    """An object before a white wall, which any slit would show."""
    bounded = item if bounds is None else item | {"bounds": bounds}
    return scene_from({"camera": CAMERA}, bounded, WALL)


@pytest.mark.parametrize("name", mostly_slow(CASES, ("tube",)))
@pytest.mark.parametrize("precision", ["double", pytest.param("single", marks=pytest.mark.slow)])
def test_no_slit(name: str, precision: str) -> None:
    item, touching, free = CASES[name]
    (found,) = rendered(scene(item, touching), truth=("depth",), precision=precision)
    (expected,) = rendered(scene(item, free), truth=("depth",), precision=precision)
    # Wide bounds make the ball wider beyond which nothing is asked of an outline: 0.006 of white.
    np.testing.assert_allclose(found.color, expected.color, rtol=0, atol=0.01 if free else 0)
    np.testing.assert_array_equal(found.depth, expected.depth)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_reference_has_no_slit_either(name: str) -> None:
    item, touching, _ = CASES[name]
    small = scene(item, touching).replace("camera.resolution", [32, 32]).replace("camera.pixel_pitch", 0.14)
    assert_agree(rendered(small, precision="double"), reference_frames(small))
