"""Cards before walls, one of them in focus or near it: single pixels by what a card hides of the lens."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco

SIDE, FOCUS, STEPS, MARGIN = 32, 250.0, 64, 8
TEXTURES = "#000000", "#ffffff"
ANGLE = math.radians(3.0)  # so that an edge goes through pixels at all places


def scene_of(card: float, wall: float, lit: bool) -> clsco.Scene:
    """The edge of a card goes from top to bottom through the middle of a frame; card, wall: blur radii in px; lit: the
    card is white before a black wall, else black before a white one."""
    near, far = (1 / (1 / FOCUS - radius / 5000.0) for radius in (card, wall))
    px = 0.001 * near
    left = [-100.0 * px * math.cos(ANGLE), 100.0 * px * math.sin(ANGLE), near]
    edge = {
        "shape": "rectangle",
        "center": left,
        "size": [200.0 * px, 200.0 * px],
        "rotation": [0.0, 0.0, math.degrees(ANGLE)],
    }
    camera = {"focal_length": 20.0, "aperture_diameter": 10.0, "focus_distance": FOCUS, "pixel_pitch": 0.02}
    objects = [{**edge, "texture": TEXTURES[lit]}, {"shape": "plane", "distance": far, "texture": TEXTURES[not lit]}]
    return clsco.parse_scene({"camera": {**camera, "resolution": [SIDE, SIDE]}, "object": objects})


def right_values(card: float) -> NDArray[Any]:
    """Part of the lens that a card leaves free, means over the pixels in the middle."""
    within = (np.arange(STEPS) + 0.5) / STEPS - 0.5
    at = np.arange(MARGIN, SIDE - MARGIN) - 0.5 * (SIDE - 1)
    x, y = (at[:, None] + within).reshape(1, -1, 1), (at[:, None] + within).reshape(-1, 1, 1)
    beyond = (x * math.cos(ANGLE) + y * math.sin(ANGLE))[..., 0]  # y goes down
    place = np.clip(beyond / max(abs(card), 1e-9), -1.0, 1.0)
    free = 0.5 + (place * np.sqrt(1.0 - place**2) + np.arcsin(place)) / np.pi
    return np.asarray(free.reshape(at.size, STEPS, at.size, STEPS).mean(axis=(1, 3)))


@pytest.mark.parametrize(
    ("card", "wall", "lit", "most"),
    [
        (0.0, 3.0, True, 0.005), (0.0, 0.6, False, 0.02), (-0.5, 0.0, False, 1e-3), (-1.0, 0.0, False, 1e-3),
        (-3.0, 0.0, False, 1e-3), (-0.5, 0.5, False, 0.01), (-1.2, 1.2, False, 0.007),
        (-8.0, 0.0, False, 1e-3), (-8.0, 1.0, False, 0.004), (-8.0, 2.5, False, 0.005),
    ],
)  # fmt: skip
def test_single_pixels(card: float, wall: float, lit: bool, most: float) -> None:
    frame = clsco.render_frame(scene_of(card, wall, lit), truth=())
    pixels = np.asarray(frame.color).reshape(SIDE, SIDE, -1).mean(axis=-1)[MARGIN:-MARGIN, MARGIN:-MARGIN]
    free = right_values(card)
    assert np.ptp(free) > 0.9
    assert np.abs(pixels - (1.0 - free if lit else free)).max() < most
