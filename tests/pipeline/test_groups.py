"""Objects that move together, from scene to frame: the device against the reference, and against own motions."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.frame.frame import TRUTH_NAMES
from clsco.scene.model import Scene
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

CAMERA = {"resolution": [48, 36], "pixel_pitch": 0.1, "aperture_diameter": 20.0, "focus_distance": 250.0}
PLAIN = {"silhouette_samples": 1, "tilt": False, "edge": "sampled"}  # compiled in a third of the time
GOING = {"velocity": [6.0, -4.0, 12.0], "angular_velocity": [5.0, 20.0, -10.0]}
LOAD = {"shape": "sphere", "center": [3.0, 10.0, 265.0], "radius": 9.0, "group": "cart", "texture": "bricks"}
CART = {"shape": "plane", "distance": 270.0, "bounds": [[-25.0, 25.0], [-12.0, 12.0], [-1.0, 1.0]], "group": "cart"}
CART |= {"rotation": [70.0, 0.0, 0.0], "texture": "siemens_star"}
WALL = {"shape": "plane", "distance": 380.0, "texture": "checkerboard"}
GROUP = {"name": "cart", "origin": [0.0, -5.0, 270.0], "motion": GOING}
scene = partial(scene_from, {"camera": CAMERA, "psf": PLAIN, "sequence": {"samples": 2}, "group": [GROUP]})
SCENES: dict[str, Scene] = {
    "cart": scene(CART, LOAD | {"motion": {"angular_velocity": [0.0, 90.0, 30.0]}}, WALL),
    "forward": scene(CART, LOAD, WALL, motion={"warp": "forward"}),
    "stereo": scene(CART, LOAD, stereo={"baseline": 20.0}),
}


@pytest.mark.parametrize("name", mostly_slow(SCENES, ("cart",)))
def test_device_against_reference(name: str) -> None:
    frames = rendered(SCENES[name])
    assert_agree(frames, reference_frames(SCENES[name]))
    assert frames[0].flow is not None
    assert np.abs(frames[0].flow).max() > 1.0


@pytest.mark.parametrize("warp", mostly_slow(["inverse", "forward"], ["inverse"]))
def test_a_group_of_one_is_a_motion_of_its_own(warp: str) -> None:
    """The same bits."""
    options: dict[str, Any] = {"motion": {"warp": warp}}
    alone = {key: value for key, value in LOAD.items() if key != "group"}
    (carried,) = clsco.render(scene(LOAD, WALL, group=[{"name": "cart", "motion": GOING}], **options))
    (own,) = clsco.render(scene(alone | {"motion": GOING}, WALL, group=[], **options))
    for name in ("color", *TRUTH_NAMES):
        np.testing.assert_array_equal(getattr(carried, name), getattr(own, name))
