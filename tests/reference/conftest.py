"""Surfaces that the tests of the reference share."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from clsco.optics.motion import pose_at
from clsco.optics.quadrics import PlacedSurface, place
from clsco.scene.model import Object

Placer = Callable[..., PlacedSurface]


@pytest.fixture
def at() -> Placer:
    """Surface of an object at a time in s: at(item, time)."""

    def surface(item: Object, time: float = 0.0, rotation: str = "euler") -> PlacedSurface:
        return place(item, pose_at(item.motion, time, rotation))

    return surface
