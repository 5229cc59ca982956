"""Shapes that move while the shutter is open, and the windows in which sources are not still."""

from __future__ import annotations

from typing import Any

import pytest

from clsco.optics.motion import poses_at
from clsco.optics.quadrics import place
from clsco.optics.still import WINDOW_MARGIN, StillSplit, split_still
from clsco.optics.visibility import OcclusionGroup
from clsco.scene.model import (
    Camera,
    Cone,
    Cylinder,
    Disc,
    Object,
    ObjectMotion,
    Plane,
    Quadric,
    Rectangle,
    Scene,
    Sphere,
)

CENTER = (0.0, 0.0, 280.0)
DEEP = ((-40.0, 40.0), (-9.0, 9.0), (-40.0, 40.0))


def turning(x: float, y: float, z: float) -> dict[str, Any]:
    return {"motion": ObjectMotion(angular_velocity=(x, y, z))}


def found(*items: Object, times: tuple[float, ...] = (0.1, 0.4, 0.7)) -> StillSplit:
    scene = Scene(objects=items)
    posed = [zip(items, poses_at(scene, time), strict=True) for time in times]
    return split_still(items, [[place(item, pose) for item, pose in each] for each in posed])


@pytest.mark.parametrize(
    ("item", "moves"),
    [
        (Sphere(center=CENTER, radius=30, **turning(10, 20, 30)), False),
        (Sphere(center=CENTER, radius=30, motion=ObjectMotion(velocity=(0, 1e-3, 0))), True),
        (Cylinder(center=CENTER, radius=30, **turning(0, 50, 0)), False),
        (Cylinder(center=CENTER, radius=30, **turning(1, 50, 0)), True),
        (Cylinder(center=CENTER, radius=30, bounds=DEEP, **turning(0, 50, 0)), False),  # what cuts it turns in itself
        (Cylinder(center=CENTER, radius=30, bounds=((-20, 40), *DEEP[1:]), **turning(0, 50, 0)), True),
        (Cylinder(center=CENTER, radius=30, motion=ObjectMotion(velocity=(0, 9, 0))), False),  # along its axis
        (Cylinder(center=CENTER, radius=30, bounds=DEEP, motion=ObjectMotion(velocity=(0, 9, 0))), True),
        (Cone(apex=CENTER, half_angle=20, **turning(0, 0, 50)), False),
        (Cone(apex=CENTER, half_angle=20, **turning(0, 50, 0)), True),
        (Plane(distance=280, motion=ObjectMotion(velocity=(3, 4, 0))), False),
        (Plane(distance=280, slope_x=0.1, motion=ObjectMotion(velocity=(3, 4, 0))), True),
        (Rectangle(center=CENTER, motion=ObjectMotion(velocity=(3, 4, 0))), True),
        (Disc(center=CENTER, radius=9, **turning(0, 0, 50)), False),
        (Disc(center=CENTER, radius=9, motion=ObjectMotion(velocity=(1, 0, 0))), True),
        (Quadric(center=CENTER, coefficients=(1, 1, 0, 0, 0, 0, 0, 0, -20, 0), **turning(0, 0, 50)), False),
        (Quadric(center=CENTER, coefficients=(1, 2, 0, 0, 0, 0, 0, 0, -20, 0), **turning(0, 0, 50)), True),
    ],
)
def test_shapes_that_turn_or_slide_in_themselves_do_not_move(item: Object, moves: bool) -> None:
    one = found(Sphere(center=(0, 0, 200), radius=5), item)
    assert one.changing == 0b10
    assert one.moving == 0b10 * moves


def test_a_nappe_that_turns_over_moves() -> None:
    cone = Cone(apex=CENTER, half_angle=20, bounds=((-30, 30),) * 3, **turning(0, 180, 0))
    assert found(cone, times=(0.0, 1.0)).moving == 1


def test_a_window_has_all_that_moves_and_its_shadow() -> None:
    camera = Camera(resolution=(200, 100), pixel_pitch=0.05, focal_length=20, aperture_diameter=10, focus_distance=250)
    ball = Sphere(center=(-20, 10, 200), radius=4, motion=ObjectMotion(velocity=(30, 0, 0)))
    one = found(ball, Rectangle(center=CENTER))
    step = 0.05 / camera.normalization_distance
    own = one.window(OcclusionGroup(0b01, 0), camera, 1.0, 8, -8, 116)
    shadow = one.window(OcclusionGroup(0b10, 0b01), camera, 1.0, 8, -8, 116)
    assert own is not None
    assert shadow is not None
    for time in (0.1, 0.7):
        column = 99.5 + 8 + (-20 + 30 * time) / 200 / step
        reach = 4 / 200 / step + WINDOW_MARGIN
        assert own[0] <= column - reach < column + reach <= own[2]
        reach += 5.0 * (1 / 200 - 1 / 280) / step
        assert shadow[0] <= column - reach < column + reach <= shadow[2]
    assert shadow[2] - shadow[0] < 140
    assert one.window(OcclusionGroup(0b10, 0), camera, 1.0, 8, -8, 116) is None
    lower = one.window(OcclusionGroup(0b01, 0), camera, 1.0, 8, 20, 60)
    assert lower is not None
    assert lower[1] == max(own[1] - 28, 0)
    assert one.window(OcclusionGroup(0b01, 0), camera, 1.0, 8, 90, 20) is None


def test_what_has_no_bounds_may_be_anywhere() -> None:
    wall, ball = Plane(distance=300), Sphere(center=(0, 0, 250), radius=9)
    near = Plane(distance=200, motion=ObjectMotion(velocity=(0, 0, 5)))
    one = found(near, wall, ball)
    assert one.has_still(OcclusionGroup(0b110, 0))
    assert not one.has_still(OcclusionGroup(0b110, 0b001))
    assert not one.has_still(OcclusionGroup(0b001, 0))
    camera = Camera(resolution=(20, 10))
    assert one.window(OcclusionGroup(0b110, 0b001), camera, 1.0, 8, -8, 26) == (0, 0, 36, 26)
