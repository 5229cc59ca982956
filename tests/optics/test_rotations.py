"""Static rotations: their matrix, and surfaces that are the same in other words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clsco.optics.motion import TOWARDS_CAMERA, pose_at, rotation_matrix, static_rotation
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.texture_mapping import texture_map
from clsco.reference.common.geometry import solve_quadric, surface_normal
from clsco.scene.model import AnyShape, Cone, Cylinder, Disc, Ellipsoid, ObjectMotion, Plane, Quadric, Rectangle, Sphere
from clsco.scene.rotations import AxisAngle, UnitQuaternion
from tests.optics.grids import Array

REST = ObjectMotion()
MOTION = ObjectMotion(velocity=(3.0, -2.0, 9.0), angular_velocity=(25.0, -40.0, 60.0))
ANY: tuple[float, float, float] = (35.0, -50.0, 110.0)


def rays(count: int = 3000, width: float = 0.2, seed: int = 5) -> Array:
    slopes = np.random.default_rng(seed).uniform(-width, width, (count, 2))
    return np.concatenate([slopes, np.ones((count, 1))], axis=1)


def inverse_depth(item: AnyShape, motion: ObjectMotion = REST, time: float = 0.0) -> Array:
    return solve_quadric(place(item, pose_at(motion, time, "euler")), item.bounds, rays())[0]


def test_euler_angles_have_the_matrix_of_a_motion() -> None:
    for angles in np.random.default_rng(1).uniform(-400, 400, (40, 3)):
        expected = TOWARDS_CAMERA @ rotation_matrix(np.radians(angles), "euler") @ TOWARDS_CAMERA
        found = static_rotation(Sphere(rotation=tuple(angles.tolist())))
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-15)  # 400 deg in radians: 1e-15


def test_an_axis_and_a_quaternion_have_the_matrix_of_an_angular_velocity() -> None:
    for axis in np.random.default_rng(2).standard_normal((40, 3)):
        unit, angle = axis / np.linalg.norm(axis), 70.0
        expected = TOWARDS_CAMERA @ rotation_matrix(np.radians(angle) * unit, "axis") @ TOWARDS_CAMERA
        turned = AxisAngle(axis=tuple(axis.tolist()), angle=angle)
        np.testing.assert_allclose(static_rotation(Sphere(rotation=turned)), expected, rtol=0, atol=1e-15)
        x, y, z = (3.0 * np.sin(np.radians(35.0)) * unit).tolist()
        quaternion = UnitQuaternion(quaternion=(3.0 * float(np.cos(np.radians(35.0))), x, y, z))
        np.testing.assert_allclose(static_rotation(Sphere(rotation=quaternion)), expected, rtol=0, atol=2e-15)


def rotated_coefficients(item: Ellipsoid) -> tuple[float, ...]:
    """Coefficients of the quadric, by a rotation of its own: x, y and z of the thesis' frame, clockwise."""
    angles: Any = item.rotation
    turns = Rotation.from_euler("xyz", -np.asarray(angles), degrees=True).as_matrix()
    flip = np.diag([1.0, 1.0, -1.0])
    matrix = flip @ turns @ flip
    q = matrix @ np.diag(1.0 / np.array(item.semi_axes) ** 2) @ matrix.T
    squares = np.diag(q).tolist()
    return (*squares, *(2 * np.array([q[0, 1], q[1, 2], q[2, 0]])).tolist(), 0.0, 0.0, 0.0, -1.0)


CENTER = (5.0, -3.0, 280.0)
AXES = (30.0, 12.0, 50.0)
OWN = (1 / 900.0, 1 / 144.0, 1 / 2500.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
FLAT = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
EGGS = [Ellipsoid(semi_axes=AXES, center=CENTER, rotation=each) for each in ((35, 0, 0), (0, -50, 0), (0, 0, 110), ANY)]
ROD = Cylinder(center=CENTER, axis=(0.2, 1.0, 0.1))
LONG, SHORT = (-31.0, 31.0), (-15.0, 10.0)
CARD = ((-20.0, 20.0), (-15.0, 15.0), (-1.0, 1.0))
SLOPE = float(np.tan(np.radians(30.0)))


def turned_axis(angles: tuple[float, float, float]) -> Cylinder:
    """ROD with the axis that it has after a rotation."""
    axis = static_rotation(Sphere(rotation=angles)) @ np.array(ROD.axis)
    return ROD.model_copy(update={"axis": tuple(axis.tolist())})


SAME: dict[str, tuple[AnyShape, AnyShape]] = {
    "a sphere": (Sphere(center=CENTER, rotation=ANY), Sphere(center=CENTER)),
    **{
        f"an ellipsoid {item.rotation}": (item, Quadric(coefficients=rotated_coefficients(item), center=CENTER))
        for item in EGGS
    },
    "a quadric": (Quadric(coefficients=OWN, center=CENTER, rotation=ANY), EGGS[3]),
    **{
        f"a cylinder {angles}": (ROD.model_copy(update={"rotation": angles}), turned_axis(angles))
        for angles in ((35.0, 0.0, 0.0), (0.0, 0.0, 110.0), ANY)
    },
    "a cylinder on its side": (
        Cylinder(center=CENTER, rotation=(0.0, 0.0, -90.0)), Cylinder(center=CENTER, axis=(1.0, 0.0, 0.0)),
    ),
    "a cone": (Cone(apex=CENTER, rotation=(0.0, 180.0, 0.0)), Cone(apex=CENTER, nappe="towards")),
    # Z = a + tan(30 deg) Y: the top goes away.
    "a plane about x": (Plane(distance=250.0, rotation=(30.0, 0.0, 0.0)), Plane(distance=250.0, slope_y=SLOPE)),
    "a plane about y": (Plane(distance=250.0, rotation=(0.0, 30.0, 0.0)), Plane(distance=250.0, slope_x=-SLOPE)),
    "a tube, whose top goes to the right": (
        Cylinder(center=CENTER, bounds=(LONG, SHORT, LONG), rotation=(0.0, 0.0, 90.0)),
        Cylinder(center=CENTER, axis=(1.0, 0.0, 0.0), bounds=(SHORT, LONG, LONG)),
    ),
    "a rectangle, a cut plane": (Rectangle(rotation=ANY), Plane(bounds=CARD, rotation=ANY)),
    "a rectangle aside, a cut quadric": (
        Rectangle(center=(9.0, -7.0, 280.0), size=(40.0, 30.0)),
        Quadric(coefficients=FLAT, center=(9.0, -7.0, 280.0), bounds=CARD),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_surfaces_that_are_the_same_in_other_words(name: str) -> None:
    """At rest and moved; at a limb half of the digits are left, and hits may differ."""
    for time in (0.0, 0.6):
        one, other = (inverse_depth(item, MOTION, time) for item in SAME[name])
        both = (one > 0) & (other > 0)
        assert both.sum() > 100
        assert ((one > 0) != (other > 0)).sum() <= 2
        np.testing.assert_allclose(one[both], other[both], rtol=1e-9)


def test_bounds_cut_what_is_rotated_first() -> None:
    item = Sphere(center=(5.0, -3.0, 280.0), bounds=((-31.0, 31.0), (-31.0, 4.0), (-31.0, 12.0)), rotation=ANY)
    for time in (0.0, 0.6):
        pose = pose_at(MOTION, time, "euler")
        w = solve_quadric(place(item, pose), item.bounds, rays())[0]
        z = 1.0 / w[w > 0]
        assert 200 < z.size < (inverse_depth(Sphere(center=item.center), MOTION, time) > 0).sum()
        points = rays()[w > 0] * z[:, None] - np.array(item.center) - pose.shift
        own = points @ pose.rotation @ static_rotation(item)
        for axis, (low, high) in enumerate(item.bounds or ()):
            assert (own[:, axis] > low - 1e-9).all()
            assert (own[:, axis] < high + 1e-9).all()


def test_a_disc_is_a_plane_cut_by_a_cylinder() -> None:
    """Each of its points is on the plane, at most the radius from the axis, and no other ray of the plane hits it."""
    item = Disc(center=(9.0, -7.0, 280.0), radius=18.0, offset=4.0, rotation=ANY)
    whole = Rectangle(center=item.center, size=(500.0, 500.0), offset=item.offset, rotation=ANY)
    for time in (0.0, 0.6):
        pose = pose_at(MOTION, time, "euler")
        w, expected = (solve_quadric(place(each, pose), each.bounds, rays())[0] for each in (item, whole))
        points = rays() / np.where(expected > 0, expected, np.inf)[..., None] - np.array(item.center) - pose.shift
        own = points @ pose.rotation @ static_rotation(item)
        inside = (expected > 0) & (np.hypot(own[..., 0], own[..., 1]) <= item.radius)
        assert inside.sum() > 50
        np.testing.assert_allclose(w, np.where(inside, expected, 0.0), rtol=1e-12)


def test_the_image_on_a_disc_is_that_on_the_square_around_it() -> None:
    keys: dict[str, Any] = {"texture_mapping": "surface", "texture_angle": 20.0, "rotation": ANY}
    for given in (keys, keys | {"texture_repeats": (2.0, 3.0)}, keys | {"texture_size": 7.0}):
        disc, square = Disc(radius=18.0, **given), Rectangle(size=(36.0, 36.0), **given)
        for one, other in zip(*(vars(texture_map(item, 60, 40)).values() for item in (disc, square)), strict=True):
            np.testing.assert_array_equal(one, other)


SOLIDS: list[AnyShape] = [
    Disc(center=(9.0, -7.0, 280.0), radius=20.0, offset=-5.0, rotation=(60.0, 20.0, 130.0)),
    Rectangle(center=(9.0, -7.0, 280.0), size=(30.0, 50.0), rotation=(60.0, 20.0, 130.0)),
    Ellipsoid(semi_axes=(30.0, 12.0, 50.0), center=(9.0, -7.0, 280.0), rotation=ANY),
    Plane(distance=280.0, bounds=((-20.0, 35.0), (-9.0, 15.0), (-1.0, 1.0)), rotation=(60.0, 20.0, 130.0)),
    Cone(apex=(9.0, 0.0, 280.0), bounds=((-20.0, 20.0), (-20.0, 20.0), (0.0, 35.0)), rotation=(100.0, 20.0, 130.0)),
]


@pytest.mark.parametrize("item", SOLIDS, ids=lambda item: item.shape)
def test_predictions_are_the_reference(item: AnyShape) -> None:
    surface = place(item, pose_at(MOTION, 0.6, "euler"))
    expected = solve_quadric(surface, item.bounds, rays())[0]
    found = predict_inverse_depth(item, surface, *rays()[:, :2].T)
    differs = (found > 0) != (expected > 0)
    assert differs.sum() <= 2
    np.testing.assert_allclose(found[~differs], expected[~differs], rtol=1e-6)  # a limb


def test_normals_turn_with_the_object() -> None:
    plane = Plane(distance=250.0, rotation=(0.0, 30.0, 0.0))
    surface = place(plane, pose_at(REST, 0.0, "euler"))
    w, _ = solve_quadric(surface, None, rays())
    expected = [-np.sin(np.radians(30.0)), 0.0, -np.cos(np.radians(30.0))]
    np.testing.assert_allclose(surface_normal(surface, rays(), w), np.tile(expected, (w.size, 1)), rtol=0, atol=1e-14)


def test_a_plane_turned_about_z_keeps_its_depth_exactly() -> None:
    surface = place(Plane(distance=250.0, rotation=(0.0, 0.0, 33.0)), pose_at(REST, 0.0, "euler"))
    assert set(solve_quadric(surface, None, rays())[0]) == {1.0 / 250.0}
