"""Paths through keyframes against scipy, closed forms and velocities."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from clsco.optics.keyframes import orientations_through, path_through
from clsco.optics.motion import TOWARDS_CAMERA, eye_pose, keyframe_at, pose_at, poses_at
from clsco.scene.model import Camera, CameraMotion, Group, Motion, ObjectMotion, Plane, Scene, Sphere
from clsco.scene.motions import Keyframe
from tests.optics.grids import Array

UNEVEN = np.array([-0.5, 0.0, 0.1, 1.3, 2.0, 4.0])
EVEN = np.linspace(-1.0, 4.0, 6)
INTERPOLATIONS = ["step", "linear", "cubic", "bspline"]
ROTATIONS = ["euler", "axis"]


def keyed(times: Any, positions: Any = None, rotations: Any = None, **keys: Any) -> ObjectMotion:
    """A motion with keyframes."""
    none = [(0.0, 0.0, 0.0)] * len(times)
    found = zip(times, none if positions is None else positions, none if rotations is None else rotations, strict=True)
    return ObjectMotion(keyframe=tuple(Keyframe(time=float(t), position=p, rotation=r) for t, p, r in found), **keys)


def values(count: int, size: int = 3) -> Array:
    return np.random.default_rng(3).uniform(-50.0, 50.0, (count, size))


def test_a_cubic_is_the_natural_spline() -> None:
    keys = values(6)
    path, expected = path_through(UNEVEN, keys, "cubic", "hold"), CubicSpline(UNEVEN, keys, bc_type="natural")
    times = np.linspace(-0.5, 4.0, 91)
    found = np.array([path.at(t) for t in times])
    np.testing.assert_allclose(found, expected(times), rtol=0, atol=1e-11)
    np.testing.assert_allclose([path.at(t) for t in UNEVEN], keys, rtol=0, atol=1e-12)


def test_a_b_spline_has_the_keys_as_control_points_and_meets_the_outer_ones() -> None:
    keys = values(6)
    path = path_through(EVEN, keys, "bspline", "hold")
    controls = np.concatenate([[2 * keys[0] - keys[1]], keys, [2 * keys[-1] - keys[-2]]])
    expected = BSpline(np.arange(-4.0, 8.0), controls, 3)  # knots at equal distances: the first key is at -1
    times = np.linspace(-1.0, 4.0, 71)[:-1]
    np.testing.assert_allclose([path.at(t) for t in times], expected(times), rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.at(-1.0), keys[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(path.at(4.0 - 1e-12), keys[-1], rtol=0, atol=1e-9)
    assert np.abs(path.at(1.0) - keys[2]).max() > 1.0


def test_lines_and_steps() -> None:
    keys = values(6)
    lines, steps = (path_through(UNEVEN, keys, kind, "hold") for kind in ("linear", "step"))
    for t in np.linspace(-0.5, 4.0, 46).tolist():
        np.testing.assert_allclose(lines.at(t), [np.interp(t, UNEVEN, column) for column in keys.T], atol=1e-12)
        assert np.array_equal(steps.at(t), keys[np.flatnonzero(t >= UNEVEN)[-1]])


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_before_and_after_the_keys(interpolation: Any) -> None:
    keys = values(6)
    held, on = (path_through(EVEN, keys, interpolation, outside) for outside in ("hold", "linear"))
    for end, key, near in ((-1.0, keys[0], 1e-6), (4.0, keys[-1], -1e-6)):
        for far in (0.0, 1.0, 7.0):
            place = end - np.sign(near) * far
            np.testing.assert_allclose(held.at(place), key, rtol=0, atol=1e-12)
            speed = 0.0 if interpolation == "step" else (on.at(end + near) - on.at(end)) / near
            expected = key - np.sign(near) * far * np.asarray(speed)
            np.testing.assert_allclose(on.at(place), expected, rtol=0, atol=2e-3)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("outside", ["hold", "linear", "error"])
def test_one_key_stays(interpolation: Any, outside: Any) -> None:
    motion = keyed([2.0], [(1.0, 2.0, 3.0)], [(10.0, 20.0, 30.0)], interpolation=interpolation, outside=outside)
    turned = pose_at(ObjectMotion(angular_velocity=(10.0, 20.0, 30.0)), 1.0, "euler").rotation
    for pose in (pose_at(motion, time, "euler") for time in (-5.0, 2.0, 9.0)):
        assert pose.shift.tolist() == [1.0, 2.0, 3.0]
        np.testing.assert_allclose(pose.rotation, turned, rtol=0, atol=1e-15)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("rotation", ROTATIONS)
def test_constant_velocity_by_keys_has_the_bits_of_velocity(interpolation: Any, rotation: str) -> None:
    velocity, turn, end = (3.0, -4.5, 0.375), (0.0, 0.0, 77.0), 3.0
    keys = np.multiply([[0.0], [end]], velocity), np.multiply([[0.0], [end]], turn)
    motion = keyed([0.0, end], *keys, interpolation=interpolation)
    even = ObjectMotion(velocity=velocity, angular_velocity=turn)
    for time in np.linspace(0.0, end, 97)[:-1].tolist():
        found, expected = pose_at(motion, time, rotation), pose_at(even, time, rotation)
        assert np.array_equal(found.shift, expected.shift)
        assert np.array_equal(found.rotation, expected.rotation)


def test_angles_about_one_axis_count_whole_turns() -> None:
    motion = keyed([0.0, 2.0], rotations=[(0.0, 0.0, 0.0), (0.0, 900.0, 0.0)], interpolation="linear")
    for time in (0.1, 0.4, 1.9):
        expected = pose_at(ObjectMotion(angular_velocity=(0.0, 450.0, 0.0)), time, "euler").rotation
        np.testing.assert_allclose(pose_at(motion, time, "euler").rotation, expected, rtol=0, atol=1e-14)
    back = keyed([0.0, 1.0], rotations=[(0.0, 0.0, 0.0), (0.0, 0.0, -180.0)])
    expected = pose_at(ObjectMotion(angular_velocity=(0.0, 0.0, -90.0)), 1.0, "euler").rotation
    np.testing.assert_allclose(pose_at(back, 0.5, "euler").rotation, expected, rtol=0, atol=1e-15)


def in_camera_axes(angles: Any, rotation: str) -> Rotation:
    """Orientation of angles in deg."""
    motion = ObjectMotion(angular_velocity=tuple(angles))
    return Rotation.from_matrix(pose_at(motion, 1.0, rotation).rotation)


@pytest.mark.parametrize("rotation", ROTATIONS)
def test_lines_of_orientations_are_spherical_linear_interpolation(rotation: str) -> None:
    angles = np.random.default_rng(5).uniform(-900.0, 900.0, (6, 3))
    motion = keyed(UNEVEN, rotations=angles, interpolation="linear")
    keys = Rotation.concatenate([in_camera_axes(each, rotation) for each in angles])
    expected = Slerp(UNEVEN, keys)
    for time in np.linspace(-0.5, 4.0, 61).tolist():
        found = pose_at(motion, time, rotation).rotation
        np.testing.assert_allclose(found, expected(time).as_matrix(), rtol=0, atol=1e-12)
        np.testing.assert_allclose(found @ found.T, np.eye(3), rtol=0, atol=2e-15)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS[:3])
@pytest.mark.parametrize("rotation", ROTATIONS)
def test_orientations_meet_their_keys(interpolation: Any, rotation: str) -> None:
    angles = np.random.default_rng(6).uniform(-200.0, 200.0, (6, 3))
    motion = keyed(UNEVEN, rotations=angles, interpolation=interpolation)
    for time, each in zip(UNEVEN.tolist(), angles, strict=True):
        expected = in_camera_axes(each, rotation).as_matrix()
        np.testing.assert_allclose(pose_at(motion, time, rotation).rotation, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("interpolation", ["cubic", "bspline"])
def test_orientations_turn_smoothly(interpolation: Any) -> None:
    """Angular velocities on both sides of a key are the same, and so are their derivatives."""
    angles = np.random.default_rng(7).uniform(-60.0, 60.0, (6, 3)).tolist()
    path = orientations_through(EVEN, angles, "euler", interpolation, "hold")
    h = 1e-3

    def rate(time: float) -> Array:
        turn = Rotation.from_matrix(path.at(time + h)) * Rotation.from_matrix(path.at(time - h)).inv()
        return np.asarray(turn.as_rotvec() / (2 * h))

    for key in EVEN[1:-1].tolist():
        before, after = rate(key - 2 * h), rate(key + 2 * h)
        assert np.linalg.norm(before) > 0.05
        gains = [(rate(key + s * 3 * h) - rate(key + s * 2 * h)) / (s * h) for s in (-1, 1)]
        np.testing.assert_allclose(before, after, rtol=0, atol=8e-2 * float(np.linalg.norm(gains[0])) + 1e-3)
        np.testing.assert_allclose(gains[0], gains[1], rtol=0.1, atol=0.1)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, -1), (2, -3, 1), (-1, 1, 4)])
def test_half_a_turn_goes_in_the_positive_sense_about_the_axis_with_a_positive_largest_component(axis: Any) -> None:
    half = 180.0 * np.array(axis) / np.linalg.norm(axis)
    path = orientations_through([0, 1], [(0, 0, 0), tuple(half.tolist())], "axis", "linear", "hold")
    sense = 1.0 if half[np.abs(half).argmax()] > 0 else -1.0
    expected = pose_at(ObjectMotion(angular_velocity=tuple((sense * half).tolist())), 0.5, "axis").rotation
    np.testing.assert_allclose(path.at(0.5), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(path.at(1.0), TOWARDS_CAMERA @ _half_turn(half) @ TOWARDS_CAMERA, rtol=0, atol=1e-9)


def _half_turn(vector: Array) -> Array:
    """By 180 deg about an axis, x -> 2 n (n . x) - x."""
    n = vector / np.linalg.norm(vector)
    return np.asarray(2.0 * np.outer(n, n) - np.eye(3))


def test_groups_and_the_camera_have_keys_as_well() -> None:
    motion = keyed(range(3), [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 4.0, 0.0)])
    ball = Sphere(center=(0.0, 0.0, 300.0))
    carried = ball.model_copy(update={"group": "a"})
    scene = Scene(groups=(Group(name="a", motion=motion),), objects=(carried, Plane(distance=400.0)))
    assert scene.moves
    alone = Scene(objects=(ball.model_copy(update={"motion": motion}),))
    moved = Scene(camera=Camera(motion=CameraMotion(keyframe=motion.keyframe)), objects=(ball,))
    for time in (0.3, 1.7):
        expected = pose_at(motion, time, "euler").shift
        assert np.array_equal(poses_at(scene, time)[0].shift, expected)
        assert np.array_equal(poses_at(scene, time)[1].shift, [0.0, 0.0, 0.0])
        assert np.array_equal(poses_at(alone, time)[0].shift, expected)
        assert np.array_equal(eye_pose(moved, "left", time).shift, expected)
        assert np.array_equal(poses_at(moved, time)[0].shift, -expected)


def test_the_kind_of_rotation_says_what_angles_of_keys_mean() -> None:
    item = Sphere(motion=keyed([0.0], rotations=[(90.0, 90.0, 0.0)]))
    kinds = Motion(rotation="euler"), Motion(rotation="axis")
    euler, axis = (poses_at(Scene(objects=(item,), motion=kind), 0.0)[0].rotation for kind in kinds)
    np.testing.assert_allclose(euler, in_camera_axes((90.0, 90.0, 0.0), "euler").as_matrix(), rtol=0, atol=1e-15)
    np.testing.assert_allclose(axis, in_camera_axes((90.0, 90.0, 0.0), "axis").as_matrix(), rtol=0, atol=1e-15)
    assert np.abs(euler - axis).max() > 0.3


@pytest.mark.parametrize("rotation", ROTATIONS)
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_a_keyframe_with_the_pose_at_a_time_has_that_pose(interpolation: Any, rotation: Any) -> None:
    draws = np.random.default_rng(3)
    for _ in range(20):
        shifts, angles = draws.uniform(-9.0, 9.0, (4, 3)), draws.uniform(-300.0, 300.0, (4, 3))
        motion = keyed(range(4), shifts, angles, interpolation=interpolation)
        time = draws.uniform(-0.5, 3.5)
        alone = ObjectMotion(keyframe=(keyframe_at(motion, time, rotation),))
        expected, found = pose_at(motion, time, rotation), pose_at(alone, 0.0, rotation)
        np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-9)
        np.testing.assert_allclose(found.shift, expected.shift, atol=1e-9)


@pytest.mark.parametrize("about_y", [90.0, -90.0])
def test_angles_where_two_axes_are_alike(about_y: float) -> None:
    motion = keyed([0.0], rotations=[(30.0, about_y, 20.0)])
    alone = ObjectMotion(keyframe=(keyframe_at(motion, 0.0, "euler"),))
    found, expected = (pose_at(each, 0.0, "euler").rotation for each in (alone, motion))
    np.testing.assert_allclose(found, expected, atol=1e-12)
