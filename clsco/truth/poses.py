"""Poses of objects and camera, and the lens, at many times at once, following the text of docs/motion.md (float64)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicSpline
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
TOWARDS = np.diag([1.0, 1.0, -1.0])
SINES = 32  # number of sines in each component of a shake


def rotation_matrix(angles: Array, axis_rotation: bool) -> Array:
    """Matrices M (..., 3, 3) in P(t) = C + v t + M (P0 - C), in camera axes, for `angles` omega t (..., 3) in rad.

    The thesis' matrix (2.14 to 2.23) acts on x right, y up, z towards the camera. With `axis_rotation` it is replaced
    by a rotation about the vector `angles`, in the sense that the matrix has for a single axis (clockwise seen from the
    axis' tip).
    """
    if axis_rotation:
        matrix = Rotation.from_rotvec(-angles.reshape(-1, 3)).as_matrix().reshape(*angles.shape, 3)
        return TOWARDS @ matrix @ TOWARDS
    (sx, sy, sz), (cx, cy, cz) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    first = cy * cz, sx * sy * cz + cx * sz, -cx * sy * cz + sx * sz
    second = -cy * sz, -sx * sy * sz + cx * cz, cx * sy * sz + sx * cz
    matrix = np.array([first, second, (sy, -sx * cy, cx * cy)])
    return TOWARDS @ np.moveaxis(matrix, (0, 1), (-2, -1)) @ TOWARDS


def static_rotation(rotation: Any) -> Array:
    """Matrix (3, 3) from Euler angles or an axis with an angle, both in deg, or a quaternion w x y z."""
    if rotation is None:
        return np.eye(3)
    if hasattr(rotation, "quaternion"):
        w, x, y, z = rotation.quaternion
        return TOWARDS @ Rotation.from_quat([x, y, z, w]).inv().as_matrix() @ TOWARDS
    if hasattr(rotation, "axis"):
        axis = np.asarray(rotation.axis, float)
        return rotation_matrix(math.radians(rotation.angle) * axis / np.linalg.norm(axis), True)
    return rotation_matrix(np.radians(rotation), False)


def shake_sines(shake: Any) -> Array:
    """Amplitude in rad or mm, frequency in Hz and phase in turns (6, sines, 3) for a camera's rotation vector, then its
    shift; no sines without shake.
    """
    if shake is None:
        return np.zeros((6, 0, 3))
    numbers = np.random.Philox(key=shake.seed).random_raw(12 * SINES) >> np.uint64(11)
    place, phase = np.moveaxis(numbers.reshape(6, SINES, 2) / 2.0**53, -1, 0)
    low, high = shake.band
    frequency = low + (np.arange(SINES) + place) * (high - low) / SINES
    sizes = np.repeat([math.radians(shake.rotation_rms), shake.translation_rms], 3)[:, None]
    return np.stack([np.broadcast_to(sizes * math.sqrt(2 / (3 * SINES)), place.shape), frequency, phase], axis=-1)


def shake_at(sines: Array, times: Array) -> tuple[Array, Array]:
    """Rotations (times, 3, 3) and shifts (times, 3) of a shaking camera."""
    size, frequency, phase = np.moveaxis(sines, -1, 0)
    components = (size * np.sin(2 * np.pi * (frequency * times[:, None, None] + phase))).sum(axis=-1)
    return rotation_matrix(components[:, :3], True), components[:, 3:]


def path_at(keys: Sequence[float], values: Array, interpolation: str, outside: str, times: Array) -> Array:
    """Values (times, size) of a path through keys, which is extended linearly beyond its ends, or held."""
    knots, at = np.asarray(keys, float), np.clip(times, keys[0], keys[-1])
    if interpolation == "step" or len(knots) == 1:
        return np.asarray(values[np.maximum(np.searchsorted(knots, times, side="right") - 1, 0)])
    if interpolation == "linear":
        curve: Any = BSpline(np.r_[knots[0], knots, knots[-1]], values, 1)
    elif interpolation == "cubic":
        curve = CubicSpline(knots, values, bc_type="natural")
    else:  # control points beyond the ends lie on straight lines
        step, ends = knots[1] - knots[0], np.stack([2 * values[0] - values[1], 2 * values[-1] - values[-2]])
        wider = np.concatenate([ends[:1], values, ends[1:]])
        curve = BSpline(knots[0] + step * np.arange(-3.0, len(knots) + 3.0), wider, 3)
    path = curve(at)
    if outside != "hold":
        path = path + (times - at)[:, None] * curve(at, 1)
    return np.asarray(path)


def motion_at(motion: Any, times: Array, axis_rotation: bool) -> tuple[Array, Array]:
    """Rotations (times, 3, 3) and shifts (times, 3) of a motion."""
    keys = getattr(motion, "keyframe", None)
    if keys is None:
        parts = []
        for speed, gain in (("velocity", "acceleration"), ("angular_velocity", "angular_acceleration")):
            change = np.asarray(getattr(motion, gain, None) or (0.0, 0.0, 0.0), float)
            parts.append(np.outer(times, getattr(motion, speed)) + np.outer(times * times / 2, change))
        return rotation_matrix(np.radians(parts[1]), axis_rotation), parts[0]
    moments, how = [key.time for key in keys], (motion.interpolation, motion.outside)
    angles = np.radians([key.rotation for key in keys])
    shifts = path_at(moments, np.array([key.position for key in keys], float), *how, times)
    if np.any(angles, axis=0).sum() < 2:
        return rotation_matrix(path_at(moments, angles, *how, times), axis_rotation), shifts
    # Rotations take the shorter way to each key: each turn is multiplied by a path that rises from 0 to 1 at its key.
    poses = Rotation.from_matrix(rotation_matrix(angles, axis_rotation))
    turns, found_turn = (poses[:-1].inv() * poses[1:]).as_rotvec(), poses[0]
    shares = path_at(moments, np.tri(len(keys), len(keys) - 1, -1), *how, times)
    for turn, share in zip(turns, shares.T, strict=True):
        found_turn = found_turn * Rotation.from_rotvec(np.outer(share, turn))
    return found_turn.as_matrix(), shifts


def camera_at(scene: Any, eye: str, times: Array) -> tuple[Array, Array]:
    """Rotations (times, 3, 3) and shifts (times, 3) of the camera, or of one camera of a stereo pair."""
    turn, shift = motion_at(scene.camera.motion, times, scene.motion.rotation == "axis")
    back, moved = shake_at(shake_sines(scene.camera.shake), times)
    turn, shift = turn @ back, shift + np.einsum("tij,tj->ti", turn, moved)
    if scene.stereo is not None:
        angle = math.radians(scene.stereo.toe_in) * (-1.0 if eye == "right" else 1.0)
        inwards = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
        shift = shift + turn @ np.array([scene.stereo.baseline if eye == "right" else 0.0, 0.0, 0.0])
        turn = turn @ inwards
    return turn, shift


def poses_at(scene: Any, centers: Array, rotations: Array, camera: tuple[Array, Array], times: Array) -> Array:
    """For each time and object, the inverse rotation (9) and the moved center (3) in the camera's frame: (times,
    objects, 12), mm. centers, rotations: in the reference pose.
    """
    back, shift = np.swapaxes(camera[0], -1, -2), camera[1]
    axis = scene.motion.rotation == "axis"
    groups = {group.name: (group, *motion_at(group.motion, times, axis)) for group in scene.groups}
    poses = np.empty((len(times), len(centers), 12))
    first: dict[str, Array] = {}
    for n, (item, center) in enumerate(zip(scene.objects, centers, strict=True)):
        turn, place = motion_at(item.motion, times, axis)
        turn, place = turn @ rotations[n], center + place
        if item.group is not None:
            group, group_turn, group_shift = groups[item.group]
            origin = np.asarray(first.setdefault(item.group, center) if group.origin is None else group.origin)
            place = origin + group_shift + np.einsum("tij,tj->ti", group_turn, place - origin)
            turn = group_turn @ turn
        poses[:, n, :9] = np.swapaxes(back @ turn, -1, -2).reshape(-1, 9)
        poses[:, n, 9:] = np.einsum("tij,tj->ti", back, place - shift)
    return poses


def lens_at(scene: Any, times: Array) -> Array:
    """Numbers of the lens at several times: pitch / s0, D / 2 in mm, K = 1/f - 1/s and 1/s in 1/mm, (times, 4)."""
    camera, lens = scene.camera, scene.lens
    f0, s0 = camera.focal_length, camera.normalization_distance
    keys = () if lens is None else lens.keyframe or ()

    def values_of(name: str, power: int, usual: float) -> Array:
        keyed = [(key.time, getattr(key, name) ** power) for key in keys if getattr(key, name) is not None]
        if not keyed:
            return np.full(len(times), usual)
        values = np.array([[value] for _, value in keyed])
        return path_at([time for time, _ in keyed], values, lens.interpolation, lens.outside, times)[:, 0]

    f = values_of("focal_length", 1, f0)
    power = values_of("focus_distance", -1, 1 / f0 - 1 / camera.sensor_distance)
    half = 0.5 * f * values_of("f_number", -1, camera.aperture_diameter / f0)
    return np.stack([camera.pixel_pitch / s0 * f0 / f, half, power, 1 / f - power], axis=-1)
