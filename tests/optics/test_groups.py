"""Objects that move together: their poses, and what a plan makes of a group's motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clsco.optics.image_motion import image_paths
from clsco.optics.motion import Pose, pose_at, poses_at, rest_center
from clsco.scene.model import Camera, CameraMotion, Group, Motion, ObjectMotion, Plane, Scene, Sphere
from tests.optics.grids import Array
from tests.scenes import plan_of, scene_of

CART = ObjectMotion(velocity=(3.0, -2.0, 9.0), angular_velocity=(25.0, -40.0, 60.0))
OWN = ObjectMotion(velocity=(-1.0, 5.0, 2.0), angular_velocity=(10.0, 30.0, -20.0))
TURNING = ObjectMotion(angular_velocity=(0.0, 10.0, 0.0))
POINTS = np.random.default_rng(1).uniform(-50.0, 50.0, (20, 3)) + np.array([0.0, 0.0, 280.0])


def moved(points: Array, pose: Pose, center: Array) -> Array:
    return np.asarray(center + pose.shift + (points - center) @ pose.rotation.T)


@pytest.mark.parametrize("rotation", ["euler", "axis"])
@pytest.mark.parametrize("own", [ObjectMotion(), OWN], ids=["still", "moving"])
def test_an_object_moves_in_its_group_and_then_with_it(own: ObjectMotion, rotation: str) -> None:
    """First about its own origin by its own motion, then about the group's; a camera that moves comes last."""
    origin = (10.0, 20.0, 300.0)
    group = Group(name="cart", origin=origin, motion=CART)
    ball = Sphere(center=(5.0, -3.0, 280.0), group="cart", motion=own)
    motion = Motion.model_validate({"rotation": rotation})
    alone = Scene(objects=(ball, Plane()), groups=(group,), motion=motion)
    pose, other = poses_at(alone, 0.7)
    center = rest_center(ball)
    first = moved(POINTS, pose_at(own, 0.7, rotation), center)
    expected = moved(first, pose_at(CART, 0.7, rotation), np.array(origin))
    np.testing.assert_allclose(moved(POINTS, pose, center), expected, rtol=0, atol=1e-12)
    assert (other.rotation == np.eye(3)).all()
    assert not other.shift.any()
    camera = Camera(motion=CameraMotion(velocity=(1.0, 2.0, 3.0), angular_velocity=(4.0, 5.0, 6.0)))
    seen, _ = poses_at(Scene(objects=(ball, Plane()), groups=(group,), motion=motion, camera=camera), 0.7)
    rig = pose_at(camera.motion, 0.7, rotation)
    before = (expected - rig.shift) @ rig.rotation
    np.testing.assert_allclose(moved(POINTS, seen, center), before, rtol=0, atol=1e-12)


def test_a_group_turns_about_its_first_object_unless_it_says_otherwise() -> None:
    items = (Plane(), Sphere(center=(5.0, -3.0, 280.0), group="cart"), Sphere(center=(9.0, 9.0, 300.0), group="cart"))
    turning = Group(name="cart", motion=TURNING)
    _, first, second = poses_at(Scene(objects=items, groups=(turning,)), 1.0)
    assert not first.shift.any()
    assert np.abs(second.shift).max() > 1.0
    about = turning.model_copy(update={"origin": items[2].center})
    _, first, second = poses_at(Scene(objects=items, groups=(about,)), 1.0)
    assert np.abs(first.shift).max() > 1.0
    assert not second.shift.any()


def test_a_group_that_only_moves_adds_its_way_exactly() -> None:
    going = ObjectMotion(velocity=(3.0, -2.0, 9.0))
    ball = Sphere(center=(5.1, -3.3, 280.7))
    alone = poses_at(Scene(objects=(ball.model_copy(update={"motion": going}),)), 0.7)[0]
    carried = ball.model_copy(update={"group": "cart"})
    found = poses_at(Scene(objects=(carried,), groups=(Group(name="cart", motion=going, origin=(1.1, 2.2, 3.3)),)), 0.7)
    np.testing.assert_array_equal(found[0].shift, alone.shift)
    np.testing.assert_array_equal(found[0].rotation, alone.rotation)


def test_what_a_group_moves_moves_in_the_plan() -> None:
    ball = Sphere(group="cart")
    moving, still = Group(name="cart", motion=ObjectMotion(velocity=(10.0, 0.0, 0.0))), Group(name="cart")
    assert not scene_of(ball, groups=(still,)).moves
    assert not scene_of(Sphere(), groups=(moving,)).moves  # nobody is in it
    carried = scene_of(ball, size=(640, 480), groups=(moving,))
    assert carried.moves
    (path,) = image_paths(carried, (None,), 0)
    assert path.longest == pytest.approx(80.0, rel=1e-3)
    assert plan_of(ball, groups=(moving,)).samples > 50


def test_a_plane_that_its_group_tilts_has_many_radii() -> None:
    def blur(**motion: Any) -> str:
        group = Group(name="cart", motion=ObjectMotion(**motion))
        return plan_of(Plane(distance=280.0, group="cart"), groups=(group,)).blur

    assert blur(velocity=(1.0, 0.0, 0.0)) == blur(angular_velocity=(0.0, 0.0, 5.0)) == "convolve"
    assert blur(angular_velocity=(0.0, 5.0, 0.0)) == "gather"
