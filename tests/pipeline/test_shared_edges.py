"""Surfaces that share an edge: nothing is seen through it, and neither hides the other where both are seen."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import clsco
from clsco.scene.model import Camera, Plane, Rectangle, Scene
from tests.slow import mostly_slow

Array = NDArray[np.float64]
WALL = Plane(distance=360.0, texture="#ffffff")


def rendered(focus: float, *items: Rectangle) -> tuple[Array, Array]:
    """Color and numbers of the objects (64, 64)."""
    camera = Camera(pixel_pitch=0.04, resolution=(64, 64), focus_distance=focus)
    (frame,) = clsco.render(Scene(camera=camera, objects=(*items, WALL)), truth=("object_id",))
    return np.asarray(frame.color, float).reshape(64, 64, -1)[..., 0], np.asarray(frame.object_id)


# Blurred by 2 px, in focus, and blurred by 11 px. Without the union of both cards 0.09, 0.136 and 0.019.
@pytest.mark.parametrize(
    ("focus", "limit"), mostly_slow([(250.0, 0.02), (276.0, 0.045), (190.0, 0.003)], [(250.0, 0.02)])
)
def test_a_card_that_is_cut_in_two_hides_as_much(focus: float, limit: float) -> None:
    """Black before white, turned by 20 degrees: the columns in the middle, which hold the cut."""
    turn = np.radians(20.0)
    along = np.array([np.cos(turn), -np.sin(turn), 0.0])

    def card(way: float, width: float) -> Rectangle:
        center = tuple((np.array([0.0, 0.0, 280.0]) + way * along).tolist())
        return Rectangle(center=center, size=(width, 24.0), rotation=(0.0, 0.0, 20.0), texture="#000000")

    whole, _ = rendered(focus, card(0.0, 30.0))
    halves, _ = rendered(focus, card(-7.5, 15.0), card(7.5, 15.0))
    assert np.abs(halves - whole)[:, 16:48].max() < limit


# Without both the union and edges at the tilt of the source 0.026, 0.047 and 0.0099.
@pytest.mark.parametrize(
    ("focus", "limit"), mostly_slow([(250.0, 0.0095), (272.0, 0.03), (195.0, 0.002)], [(272.0, 0.03)])
)
def test_a_box_of_one_color_has_no_lines_along_its_near_edges(focus: float, limit: float) -> None:
    """Gray before white, 6 px and more from its outline."""
    keys = {"center": (0.0, 0.0, 280.0), "size": (26.0, 20.0, 22.0), "rotation": (24.0, 35.0, 10.0)}
    camera = {"pixel_pitch": 0.05, "resolution": (64, 64), "focus_distance": focus}
    box, wall = (
        {"shape": "box", "texture": "#808080", **keys},
        {"shape": "plane", "distance": 360.0, "texture": "#ffffff"},
    )
    (frame,) = clsco.render(clsco.parse_scene({"camera": camera, "object": [box, wall]}), truth=("object_id",))
    color, number = np.asarray(frame.color, float).reshape(64, 64, -1)[..., 0], np.asarray(frame.object_id)
    inside = ndimage.binary_erosion(number != number[0, 0], iterations=6)
    assert inside.sum() > 900
    assert np.ptp(color[inside]) < limit
