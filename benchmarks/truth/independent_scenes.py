"""Scenes of `independent.py`, each the content of a scene file of 192 x 192 px."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

SIZE = 192
RED, GREEN, BLUE, SAND, GRAY = "#d02818", "#30b048", "#2850d0", "#e0c080", "#a0a0a0"

Content = dict[str, Any]


def _scene(*objects: Content, focus: float = 250.0, aperture: float = 10.0, **tables: Any) -> Content:
    """A scene whose R in px is 500 aperture (1 / focus - 1 / Z)."""
    camera = {
        "focal_length": 20.0, "pixel_pitch": 0.02, "resolution": [SIZE, SIZE], "focus_distance": focus,
        "aperture_diameter": aperture,
    }  # fmt: skip
    return {"camera": camera, "object": list(objects), **tables}


def _box(**keys: Any) -> Content:
    box = {"shape": "box", "center": [0.0, 0.0, 280.0], "size": [26.0, 20.0, 22.0], "rotation": [24.0, 35.0, 10.0]}
    return {**box, "texture": SAND, **keys}


def _wall(distance: float = 360.0, texture: Any = GRAY) -> Content:
    return {"shape": "plane", "distance": distance, "texture": texture}


def _smooth(seed: int, rows: int = SIZE, columns: int = SIZE) -> Any:
    """An image (rows, columns, 3) of a few waves, float: linear radiance."""
    draw = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns]
    waves = [
        np.cos(x * draw.uniform(-0.3, 0.3) + y * draw.uniform(-0.3, 0.3) + draw.uniform(0, 6))[..., None]
        * draw.uniform(0, 0.12, 3)
        for _ in range(4)
    ]
    return np.asarray(0.5 + sum(waves), np.float32)


def _cards(degrees: float, depth: float) -> tuple[Content, Content]:
    """Two cards that share the edge x = 0, which is nearest to the camera."""
    width, angle = 24.0, math.radians(degrees)
    x, z = width / 2 * math.cos(angle), width / 2 * math.sin(angle)
    card = {"shape": "rectangle", "size": [width, 30.0]}
    left = {**card, "center": [-x, 0.0, depth + z], "rotation": [0.0, degrees, 0.0], "texture": RED}
    right = {**card, "center": [x, 0.0, depth + z], "rotation": [0.0, -degrees, 0.0], "texture": SAND}
    return left, right


def _floor(texture: Any = GRAY) -> Content:
    """The plane 20 mm below the optical axis, a little tilted: y = -20 + (Z - 300) / 10."""
    return {"shape": "plane", "distance": 500.0, "slope_y": 10.0, "texture": texture}


def _on_floor(shape: str, depth: float, **keys: Any) -> Content:
    """A sphere that rests on the floor, or a card that stands on it and faces the camera."""
    foot = np.array([0.0, -20.0 + (depth - 300.0) / 10, depth])
    if shape == "sphere":
        center = foot + 12.0 * np.array([0.0, 10.0, -1.0]) / math.sqrt(101.0)
        return {"shape": "sphere", "radius": 12.0, "center": center.tolist(), "texture": SAND, **keys}
    center = foot + np.array([0.0, 12.0, 0.0])
    return {"shape": "rectangle", "size": [22.0, 24.0], "center": center.tolist(), "texture": SAND, **keys}


def _can(depth: float, **keys: Any) -> tuple[Content, ...]:
    """A bounded tube with disc caps, seen from the side and from above."""
    turn = [-35.0, 0.0, 20.0]
    pose = {"center": [0.0, 0.0, depth], "rotation": turn, **keys}
    bounds = [[-20.0, 20.0], [-13.0, 13.0], [-20.0, 20.0]]
    tube = {"shape": "cylinder", "radius": 9.0, "axis": [0.0, 1.0, 0.0], "bounds": bounds, "texture": SAND, **pose}
    # A disc faces the camera before it is turned: a quarter about x lays it flat, and its offset is along the axis.
    lid = {"shape": "disc", "radius": 9.0, "center": pose["center"], "rotation": [turn[0] + 90.0, *turn[1:]], **keys}
    return tube, {**lid, "offset": 13.0, "texture": RED}, {**lid, "offset": -13.0, "texture": BLUE}


def _cone(depth: float) -> tuple[Content, Content]:
    """A cone whose apex touches a disc."""
    cone = {"shape": "cone", "apex": [0.0, 0.0, depth], "half_angle": 35.0, "texture": SAND}
    cone |= {"nappe": "towards", "rotation": [60.0, 0.0, 20.0], "bounds": [[-30, 30], [-30, 30], [-20.0, 0.0]]}
    disc = {"shape": "disc", "center": [0.0, 0.0, depth], "radius": 16.0, "rotation": [60.0, 0.0, 20.0]}
    return {**disc, "texture": RED}, cone


MOVING = {"motion": {"velocity": [6.0, 3.0, -4.0], "angular_velocity": [0.0, 12.0, 8.0]}}

FASTER = {"velocity": [-4.0, 3.0, 0.0], "acceleration": [14.0, -8.0, 10.0], "angular_acceleration": [0.0, 30.0, 12.0]}
SWAY = {
    "keyframe": [
        {"time": 0.0},
        {"time": 0.4, "position": [5.0, 2.0, -3.0], "rotation": [0.0, 0.0, 25.0]},
        {"time": 1.0, "position": [-1.0, 4.0, 2.0], "rotation": [0.0, 0.0, -10.0]},
    ]
}
JUMP = {"keyframe": [{"time": 0.0}, {"time": 0.3, "position": [5.0, 2.0, 0.0]}], "interpolation": "step"}

SCENES: dict[str, Callable[[], Content]] = {
    "box in focus": lambda: _scene(_box(), focus=272.0),
    "box": lambda: _scene(_box()),
    "box R 8": lambda: _scene(_box(), focus=195.0),
    "box moving": lambda: _scene(_box(**MOVING)),
    "box accelerated before a plane": lambda: _scene(_box(motion=FASTER), _wall()),
    "box between keyframes": lambda: _scene(_box(motion=SWAY), _wall()),
    "box that jumps": lambda: _scene(_box(motion=JUMP), _wall()),
    "box before a plane": lambda: _scene(_box(), _wall()),
    "box before a plane, R 16": lambda: _scene(_box(), _wall(), focus=190.0, aperture=16.0),
    "box moving before a plane": lambda: _scene(_box(**MOVING), _wall()),
    "box on a plane": lambda: _scene(_box(rotation=[0.0, 35.0, 0.0], center=[0.0, -11.8, 280.0]), _floor()),
    "cards in focus": lambda: _scene(*_cards(40.0, 270.0), focus=275.0),
    "cards": lambda: _scene(*_cards(40.0, 270.0), _wall()),
    "cards folded away": lambda: _scene(*_cards(-40.0, 290.0), _wall()),
    "cards R 10": lambda: _scene(*_cards(40.0, 270.0), _wall(), focus=180.0),
    "card on a plane": lambda: _scene(_on_floor("card", 290.0), _floor()),
    "card on a plane, in focus": lambda: _scene(_on_floor("card", 290.0), _floor(), focus=290.0),
    "sphere on a plane": lambda: _scene(_on_floor("sphere", 290.0), _floor()),
    "sphere on a plane, in focus": lambda: _scene(_on_floor("sphere", 290.0), _floor(), focus=280.0),
    "can": lambda: _scene(*_can(280.0)),
    "can in focus": lambda: _scene(*_can(280.0), focus=272.0),
    "can moving": lambda: _scene(*_can(280.0, motion={"velocity": [6.0, 3.0, -4.0]})),
    "can before a plane": lambda: _scene(*_can(280.0), _wall()),
    "cone on a disc": lambda: _scene(*_cone(280.0)),
    "cone on a disc, in focus": lambda: _scene(*_cone(280.0), focus=278.0),
    "upright cylinder": lambda: _scene(
        {"shape": "cylinder", "center": [3.0, 0.0, 280.0], "radius": 12.0, "texture": SAND}, _wall()
    ),
    "card before a background": lambda: _scene(
        {"shape": "rectangle", "size": [34.0, 30.0], "center": [2.0, 1.0, 270.0], "texture": SAND},
        {"shape": "background", "texture": _smooth(1)},
    ),
    "fine texture on a sphere": lambda: _scene(
        {
            "shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 17.0, "texture": _smooth(2, 128, 256) ** 2,
            "texture_mapping": "surface", "texture_repeats": [8, 4],
        },
        focus=268.0,
    ),
    "crossing the focus": lambda: _scene(
        {"shape": "plane", "distance": 275.0, "slope_x": 2.5, "texture": _smooth(3)},
        {"shape": "sphere", "center": [6.0, 2.0, 246.0], "radius": 12.0, "texture": SAND},
        {
            "shape": "rectangle", "size": [16.0, 40.0], "center": [-12.0, 0.0, 250.0], "rotation": [50.0, 0.0, 0.0],
            "texture": RED,
        },
    ),
    "three depths": lambda: _scene(
        {"shape": "sphere", "center": [-9.0, 3.0, 220.0], "radius": 8.0, "texture": RED},
        {"shape": "cylinder", "center": [6.0, 0.0, 260.0], "radius": 7.0, "axis": [0.3, 1.0, 0.2], "texture": SAND},
        {"shape": "rectangle", "size": [40.0, 16.0], "center": [0.0, -6.0, 300.0], "texture": BLUE},
        _wall(380.0, _smooth(4)),
    ),
    "wide tube": lambda: _scene(
        {
            "shape": "cylinder", "center": [2.0, 1.0, 250.0], "radius": 18.0, "axis": [0.2, 0.12, 1.0],
            "bounds": [[-60.0, 60.0], [-60.0, 60.0], [-40.0, 40.0]], "texture": _smooth(5),
        },
        _wall(380.0),
    ),
    "turned quadrics": lambda: _scene(
        {
            "shape": "ellipsoid", "center": [-9.0, 3.0, 270.0], "semi_axes": [12.0, 6.0, 8.0],
            "rotation": [20.0, 30.0, 40.0], "texture": _smooth(6), **MOVING,
        },
        {"shape": "cone", "apex": [9.0, 0.0, 262.0], "half_angle": 30.0, "bounds": [[-40, 40], [-40, 40], [0, 20]],
         "rotation": [10.0, 20.0, 0.0], "texture": _smooth(7)},
        _wall(340.0, _smooth(8)),
    ),
}  # fmt: skip
