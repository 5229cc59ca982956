"""Plain lines through a scene, by the definitions of its objects."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.optics.lens import Lens
from clsco.optics.motion import Pose, rest_center, static_rotation
from clsco.scene.model import Cone, Cylinder, Disc, Ellipsoid, Object, Plane, Quadric, Sphere

Array = NDArray[Any]


def lens_points(lens: Lens, cells: Array, right: Array, down: Array) -> Array:
    """Points (..., 3) of the lens, mm, that are so many cells off its middle; cells: per lens radius, signed."""
    x, y = lens.radius * right / cells, -lens.radius * down / cells
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def quadric_of(item: Object) -> tuple[Array, Array, float]:
    """Matrix, vector and constant of x M x + 2 v x + k = 0 in the object's own frame, from its definition."""
    if isinstance(item, Plane):
        return np.zeros((3, 3)), np.array([-item.slope_x, -item.slope_y, 1.0]) / 2, 0.0
    if isinstance(item, Disc):
        return np.zeros((3, 3)), np.array([0.0, 0.0, 0.5]), -item.offset
    if isinstance(item, Sphere):
        return np.eye(3), np.zeros(3), -(item.radius**2)
    if isinstance(item, Ellipsoid):
        return np.diag(1.0 / np.square(item.semi_axes)), np.zeros(3), -1.0
    if isinstance(item, Cylinder):
        axis = np.asarray(item.axis) / np.linalg.norm(item.axis)
        return np.eye(3) - np.outer(axis, axis), np.zeros(3), -(item.radius**2)
    if isinstance(item, Cone):
        return np.diag([1.0, 1.0, -(np.tan(np.radians(item.half_angle)) ** 2)]), np.zeros(3), 0.0
    assert isinstance(item, Quadric)
    xx, yy, zz, xy, yz, zx, x, y, z, constant = item.coefficients
    matrix = np.array([[xx, xy / 2, zx / 2], [xy / 2, yy, yz / 2], [zx / 2, yz / 2, zz]])
    return matrix, np.array([x, y, z]) / 2, constant


def own_frame(item: Object, pose: Pose, points: Array) -> Array:
    """Points (..., 3) in the object's own frame."""
    return np.asarray((points - rest_center(item) - pose.shift) @ pose.rotation @ static_rotation(item))


def crossings(item: Object, pose: Pose, start: Array, end: Array) -> Array:
    """Mask of lines from start to end (..., 3) in mm that cross a surface, apart from their ends: (...)."""
    matrix, vector, constant = quadric_of(item)
    own = [own_frame(item, pose, point) for point in (start, end)]
    way = own[1] - own[0]
    a = np.einsum("...i,ij,...j", way, matrix, way)
    b = np.einsum("...i,ij,...j", way, matrix, own[0]) + way @ vector
    c = np.einsum("...i,ij,...j", own[0], matrix, own[0]) + 2 * own[0] @ vector + constant
    crossed = np.zeros(a.shape, dtype=bool)
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - a * c)
        t = -b - np.copysign(root, b)
        for along in (t / a, c / t):
            hit = (along > 1e-9) & (along < 1.0)
            point = own[0] + np.where(hit, along, 0.0)[..., None] * way
            if isinstance(item, Cone):
                hit &= point[..., 2] * (1.0 if item.nappe == "away" else -1.0) >= 0
            if isinstance(item, Disc):
                hit &= np.hypot(point[..., 0], point[..., 1]) <= item.radius
            for axis, (low, high) in enumerate(item.bounds or ()):
                hit &= (point[..., axis] >= low) & (point[..., axis] <= high)
            crossed |= hit
    return crossed


def passes_lens(lens: Lens, item: Object, pose: Pose, extent: float) -> bool:
    """True if a quadric without its bounds goes through the lens, where nothing is to be seen of a scene."""
    matrix, vector, constant = quadric_of(item)
    angle = np.arange(64) * (np.pi / 32)
    rings = [size * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1) for size in np.linspace(0, extent, 9)]
    own = own_frame(item, pose, lens.radius * np.concatenate(rings))
    value = np.einsum("ni,ij,nj->n", own, matrix, own) + 2 * own @ vector + constant
    return bool(value.min() <= 0 <= value.max())
