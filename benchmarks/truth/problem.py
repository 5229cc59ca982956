"""Input of the ray tracer: shapes as ten coefficients in frames of their own, and the poses of these.

A scene is read by attribute names only ("scene.camera.focal_length", ...): no code is shared with the package.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.truth.surface_images import SIZE, lies, mapping_of

Array = NDArray[np.float64]
Textures = NDArray[Any] | Sequence[NDArray[Any]]


@dataclass(frozen=True)
class Problem:
    """Input of the tracing kernel, in mm, s and rad; a cached image is keyed by these fields.

    `coefficients` (objects, 10), in the order a200 a020 a002 a110 a011 a101 a100 a010 a001 a000, about `centers`
    (objects, 3), x right, y up, z away from the camera; `bounds` (objects, 7) as x0 x1 y0 y1 z0 z1 in the same frame,
    and the square of the largest distance from the z axis; `rotations` (objects, 3, 3), from that frame to the camera's
    axes at t = 0; `group_...` (objects, 3) of what carries each object, 0 for nothing; `textures` (objects, rows,
    columns, channels) linear radiance, 0 where an image lies on the surface; `mappings` (objects, SIZE) and `images`
    (texels, channels) of these (`surface_images.py`); `accelerations` and `angular_accelerations` (objects, 3) of
    the objects' own motions; `shake` (6, sines, 3) of the camera: amplitude in rad or mm, frequency in Hz, phase in
    turns, of its rotation vector and then of its shift; `light` (5,): where it is in mm, or three numbers towards it,
    whether the former, and the share of the texture that is seen without it; None without a light; `zoom` (keys, 2):
    times, and focal lengths in those of the camera, linear between and constant outside; None without any.
    """

    pitch_ratio: float
    lens_radius: float
    focus_term: float
    start: float
    shutter: float
    axis_rotation: bool
    coefficients: Array
    bounds: Array
    centers: Array
    rotations: Array
    velocities: Array
    angular_velocities: Array
    accelerations: Array
    angular_accelerations: Array
    shake: Array
    group_centers: Array
    group_velocities: Array
    group_angular_velocities: Array
    textures: Array
    mappings: Array
    images: Array
    light: Array | None
    zoom: Array | None


def _shape(item: Any) -> tuple[Array, Any, tuple[float, float]]:
    """Coefficients (10,), center (3) mm and z range (2) mm of one object; ValueError for an unknown shape."""
    k = np.zeros(10)
    everywhere = (-np.inf, np.inf)
    match item.shape:
        case "plane":  # b x + c y - z = 0 about (0, 0, a)
            k[6:9] = item.slope_x, item.slope_y, -1.0
            return k, (0.0, 0.0, item.distance), everywhere
        case "rectangle" | "disc":  # z = offset about its center
            k[8:] = 1.0, -item.offset
            return k, item.center, everywhere
        case "sphere":
            k[[0, 1, 2, 9]] = 1.0, 1.0, 1.0, -(item.radius**2)
            return k, item.center, everywhere
        case "ellipsoid":
            k[:3], k[9] = 1.0 / np.asarray(item.semi_axes, float) ** 2, -1.0
            return k, item.center, everywhere
        case "cylinder":  # |q|^2 - (q . axis)^2 = radius^2
            x, y, z = np.asarray(item.axis, float) / np.linalg.norm(item.axis)
            k[:6] = 1 - x * x, 1 - y * y, 1 - z * z, -2 * x * y, -2 * y * z, -2 * x * z
            k[9] = -(item.radius**2)
            return k, item.center, everywhere
        case "cone":
            k[:3] = 1.0, 1.0, -(math.tan(math.radians(item.half_angle)) ** 2)
            return k, item.apex, (0.0, np.inf) if item.nappe == "away" else (-np.inf, 0.0)
        case "quadric":
            return np.asarray(item.coefficients, float), item.center, everywhere
    raise ValueError(f"raytracer: shape must be analytic; got {item.shape!r}")


def _texture_stack(images: list[NDArray[Any]], rows: int, columns: int, channels: int) -> Array:
    """One image per object as (objects, rows, columns, channels) float64."""
    for image in images:
        if image.shape[:2] != (rows, columns) or image.ndim not in (2, 3):
            raise ValueError(f"raytracer: textures must be {rows} x {columns} texels; got {image.shape}")
    images = [image.reshape(rows, columns, -1) for image in images]
    size = rows, columns, channels
    return np.stack([np.broadcast_to(image, size) for image in images]).astype(float, order="C")


def _groups(scene: Any, centers: Sequence[Any]) -> Array:
    """Center (mm), velocity and angular velocity (deg/s) of the group of each object: (3, objects, 3), 0 for none."""
    found, firsts = np.zeros((3, len(centers), 3)), dict[str, Any]()
    by_name = {group.name: group for group in scene.groups}
    for k, (item, center) in enumerate(zip(scene.objects, centers, strict=True)):
        if item.group is not None:
            group, first = by_name[item.group], firsts.setdefault(item.group, center)
            middle = first if group.origin is None else group.origin
            found[:, k] = middle, group.motion.velocity, group.motion.angular_velocity
    return found


def _on_surfaces(objects: Any, images: list[NDArray[Any]], channels: int) -> tuple[Array, Array]:
    """Texels of all images that lie on surfaces, and how they do."""
    flat, mappings = [np.zeros((0, channels))], np.zeros((len(objects), SIZE))
    for number, (item, image) in enumerate(zip(objects, images, strict=True)):
        if lies(item):
            mappings[number] = mapping_of(item, image.shape[:2], sum(map(len, flat)))
            whole = image.reshape(*image.shape[:2], -1)
            flat.append(np.broadcast_to(whole, (*whole.shape[:2], channels)).reshape(-1, channels).astype(float))
    return np.concatenate(flat), mappings


def _light(light: Any) -> Array | None:
    """The numbers (5,) of a light; its direction has z towards the camera."""
    if light is None:
        return None
    place = light.position or np.multiply(light.direction, [1.0, 1.0, -1.0])
    return np.array([*place, float(light.position is not None), light.ambient])


def prepare(scene: Any, textures: Textures, rows: int, columns: int, frame: int = 0) -> Problem:
    """Read a scene by its attribute names.

    `textures`: linear radiance, (rows, columns[, channels]), one image for all objects or a sequence of one
    per object; `frame`: index of the video frame. Raises ValueError for a shape without a formula and for a
    projected texture of another size than the frame.
    """
    camera, objects = scene.camera, scene.objects
    images = [textures] * len(objects) if isinstance(textures, np.ndarray) else list(textures)
    if len(images) != len(objects):
        raise ValueError(f"raytracer: textures must be one per object, {len(objects)}; got {len(images)}")
    channels = max(image.shape[2] if image.ndim == 3 else 1 for image in images)
    flat, mappings = _on_surfaces(objects, images, channels)
    empty = np.zeros((rows, columns))
    projected = [empty if lies(item) else image for item, image in zip(objects, images, strict=True)]
    shapes = [_shape(item) for item in objects]
    group_centers, group_velocities, group_turns = _groups(scene, [shape[1] for shape in shapes])
    bounds = np.full((len(objects), 7), np.inf)
    bounds[:, :6:2] = -np.inf
    for box, item, (_, _, (low, high)) in zip(bounds, objects, shapes, strict=True):
        if item.bounds is not None:
            box[:6] = np.ravel(item.bounds)
        box[4:6] = max(box[4], low), min(box[5], high)
        if item.shape == "disc":
            box[6] = item.radius**2
    return Problem(
        pitch_ratio=camera.pixel_pitch / camera.normalization_distance,
        lens_radius=camera.aperture_diameter / 2,
        focus_term=1 / camera.focal_length - 1 / camera.sensor_distance,
        start=frame * scene.sequence.interval,
        shutter=scene.sequence.shutter,
        axis_rotation=scene.motion.rotation == "axis",
        coefficients=np.array([shape[0] for shape in shapes]),
        bounds=bounds,
        centers=np.array([shape[1] for shape in shapes], float),
        rotations=np.array([_static_rotation(item.rotation) for item in objects]),
        velocities=np.array([item.motion.velocity for item in objects], float),
        angular_velocities=np.radians([item.motion.angular_velocity for item in objects]),
        accelerations=_gains(objects, "acceleration"),
        angular_accelerations=np.radians(_gains(objects, "angular_acceleration")),
        shake=_shake(getattr(camera, "shake", None)),
        group_centers=group_centers,
        group_velocities=group_velocities,
        group_angular_velocities=np.radians(group_turns),
        textures=_texture_stack(projected, rows, columns, channels),
        mappings=mappings,
        images=flat,
        light=_light(getattr(scene, "light", None)),
        zoom=_zoom(getattr(scene, "lens", None), camera.focal_length),
    )


def _zoom(lens: Any, focal_length: float) -> Array | None:
    """See `Problem.zoom`. Raises ValueError for other changes of a lens."""
    if lens is None:
        return None
    others = any(key.focal_length is None or key.focus_distance or key.f_number for key in lens.keyframe)
    if others or lens.interpolation != "linear" or lens.outside != "hold":
        raise ValueError("raytracer: a lens must zoom alone, linearly; got other keyframes")
    return np.array([[key.time, key.focal_length / focal_length] for key in lens.keyframe])


def lenses(problem: Problem, times: Array) -> Array:
    """Ratio of pitch and s0, radius of the lens and K at some times, (3, times).

    The image grows as the focal length, the f-number and the distance in focus stay: s0 ~ f, D ~ f, and K = 1/u.
    """
    found = np.array([problem.pitch_ratio, problem.lens_radius, problem.focus_term])[:, None] * np.ones(len(times))
    if problem.zoom is not None:
        grown = np.interp(times, *problem.zoom.T)
        found *= np.stack([1.0 / grown, grown, np.ones(len(times))])
    return found


def _gains(objects: Any, key: str) -> Array:
    """An acceleration of each object, (objects, 3), 0 where none is given."""
    return np.array([getattr(item.motion, key, None) or (0.0, 0.0, 0.0) for item in objects], float)


def _shake(shake: Any, sines: int = 32) -> Array:
    """See `Problem.shake`, by the words of docs/motion.md; no sines without a shake."""
    if shake is None:
        return np.zeros((6, 0, 3))
    numbers = np.random.Philox(key=shake.seed).random_raw(12 * sines) >> np.uint64(11)
    place, phase = np.moveaxis(numbers.reshape(6, sines, 2) / 2.0**53, -1, 0)
    low, high = shake.band
    frequency = low + (np.arange(sines) + place) * (high - low) / sines
    sizes = np.repeat([math.radians(shake.rotation_rms), shake.translation_rms], 3)[:, None]
    return np.stack([np.broadcast_to(sizes * math.sqrt(2 / (3 * sines)), place.shape), frequency, phase], axis=-1)


def rotation_matrix(angles: Array, axis_rotation: bool) -> Array:
    """M of P(t) = C + v t + M (P0 - C) for `angles` = omega t, (..., 3) rad: (..., 3, 3) in camera axes.

    The thesis' matrix (2.14 to 2.23) acts on x right, y up, z towards the camera. With `axis_rotation` a turn
    about the vector `angles` takes its place, in the sense that the matrix has for a single axis (clockwise
    seen from the axis' tip).
    """
    towards = np.diag([1.0, 1.0, -1.0])
    if axis_rotation:
        matrix = Rotation.from_rotvec(-angles.reshape(-1, 3)).as_matrix().reshape(*angles.shape, 3)
        return towards @ matrix @ towards
    (sx, sy, sz), (cx, cy, cz) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    matrix = np.array(
        [
            [cy * cz, sx * sy * cz + cx * sz, -cx * sy * cz + sx * sz],
            [-cy * sz, -sx * sy * sz + cx * cz, cx * sy * sz + sx * cz],
            [sy, -sx * cy, cx * cy],
        ]
    )
    return towards @ np.moveaxis(matrix, (0, 1), (-2, -1)) @ towards


def _static_rotation(given: Any) -> Array:
    """Matrix (3, 3) of Euler angles or of an axis with an angle, both in deg, or of a quaternion w x y z."""
    if given is None:
        return np.eye(3)
    if hasattr(given, "quaternion"):
        w, x, y, z = given.quaternion
        towards = np.diag([1.0, 1.0, -1.0])
        return towards @ Rotation.from_quat([x, y, z, w]).inv().as_matrix() @ towards
    if hasattr(given, "axis"):
        axis = np.asarray(given.axis, float)
        return rotation_matrix(math.radians(given.angle) * axis / np.linalg.norm(axis), True)
    return rotation_matrix(np.radians(given), False)


def inverse_poses(problem: Problem, times: Array) -> Array:
    """Per time and object, the inverse rotation (9) and the moved center (3): (times, objects, 12), mm."""
    moments = times[:, None, None]
    angles = moments * (problem.angular_velocities + moments / 2 * problem.angular_accelerations)
    turn = rotation_matrix(angles, problem.axis_rotation) @ problem.rotations
    center = problem.centers + moments * (problem.velocities + moments / 2 * problem.accelerations)
    carried = rotation_matrix(moments * problem.group_angular_velocities, problem.axis_rotation)
    turn, arm = carried @ turn, center - problem.group_centers
    center = problem.group_centers + moments * problem.group_velocities + np.einsum("...ij,...j->...i", carried, arm)
    if problem.shake.size:
        size, frequency, phase = np.moveaxis(problem.shake, -1, 0)
        found = (size * np.sin(2 * np.pi * (frequency * times[:, None, None] + phase))).sum(axis=-1)
        back = np.swapaxes(rotation_matrix(found[:, :3], True), -1, -2)[:, None]
        turn, center = back @ turn, np.einsum("...ij,...j->...i", back, center - found[:, None, 3:])
    return np.concatenate([np.swapaxes(turn, -1, -2).reshape(*turn.shape[:2], 9), center], axis=-1)
