"""Scenes and surfaces that the tests of the reference share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from clsco.optics.motion import pose_at
from clsco.optics.quadrics import PlacedSurface, place
from clsco.scene.model import Camera, Object, Scene

SceneMaker = Callable[..., Scene]
Placer = Callable[..., PlacedSurface]


@pytest.fixture
def make_scene() -> SceneMaker:
    """Scene of one object with the thesis' camera: make_scene(item, (rows, columns), **sections)."""

    def make(item: Object, shape: tuple[int, int] = (64, 64), **sections: Any) -> Scene:
        camera = sections.pop("camera", {})
        return Scene(camera=Camera(resolution=(shape[1], shape[0]), **camera), objects=(item,), **sections)

    return make


@pytest.fixture
def at() -> Placer:
    """Surface of an object at a time in s: at(item, time)."""

    def surface(item: Object, time: float = 0.0, rotation: str = "euler") -> PlacedSurface:
        return place(item, pose_at(item.motion, time, rotation))

    return surface
