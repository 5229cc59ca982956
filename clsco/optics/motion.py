"""Rigid motion: poses of objects and cameras at a time (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import fsum, pi, radians, sin, sqrt
from typing import Literal

import numpy as np

from clsco.optics.keyframes import Array, Orientations, Path, orientations_through, path_through
from clsco.scene.groups import group_origin
from clsco.scene.model import Group, Object, ObjectMotion, Scene
from clsco.scene.motions import CameraShake, Keyframe
from clsco.scene.quantities import Vector
from clsco.scene.rotations import rotation_rows
from clsco.scene.shapes import origin

Eye = Literal["left", "right"]
# The thesis turns an object in a frame whose z axis points towards the camera (2.13).
TOWARDS_CAMERA = np.diag([1.0, 1.0, -1.0])
SHAKE_SINES = 32  # number of sines in each component of a shake
EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Pose:
    """Pose of an object at one time, in the camera frame: P = center + shift + rotation (P0 - center); shift in mm."""

    rotation: Array
    shift: Array


UNTURNED, UNMOVED = np.eye(3), np.zeros(3)
UNTURNED.flags.writeable = UNMOVED.flags.writeable = False
AT_REST = Pose(UNTURNED, UNMOVED)


def rotation_matrix(angles: Array, rotation: str) -> Array:
    """Rotation matrix (3, 3) of three angles in rad, in the object's frame.

    "euler": the matrix of 2.14 to 2.23. "axis": a rotation by |angles| about the vector `angles` (Rodrigues), in the
    same sense as the matrix for a single axis, which is opposite to the right-hand rule.
    """
    if rotation == "axis":
        angle = float(np.linalg.norm(angles))
        if angle == 0.0:
            return np.eye(3)
        x, y, z = -angles / angle
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        sine, cosine = _sine_cosine(np.asarray(angle))
        return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    (sx, sy, sz), (cx, cy, cz) = _sine_cosine(angles)
    return np.array(
        [
            [cy * cz, sx * sy * cz + cx * sz, -cx * sy * cz + sx * sz],
            [-cy * sz, -sx * sy * sz + cx * cz, cx * sy * sz + sx * cz],
            [sy, -sx * cy, cx * cy],
        ]
    )


def _sine_cosine(angles: Array) -> tuple[Array, Array]:
    """Sines and cosines, exact for quarter turns: pi/2 in float64 is slightly off and would tilt a plane."""
    sines, cosines = np.sin(angles), np.cos(angles)
    return sines * (np.abs(sines) >= EPSILON) + 0.0, cosines * (np.abs(cosines) >= EPSILON) + 0.0  # no -0.0


def pose_at(motion: ObjectMotion, time: float, rotation: str) -> Pose:
    """Pose of a motion at a time in s, by constant accelerations or between keyframes.

    Poses are always computed from the reference pose, never composed step by step (thesis 4.3.6.2). Degrees are reduced
    to one turn before conversion to radians, as sin(1e7 deg) would lose four digits; for "axis", the length of the
    vector is reduced instead of its components. With accelerations each Euler angle, or component of the rotation
    vector, is w t + a t^2 / 2 in deg; the vector's axis is constant if the acceleration is along the angular velocity.
    If all keyframes rotate about one coordinate axis, the angle is interpolated, including whole turns; otherwise, the
    orientation is interpolated.
    """
    if not motion.model_fields_set:
        return AT_REST
    if motion.keyframe is None:
        degrees = _displacement(motion.angular_velocity, motion.angular_acceleration, time)
        return Pose(_camera_rotation(degrees, rotation), _displacement(motion.velocity, motion.acceleration, time))
    shifts, turns = _track(motion, rotation)
    turned = turns.at(time)
    return Pose(turned if isinstance(turns, Orientations) else _camera_rotation(turned, rotation), shifts.at(time))


def keyframe_at(motion: ObjectMotion, time: float, rotation: str) -> Keyframe:
    """Keyframe with the pose at a time in s, rounded to 1e-9 mm and deg; angles about one axis keep whole turns."""
    if motion.keyframe is None:
        angles = _displacement(motion.angular_velocity, motion.angular_acceleration, time).tolist()
        shift = _displacement(motion.velocity, motion.acceleration, time)
    else:
        shifts, turns = _track(motion, rotation)
        angles = turns.angles_at(time, rotation) if isinstance(turns, Orientations) else turns.at(time).tolist()
        shift = shifts.at(time)
    (x, y, z), (a, b, c) = ((round(part, 9) + 0.0 for part in values) for values in (shift.tolist(), angles))
    return Keyframe(time=time, position=(x, y, z), rotation=(a, b, c))


def _camera_rotation(degrees: Array, rotation: str) -> Array:
    """Rotation matrix (3, 3) for angles in deg, in the axes of the camera."""
    if not degrees.any():
        return UNTURNED
    if rotation == "axis":
        length = float(np.linalg.norm(degrees))
        angles = degrees * (np.radians(np.fmod(length, 360.0)) / length) if length > 0 else np.zeros(3)
    else:
        angles = np.radians(np.fmod(degrees, 360.0))
    return np.asarray(TOWARDS_CAMERA @ rotation_matrix(angles, rotation) @ TOWARDS_CAMERA)


def _displacement(speed: Vector, gain: Vector | None, time: float) -> Array:
    """Displacement (3,) v t + a t^2 / 2; speed: v; gain: acceleration a, None for 0."""
    displacement = np.asarray(speed, dtype=np.float64) * time
    return displacement if gain is None else displacement + np.asarray(gain, dtype=np.float64) * (0.5 * time * time)


@lru_cache(maxsize=512)
def _track(motion: ObjectMotion, rotation: str) -> tuple[Path, Path | Orientations]:
    """Paths through keyframes: of the shift in mm, and of the rotation, as angles in deg or as an orientation."""
    keys, interpolation, outside = motion.keyframe, motion.interpolation, motion.outside
    assert keys is not None
    assert interpolation is not None
    assert outside is not None
    times, angles = [key.time for key in keys], [key.rotation for key in keys]
    shifts = path_through(times, [key.position for key in keys], interpolation, outside)
    if sum(motion.turns) < 2:
        return shifts, path_through(times, angles, interpolation, outside)
    return shifts, orientations_through(times, angles, rotation, interpolation, outside)


def rest_center(item: Object) -> Array:
    """Center of rotation (3,) of an object in its reference pose, mm."""
    return np.asarray(origin(item), dtype=np.float64)


def static_rotation(item: Object) -> Array:
    """Matrix R0 (3, 3) from an object's own frame to the camera's axes in its reference pose.

    In a `Pose`, a point p of the object's own frame is at center + shift + rotation R0 p. R0 is exactly orthonormal for
    no rotation and for quarter turns.
    """
    return np.array(rotation_rows(item.rotation))


def eye_pose(scene: Scene, eye: Eye, time: float) -> Pose:
    """Pose of the camera at a time in s, or of one view of a stereo pair, in the frame of the camera's reference pose.

    A camera moves and rotates about the center of its lens; shake is applied first, in the camera's own axes. The left
    camera of a stereo pair is the scene's; the right one is `baseline` to its right. `toe_in` turns both inwards.
    """
    rig = pose_at(scene.camera.motion, time, scene.motion.rotation)
    if scene.camera.shake is not None:
        shaken = shake_pose(scene.camera.shake, time)
        rig = Pose(rig.rotation @ shaken.rotation, rig.shift + rig.rotation @ shaken.shift)
    if scene.stereo is None or (eye == "left" and scene.stereo.toe_in == 0.0):
        return rig
    angle = np.radians(scene.stereo.toe_in) * (1.0 if eye == "left" else -1.0)
    inwards = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    baseline = np.array([scene.stereo.baseline if eye == "right" else 0.0, 0.0, 0.0])
    return Pose(rig.rotation @ inwards, rig.shift + rig.rotation @ baseline)


def shake_pose(shake: CameraShake, time: float) -> Pose:
    """Displacement of a shaking camera at a time in s, in the frame of the camera without shake.

    Each component of the rotation vector (right, up, backwards) and of the shift (right, up, forwards) is a sum of
    SHAKE_SINES sines of equal amplitude. The frequency band is divided into as many equal parts, with one sine in each.
    Place of the frequency in its part, and phase in turns, are 2^-53 (n >> 11), with numbers n from
    `numpy.random.Philox(key=seed)` (Salmon et al., 2011), component by component and sine by sine. The path's bits
    depend only on seed and time.
    """
    amplitudes = [radians(shake.rotation_rms)] * 3 + [shake.translation_rms] * 3
    waves = _shake_waves(shake.seed, shake.band)
    sums = [fsum(sin(2.0 * pi * ((f * time + phase) % 1.0)) for f, phase in sines) for sines in waves]
    scale = sqrt(2.0 / (3 * SHAKE_SINES))  # of each sine, so that three components together have an rms of 1
    components = np.array([scale * size * total for size, total in zip(amplitudes, sums, strict=True)])
    return Pose(TOWARDS_CAMERA @ rotation_matrix(components[:3], "axis") @ TOWARDS_CAMERA, components[3:])


@lru_cache(maxsize=16)
def _shake_waves(seed: int, band: tuple[float, float]) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Frequency in Hz and phase in turns of the sines of the six components."""
    raw = np.random.Philox(key=seed).random_raw(2 * 6 * SHAKE_SINES) >> 11
    uniform = (raw * 2.0**-53).reshape(6, SHAKE_SINES, 2)
    low, step = band[0], (band[1] - band[0]) / SHAKE_SINES
    return tuple(
        tuple((low + step * (k + place), phase) for k, (place, phase) in enumerate(sines)) for sines in uniform.tolist()
    )


def rest_poses(scene: Scene) -> tuple[Pose, ...]:
    """Reference poses of all objects, neither moved nor rotated; textures are projected in them."""
    return (AT_REST,) * len(scene.objects)


def poses_at(scene: Scene, time: float, eye: Eye = "left") -> tuple[Pose, ...]:
    """Poses of all objects at a time in s, in the frame of the camera at that time."""
    camera, poses = eye_pose(scene, eye, time), []
    groups = {group.name: _group_pose(scene, group, time) for group in scene.groups}
    for item in scene.objects:
        pose, center = pose_at(item.motion, time, scene.motion.rotation), rest_center(item)
        if item.group is not None:
            pose = _compose(pose, center, *groups[item.group])
        if camera is AT_REST and pose is AT_REST:
            poses.append(AT_REST)
            continue
        shift = camera.rotation.T @ (pose.shift - camera.shift) + (camera.rotation.T @ center - center)
        poses.append(Pose(camera.rotation.T @ pose.rotation, shift))
    return tuple(poses)


def moved_points(points: Array, center: Array, before: Pose, after: Pose) -> Array:
    """Points (..., 3) in mm of a rigid object, moved from one pose to another; center: see `rest_center`."""
    body = (points - center - before.shift) @ before.rotation  # turned back
    return np.asarray(center + after.shift + body @ after.rotation.T)


def _group_pose(scene: Scene, group: Group, time: float) -> tuple[Pose, Array]:
    """Pose of a group, and its center of rotation (3,), mm."""
    members = [item for item in scene.objects if item.group == group.name]
    origin = np.asarray(group_origin(group, members)) if members else np.zeros(3)
    return pose_at(group.motion, time, scene.motion.rotation), origin


def _compose(pose: Pose, center: Array, group: Pose, origin: Array) -> Pose:
    """Pose of an object that moves within a group: first its own pose moves P0 to P1, then the group's pose moves P1 to
    P = origin + shift + rotation (P1 - origin).
    """
    arm = center - origin
    shift = group.shift + group.rotation @ pose.shift + (group.rotation @ arm - arm)
    return Pose(group.rotation @ pose.rotation, shift)
