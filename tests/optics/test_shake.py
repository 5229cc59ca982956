"""The shake of a camera: root mean squares, band, seed, and the same path from other code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clsco.optics.motion import eye_pose, pose_at, poses_at, shake_pose
from clsco.scene.model import Camera, CameraMotion, CameraShake, Motion, Scene, Sphere, Stereo
from tests.optics.grids import Array

SHAKE = CameraShake(rotation_rms=0.3, translation_rms=0.8, band=(2.0, 15.0), seed=5)


def paths(shake: CameraShake, times: Array) -> tuple[Array, Array]:
    """Rotation vectors (n, 3) in deg and shifts (n, 3) in mm."""
    poses = [shake_pose(shake, time) for time in times.tolist()]
    turns = Rotation.from_matrix([pose.rotation for pose in poses]).as_rotvec(degrees=True)
    return np.asarray(turns), np.array([pose.shift for pose in poses])


def test_root_mean_squares_over_a_long_time() -> None:
    shake = CameraShake(rotation_rms=0.3, translation_rms=0.8, band=(0.5, 0.6), seed=2**63 - 1)
    times = np.random.default_rng(1).uniform(0.0, 1e6, 4_000)
    for found, expected in zip(paths(shake, times), (0.3, 0.8), strict=True):
        assert np.sqrt((found**2).sum(axis=1).mean()) == pytest.approx(expected, rel=0.02)
        # Each axis has a third of the mean square, and none goes anywhere.
        np.testing.assert_allclose(np.sqrt((found**2).mean(axis=0)), expected / np.sqrt(3.0), rtol=0.04)
        np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.03 * expected)


def test_the_path_by_the_words_of_the_documentation() -> None:
    numbers = np.random.Philox(key=5).random_raw(384) >> np.uint64(11)
    place, phase = (numbers * 2.0**-53).reshape(6, 32, 2).transpose(2, 0, 1)
    frequency = 2.0 + 13.0 / 32.0 * (np.arange(32) + place)
    for time in (0.0, 0.37, 12.5):
        sums = np.sin(2 * np.pi * (frequency * time + phase)).sum(axis=1) * np.sqrt(2.0 / 96.0)
        found = shake_pose(SHAKE, time)
        np.testing.assert_allclose(found.shift, 0.8 * sums[3:], rtol=0, atol=1e-12)
        # Clockwise about right, up and backwards, in axes with z forwards: by the right hand about these.
        expected = Rotation.from_rotvec(0.3 * sums[:3] * [1.0, 1.0, -1.0], degrees=True).as_matrix()
        np.testing.assert_allclose(found.rotation, expected, rtol=0, atol=1e-12)


def test_other_seeds_are_other_paths() -> None:
    times = np.linspace(0.0, 40.0, 500)
    one, other = (paths(SHAKE.model_copy(update={"seed": seed}), times)[0] for seed in (1, 2))
    assert abs(np.corrcoef(one[:, 0], other[:, 0])[0, 1]) < 0.1
    assert abs(np.corrcoef(one[:, 0], one[:, 1])[0, 1]) < 0.1


def test_shake_is_in_the_axes_of_the_moved_camera() -> None:
    motion: dict[str, Any] = {"velocity": (9.0, -4.0, 20.0), "angular_velocity": (10.0, 50.0, -30.0)}
    camera, ball = Camera(motion=CameraMotion(**motion), shake=SHAKE), Sphere(center=(5.0, -2.0, 300.0))
    scene = Scene(camera=camera, motion=Motion(rotation="axis"), objects=(ball,))
    time = 0.83
    base, shaken = pose_at(scene.camera.motion, time, "axis"), shake_pose(SHAKE, time)
    found = eye_pose(scene, "left", time)
    np.testing.assert_allclose(found.rotation, base.rotation @ shaken.rotation, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.shift, base.shift + base.rotation @ shaken.shift, rtol=0, atol=1e-13)
    # A point that the camera sees: back through both.
    (pose,) = poses_at(scene, time)
    center = np.array([5.0, -2.0, 300.0])
    seen = center + pose.shift
    np.testing.assert_allclose(found.rotation @ seen + found.shift, center, rtol=0, atol=1e-11)


def test_both_eyes_shake_together() -> None:
    scene = Scene(camera=Camera(shake=SHAKE), stereo=Stereo(baseline=60.0), objects=(Sphere(),))
    left, right = (eye_pose(scene, eye, 0.3) for eye in ("left", "right"))
    assert np.array_equal(left.rotation, right.rotation)
    np.testing.assert_allclose(right.shift - left.shift, left.rotation @ [60.0, 0.0, 0.0], rtol=0, atol=1e-12)
