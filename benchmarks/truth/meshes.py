"""Scenes as meshes for programs that trace paths: corners with their places in an image, and poses over the exposure.

Curved surfaces are cut so finely that they are off by less than `SAG` px in the middle. What is behind all others
is a rectangle so far away that its blur is that of infinity. No code of the package makes any of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.truth.images import NUMBERS, mapping_of
from clsco.truth.problem import poses_of

Array = NDArray[Any]
SAG = 0.003  # px by which a surface is off
FAR = 1e7  # mm
LONG = 1.0  # half-length of a surface without bounds, in distances of its center
SLENDER = 4.0  # length of a cell along a cylinder, in radii: longer ones make slow hierarchies of boxes
BEYOND = 3  # frames that a projected image is mirrored to either side
WALL = 1e-4  # thickness of a wall that is seen from both sides, in radii


@dataclass(frozen=True)
class Mesh:
    """Triangles of one object.

    Attributes
    ----------
    vertices : ndarray, (n, 3)
        In mm in the object's frame: x right, y up, z away from the camera.
    places : ndarray, (n, 2)
        Place of each vertex in the image, right and up from its lower left corner, in copies of it.
    faces : ndarray of int, (m, 3)
        Numbers of vertices, counterclockwise as seen from the side that glows.
    image : ndarray, (rows, columns, 3)
        Linear radiance.
    wrap : str
        Beyond the image: "repeat", "mirror" or "clamp".
    nearest : bool
        Texels are not interpolated.
    poses : ndarray, (times, 4, 4)
        From the object's frame to the camera's at times from the begin of the exposure to its end.
    """

    vertices: Array
    places: Array
    faces: Array
    image: Array
    wrap: str
    nearest: bool
    poses: Array

    @property
    def moves(self) -> bool:
        """True if the pose changes."""
        return bool(np.any(self.poses != self.poses[0]))


def meshes_of(scene: Any, images: Sequence[Array], times: int) -> list[Mesh]:
    """Meshes of all objects of a scene.

    Parameters
    ----------
    scene
        As the ray tracer reads it, by the names of its attributes, with its resolution; cards, planes, spheres,
        ellipsoids and cylinders with images on their surfaces, or of one color, and a background.
    images : sequence of ndarray
        Linear radiance, one for each object.
    times : int
        Number of poses.
    """
    known = [(item, image) for item, image in zip(scene.objects, images, strict=True) if item.shape != "background"]
    alone = scene.model_copy(update={"objects": tuple(item for item, _ in known)})
    moments = np.linspace(0.0, scene.sequence.shutter, times)
    found, _ = poses_of(alone, "", moments)
    poses = np.tile(np.eye(4), (*found.shape[:2], 1, 1))
    poses[..., :3, :3] = np.swapaxes(found[..., :9].reshape(*found.shape[:2], 3, 3), -1, -2)
    poses[..., :3, 3] = found[..., 9:]
    sag = SAG * scene.camera.pixel_pitch / scene.camera.normalization_distance
    meshes = [_mesh(item, _colored(image), poses[:, k], sag) for k, (item, image) in enumerate(known)]
    behind = [image for item, image in zip(scene.objects, images, strict=True) if item.shape == "background"]
    return meshes + [_far(scene.camera, _colored(image), times) for image in behind]


def _colored(image: Array) -> Array:
    """An image with three channels, (rows, columns, 3) float32; of one texel where all are the same."""
    image = np.ascontiguousarray(np.broadcast_to(image.reshape(*image.shape[:2], -1), (*image.shape[:2], 3)))
    return (image[:1, :1] if np.all(image == image[0, 0]) else image).astype(np.float32)


def _mesh(item: Any, image: Array, poses: Array, sag: float) -> Mesh:
    lies = getattr(item, "texture_mapping", "projected") != "projected"
    if not lies and image.shape[:2] != (1, 1):
        raise ValueError(
            f"meshes: image of {item.name} must lie on its surface or be of one color; got a projected one"
        )
    numbers = mapping_of(item, image.shape[:2], 0) if lies else None
    right, up, towards = _axes(item) if numbers is None else numbers[NUMBERS : NUMBERS + 9].reshape(3, 3)
    distance = float(np.linalg.norm(poses[0, :3, 3]))
    around = _cells(item, sag * distance)
    match item.shape:
        case "rectangle":
            s, t = np.meshgrid(*(np.array([-0.5, 0.5]) * extent for extent in item.size))
            points, faces = _flat(s, t, item.offset), _grid(1, 1)
        case "plane":
            s, t = np.meshgrid(*2 * [np.array([-1.0, 1.0]) * item.distance])
            points, faces = s.reshape(-1, 1) * right + t.reshape(-1, 1) * up, _grid(1, 1)
        case "disc":
            k = np.arange(around)
            angle = 2.0 * math.pi * k / around
            s, t = (np.append(0.0, item.radius * side(angle)) for side in (np.cos, np.sin))
            points, faces = _flat(s, t, item.offset), np.stack([0 * k, 1 + k, 1 + (k + 1) % around], axis=1)
        case "sphere" | "ellipsoid":
            s, t = np.meshgrid(_span(math.pi, around), _span(0.5 * math.pi, around // 2))
            axes = np.array([item.radius] * 3 if item.shape == "sphere" else item.semi_axes)
            ball = [np.cos(t) * np.sin(s), np.sin(t), -np.cos(t) * np.cos(s)]
            points, faces = np.stack([side.ravel() for side in ball], axis=1) * axes, _grid(around, around // 2)
        case "cylinder":
            low, high = item.bounds[1] if item.bounds else (-LONG * distance, LONG * distance)
            along = math.ceil((high - low) / (SLENDER * item.radius))
            angle, t = np.meshgrid(_span(math.pi, around), np.linspace(low, high, along + 1))
            s, faces = item.radius * angle, _grid(around, along)
            round_ = np.sin(angle).reshape(-1, 1) * right + np.cos(angle).reshape(-1, 1) * towards
            points = item.radius * round_ + t.reshape(-1, 1) * up
        case _:
            raise ValueError(f"meshes: shape must be a card, plane, sphere, ellipsoid or cylinder; got {item.shape!r}")
    places = np.full((s.size, 2), 0.5)
    if numbers is not None:
        places += np.stack([s.ravel() / numbers[5], t.ravel() / numbers[6]], axis=1)
    wrap = "repeat" if numbers is None else ("repeat", "mirror", "clamp")[int(numbers[4])]
    if item.shape == "cylinder" and item.bounds:  # it is seen from inside as well
        inside = points - WALL * item.radius * round_
        faces = np.concatenate([faces, faces[:, ::-1] + len(points)])
        points, places = np.concatenate([points, inside]), np.concatenate([places, places])
    return Mesh(points, places, faces, image, wrap, False, poses)


def _axes(item: Any) -> Array:
    """Right, up and towards the camera of an object whose color is the same everywhere."""
    up = np.asarray(getattr(item, "axis", (0.0, 1.0, 0.0)), float)
    up /= np.linalg.norm(up)
    towards = np.array([0.0, 0.0, -1.0]) + up[2] * up
    towards /= np.linalg.norm(towards)
    return np.stack([np.cross(towards, up), up, towards])


def _cells(item: Any, sag: float) -> int:
    """Even number of cells around an object, whose chords are off by `sag` mm; 2 for one that is flat."""
    radius = max(getattr(item, "semi_axes", (getattr(item, "radius", 0.0),)))
    return 2 * math.ceil(0.5 * math.pi / math.acos(1.0 - sag / radius)) if radius > sag else 2


def _span(half: float, cells: int) -> Array:
    return np.linspace(-half, half, cells + 1)


def _flat(s: Array, t: Array, z: float) -> Array:
    return np.stack([s.ravel(), t.ravel(), np.full(s.size, z)], axis=1)


def _grid(across: int, upward: int) -> Array:
    """Two triangles for each cell of a grid of vertices, row by row upwards, counterclockwise from the right side."""
    j, i = np.mgrid[:upward, :across]
    here = (i + (across + 1) * j).ravel()
    above = here + across + 1
    return np.concatenate(
        [np.stack(three, axis=1) for three in ((here, here + 1, above + 1), (here, above + 1, above))]
    )


def _far(camera: Any, image: Array, times: int) -> Mesh:
    """A background: its image fills the frame, texel by pixel, and is mirrored at its borders."""
    half = np.array(camera.resolution) * camera.pixel_pitch / camera.normalization_distance * FAR / 2.0
    s, t = np.meshgrid(*2 * [np.array([-1.0, 1.0]) * BEYOND])
    points = _flat(s * half[0], t * half[1], FAR)
    places = 0.5 + 0.5 * np.stack([s.ravel(), t.ravel()], axis=1)
    return Mesh(points, places, _grid(1, 1), image, "mirror", True, np.tile(np.eye(4), (times, 1, 1)))
