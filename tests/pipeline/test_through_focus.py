"""Tilted planes that the plane in focus cuts: what leaves a pixel is the blur at its edges, in closed form."""

from __future__ import annotations

import math
from itertools import product
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from tests.scenes import scene_from
from tests.slow import combined

SIDE = 24  # px
CAMERA: dict[str, Any] = {"resolution": [SIDE, SIDE], "pixel_pitch": 0.1, "focus_distance": 250.0}
OVER_AN_EDGE = 2 / (3 * math.pi)  # what lies to one side of a disc's middle: the mean distance, in its radii
Engine = Literal["device", "reference"]
SLOPES = [(1.5, 0.0), (0.0, -1.5), (1.0, 1.5), (-0.7, 0.4)]
CASES = combined(SLOPES, ("device", "reference"), kept=[*product(SLOPES, ["device"]), ((1.0, 1.5), "reference")])


def image(slope: tuple[float, float], distance: float, texture: Any, engine: Engine) -> tuple[NDArray[Any], ...]:
    """Light and blur radius, px, (SIDE, SIDE) each, of a tilted plane."""
    item = {"shape": "plane", "distance": distance, "slope_x": slope[0], "slope_y": slope[1], "texture": texture}
    made = scene_from({"camera": CAMERA}, item)
    if engine == "reference":
        (frame,) = clsco.reference.render(made)
    else:
        frame = clsco.render_frame(made, truth=["blur_radius"])
    return tuple(np.asarray(plane, np.float64).reshape(SIDE, SIDE) for plane in (frame.color, frame.blur_radius))


@pytest.mark.parametrize(("slope", "engine"), CASES)
def test_light_that_leaves_a_pixel(slope: tuple[float, float], engine: Engine) -> None:
    """A white pixel in a black plane, with the line in focus at several places within and beside it."""
    picture, at = np.zeros((SIDE, SIDE), np.float32), SIDE // 2
    picture[at, at] = 1.0
    for distance in (249.4, 249.9, 250.4):
        found, radius = image(slope, distance, picture, engine)
        near = radius[at - 1 : at + 2, at - 1 : at + 2]
        right, down = (near[1, 2] - near[1, 0]) / 2, (near[2, 1] - near[0, 1]) / 2
        ends = np.array([-0.5, 0.5])
        corners = OVER_AN_EDGE * np.abs(near[1, 1] + ends * right + ends[:, None] * down)
        # Along an edge at which R keeps its sign this is the mean of |R|; tables are good to 1 % of so little light.
        beside = found[[at, at, at - 1, at + 1], [at - 1, at + 1, at, at]]
        expected = np.concatenate([corners.mean(axis=0), corners.mean(axis=1)])
        np.testing.assert_allclose(beside, expected, rtol=0.02, atol=1e-5)
