"""Input of the ray tracer: shapes as ten coefficients in frames of their own, and the poses of these.

A scene is read by attribute names only ("scene.camera.focal_length", ...); no code is shared with what renders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.truth.equations import bounds_of, surface_of
from clsco.truth.images import SIZE, lies, mapping_of
from clsco.truth.poses import rotation_matrix, shake_at, shake_sines, static_rotation

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
    (texels, channels) of these (`clsco.truth.images`); `accelerations` and `angular_accelerations` (objects, 3) of
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
    shapes = [surface_of(item) for item in objects]
    group_centers, group_velocities, group_turns = _groups(scene, [shape[1] for shape in shapes])
    bounds = np.array([bounds_of(item, span) for item, (_, _, span) in zip(objects, shapes, strict=True)])
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
        rotations=np.array([static_rotation(item.rotation) for item in objects]),
        velocities=np.array([item.motion.velocity for item in objects], float),
        angular_velocities=np.radians([item.motion.angular_velocity for item in objects]),
        accelerations=_gains(objects, "acceleration"),
        angular_accelerations=np.radians(_gains(objects, "angular_acceleration")),
        shake=shake_sines(getattr(camera, "shake", None)),
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
        shaken, moved = shake_at(problem.shake, times)
        back = np.swapaxes(shaken, -1, -2)[:, None]
        turn, center = back @ turn, np.einsum("...ij,...j->...i", back, center - moved[:, None])
    return np.concatenate([np.swapaxes(turn, -1, -2).reshape(*turn.shape[:2], 9), center], axis=-1)
