"""Poses against the thesis' own equations, the exponential map and exact angles; times of the samples."""

from __future__ import annotations

from math import cos, pi, radians, sin
from typing import Any, Literal

import numpy as np
import pytest
from scipy.linalg import expm

from clsco.optics.motion import TOWARDS_CAMERA, eye_pose, pose_at, poses_at, rest_center, rest_poses, rotation_matrix
from clsco.scene.model import CameraMotion, Cone, Ellipsoid, Object, ObjectMotion, Plane, Quadric, Scene, Sphere, Stereo
from tests.optics.grids import Array
from tests.scenes import scene_of

EPS = np.finfo(np.float64).eps
ROTATIONS = ["euler", "axis"]


def thesis_position(point: Array, center: Array, motion: ObjectMotion, t: float) -> Array:
    """New position of a point by 2.6 to 2.23, where "the position is counted once" (2.12 counts it twice).

    X1, Y1: from the center, right and up; Z2: center minus point, that is towards the camera (2.13); the moved
    center is added back.
    """
    tx, ty, tz = (radians(w) * t for w in motion.angular_velocity)
    r_xx = cos(ty) * cos(tz)
    r_xy = sin(tx) * sin(ty) * cos(tz) + cos(tx) * sin(tz)
    r_xz = -cos(tx) * sin(ty) * cos(tz) + sin(tx) * sin(tz)
    r_yx = -cos(ty) * sin(tz)
    r_yy = -sin(tx) * sin(ty) * sin(tz) + cos(tx) * cos(tz)
    r_yz = cos(tx) * sin(ty) * sin(tz) + sin(tx) * cos(tz)
    r_zx = sin(ty)
    r_zy = -sin(tx) * cos(ty)
    r_zz = cos(tx) * cos(ty)
    x, y = point[:2] - center[:2]
    z = center[2] - point[2]
    turned_x = r_xx * x + r_xy * y + r_xz * z
    turned_y = r_yx * x + r_yy * y + r_yz * z
    turned_z = r_zx * x + r_zy * y + r_zz * z
    moved = center + np.array(motion.velocity) * t
    return np.array([moved[0] + turned_x, moved[1] + turned_y, moved[2] - turned_z])


def moved(point: Array, center: Array, motion: ObjectMotion, t: float, rotation: str = "euler") -> Array:
    pose = pose_at(motion, t, rotation)
    return np.asarray(center + pose.shift + pose.rotation @ (point - center))


def test_points_move_as_the_thesis_says() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        center, point = np.array([0.0, 0.0, 280.0]) + rng.uniform(-50, 50, (2, 3))
        velocity, angular_velocity = rng.uniform(-90, 90, 3), rng.uniform(-400, 400, 3)
        motion = ObjectMotion(velocity=tuple(velocity), angular_velocity=tuple(angular_velocity))
        t = float(rng.uniform(0.0, 2.0))
        expected = thesis_position(point, center, motion, t)
        assert np.linalg.norm(expected - point) > 1.0
        # Angles up to 14 rad, rounded by eps of that, turn an arm of up to 160 mm; positions go up to 500 mm.
        np.testing.assert_allclose(moved(point, center, motion, t), expected, rtol=0, atol=16 * EPS * (14 * 160 + 500))


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_nothing_moves_at_rest(rotation: str) -> None:
    # 2.12 as printed moves (10, 5, 240) to (20, 10, 285) here.
    point, center = np.array([10.0, 5.0, 240.0]), np.array([0.0, 0.0, 285.0])
    motion = ObjectMotion(velocity=(3.0, 4.0, 5.0), angular_velocity=(30.0, -40.0, 50.0))
    assert (moved(point, center, motion, 0.0, rotation) == point).all()
    assert (moved(point, center, ObjectMotion(), 7.0, rotation) == point).all()


def test_each_axis_turns_the_way_it_says() -> None:
    """By 90 degrees: what was at the first point goes to the second (axes right, up, towards the camera)."""
    center = np.array([0.0, 0.0, 280.0])
    right, up, near = np.array([10.0, 0, 0]), np.array([0, 10.0, 0]), np.array([0, 0, -10.0])
    # From 2.15 to 2.23: the z axis takes up to the right, the y axis takes right to near, x takes near to up.
    for axis, start, end in ((2, up, right), (2, right, -up), (1, right, near), (1, near, -right), (0, near, up)):
        turn = [0.0, 0.0, 0.0]
        turn[axis] = 90.0
        motion = ObjectMotion(angular_velocity=(turn[0], turn[1], turn[2]))
        for rotation in ROTATIONS:
            found = moved(center + start, center, motion, 1.0, rotation) - center
            np.testing.assert_allclose(found, end, rtol=0, atol=64 * EPS * 280)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_both_rotations_agree_about_a_single_axis(axis: int) -> None:
    for angle in (-200.0, -1e-9, 0.0, 30.0, 90.0, 180.0, 359.0):
        angles = np.zeros(3)
        angles[axis] = radians(angle)
        euler, about = (rotation_matrix(angles, rotation) for rotation in ROTATIONS)
        np.testing.assert_allclose(about, euler, rtol=0, atol=4 * EPS)


def test_axis_is_the_exponential_map() -> None:
    """R(theta) = exp([-theta]x): constant angular velocity, in the sense of the thesis' matrix."""
    for angles in np.random.default_rng(3).uniform(-4, 4, (50, 3)):
        x, y, z = -angles
        generator = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # expm is good to some 10 eps of the norm of its argument, up to 7.
        np.testing.assert_allclose(rotation_matrix(angles, "axis"), expm(generator), rtol=0, atol=1e-13)
        half = rotation_matrix(angles / 2, "axis")
        np.testing.assert_allclose(half @ half, rotation_matrix(angles, "axis"), rtol=0, atol=16 * EPS)
        np.testing.assert_allclose(rotation_matrix(angles, "axis") @ angles, angles, rtol=0, atol=64 * EPS)
    assert (rotation_matrix(np.zeros(3), "axis") == np.eye(3)).all()


@pytest.mark.parametrize("rotation", ROTATIONS)
@pytest.mark.parametrize("turns", [(1e7, 0.0, 0.0), (0.0, 0.0, -1e7), (3e6, 4e6, 12e6)])
def test_ten_million_degrees(rotation: str, turns: tuple[float, float, float]) -> None:
    """Degrees are reduced before they become radians, which are rounded to 1e-16 of their size."""
    found = pose_at(ObjectMotion(angular_velocity=turns), 1.0, rotation).rotation
    if rotation == "axis":
        length = 13e6 if all(turns) else 1e7  # whole degrees, so that the remainders are exact
        angles = np.array(turns) / length * radians(length % 360.0)
    else:
        angles = np.array([radians(np.fmod(a, 360.0)) for a in turns])
    flip = np.diag([1.0, 1.0, -1.0])
    np.testing.assert_allclose(found, flip @ rotation_matrix(angles, rotation) @ flip, rtol=0, atol=16 * EPS * 2 * pi)
    # Through radians it is off by eps of 1e7 degrees, and that is seen:
    rough = flip @ rotation_matrix(np.radians(turns), rotation) @ flip
    assert np.abs(rough - found).max() < 1e-8


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_accelerations_add_half_their_time_squared(rotation: str) -> None:
    speeds: dict[str, Any] = {"velocity": (3.0, -4.0, 5.0), "angular_velocity": (30.0, -40.0, 50.0)}
    gains: dict[str, Any] = {"acceleration": (-7.0, 2.0, 30.0), "angular_acceleration": (90.0, 25.0, -60.0)}
    for time in (0.0, 0.3, 2.0, -1.5):
        found = pose_at(ObjectMotion(**speeds, **gains), time, rotation)
        # The pose at this time of constant velocities v + a t / 2, which reach the same place.
        mean = [np.add(speeds[a], np.multiply(gains[b], time / 2)) for a, b in zip(speeds, gains, strict=True)]
        even = pose_at(ObjectMotion(velocity=mean[0], angular_velocity=mean[1]), time, rotation)
        np.testing.assert_allclose(found.shift, even.shift, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.rotation, even.rotation, rtol=0, atol=1e-13)
        resting = pose_at(ObjectMotion(**speeds, acceleration=(0.0, 0.0, 0.0)), time, rotation)
        plain = pose_at(ObjectMotion(**speeds), time, rotation)
        assert np.array_equal(resting.shift, plain.shift)
        assert np.array_equal(resting.rotation, plain.rotation)


@pytest.mark.parametrize(
    ("item", "center"),
    [
        (Plane(distance=250.0, slope_x=1.0), (0.0, 0.0, 250.0)),
        (Sphere(center=(1.0, 2.0, 280.0)), (1.0, 2.0, 280.0)),
        (Ellipsoid(center=(1.0, -2.0, 300.0)), (1.0, -2.0, 300.0)),
        (Cone(apex=(3.0, 2.0, 240.0)), (3.0, 2.0, 240.0)),
        (Quadric(coefficients=(1.0,) * 10, center=(0.0, 1.0, 260.0)), (0.0, 1.0, 260.0)),
    ],
    ids=lambda value: getattr(value, "shape", ""),
)
def test_the_point_about_which_an_object_turns(item: Object, center: tuple[float, float, float]) -> None:
    assert rest_center(item).tolist() == list(center)


# Cameras that move, and pairs of them

TURNING = ObjectMotion(velocity=(3.0, -2.0, 7.0), angular_velocity=(20.0, -35.0, 50.0))
ITEMS: tuple[Object, ...] = (Sphere(center=(10.0, -5.0, 200.0), motion=TURNING), Plane(distance=300.0), Cone())


def seen_from(scene: Scene, number: int, point: Array, time: float) -> Array:
    """Position in the frame of the left camera of a point of an object, given as it is at rest."""
    item = scene.objects[number]
    pose, center = poses_at(scene, time)[number], rest_center(item)
    return np.asarray(center + pose.shift + pose.rotation @ (point - center))


def camera_scene(going: CameraMotion, **sections: Any) -> Scene:
    return scene_of(*ITEMS, size=(8, 8), camera={"motion": going}, **sections)


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_a_moving_camera_sees_the_world_the_other_way(rotation: str) -> None:
    """Point p of the world is at R^T (p - s) for a camera at s turned by R, whatever moves the point itself."""
    motion = CameraMotion(velocity=(12.0, 5.0, -30.0), angular_velocity=(10.0, 25.0, -40.0))
    scene = camera_scene(motion, motion={"rotation": rotation})
    rng = np.random.default_rng(2)
    for number, item in enumerate(ITEMS):
        for time in (0.0, 0.3, 1.7):
            point = rest_center(item) + rng.uniform(-20, 20, 3)
            world = moved(point, rest_center(item), item.motion, time, rotation)
            camera = pose_at(motion, time, rotation)
            expected = camera.rotation.T @ (world - camera.shift)
            np.testing.assert_allclose(seen_from(scene, number, point, time), expected, atol=1e-12)
    assert np.abs(seen_from(scene, 1, np.array([0.0, 0.0, 300.0]), 1.7) - [0.0, 0.0, 300.0]).max() > 10


def test_eyes_of_a_pair() -> None:
    scene = camera_scene(CameraMotion(), stereo=Stereo(baseline=65.0))
    left, right = (eye_pose(scene, eye, 0.0) for eye in ("left", "right"))
    for eye, shift in ((left, [0.0, 0.0, 0.0]), (right, [65.0, 0.0, 0.0])):
        np.testing.assert_array_equal(eye.rotation, np.eye(3))
        np.testing.assert_array_equal(eye.shift, shift)
    for pose, other in zip(poses_at(scene, 0.5, "right"), poses_at(scene, 0.5, "left"), strict=True):
        np.testing.assert_allclose(pose.shift, other.shift - [65.0, 0.0, 0.0], atol=1e-13)
        np.testing.assert_array_equal(pose.rotation, other.rotation)


@pytest.mark.parametrize("toe_in", [1.0, 3.0])
def test_eyes_that_are_turned_inwards_meet(toe_in: float) -> None:
    """Both axes go through the point in the middle of the pair, baseline / (2 tan toe_in) before it."""
    scene = camera_scene(CameraMotion(), stereo=Stereo(baseline=60.0, toe_in=toe_in))
    meeting = np.array([30.0, 0.0, 30.0 / np.tan(np.radians(toe_in))])
    for eye in ("left", "right"):
        camera = eye_pose(scene, eye, 0.0)
        own = camera.rotation.T @ (meeting - camera.shift)
        np.testing.assert_allclose(own[:2], 0.0, atol=1e-11)
        assert own[2] == pytest.approx(np.hypot(30.0, meeting[2]))


def test_a_pair_moves_as_one() -> None:
    """The right camera stays where it is relative to the left one."""
    motion = CameraMotion(velocity=(5.0, 1.0, -8.0), angular_velocity=(15.0, -20.0, 30.0))
    scene = camera_scene(motion, stereo=Stereo(baseline=40.0, toe_in=1.5))

    def relative(time: float) -> tuple[Array, Array]:
        left, right = (eye_pose(scene, eye, time) for eye in ("left", "right"))
        return left.rotation.T @ (right.shift - left.shift), left.rotation.T @ right.rotation

    for found, expected in zip(relative(1.3), relative(0.0), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-13)


@pytest.mark.parametrize("rotation", ["euler", "axis"])
def test_what_does_not_turn_has_the_bits_of_a_turn_by_nothing(rotation: Literal["euler", "axis"]) -> None:
    turned = TOWARDS_CAMERA @ rotation_matrix(np.zeros(3), rotation) @ TOWARDS_CAMERA
    assert pose_at(ObjectMotion(velocity=(1.0, 0.0, 0.0)), 2.0, rotation).rotation.tobytes() == turned.tobytes()


def test_textures_belong_to_the_camera_that_is_neither_moved_nor_turned() -> None:
    scene = camera_scene(CameraMotion(), stereo=Stereo(baseline=40.0, toe_in=1.5))
    for pose in rest_poses(scene):
        np.testing.assert_array_equal(pose.rotation, np.eye(3))
        np.testing.assert_array_equal(pose.shift, np.zeros(3))
    assert len(rest_poses(scene)) == 3
