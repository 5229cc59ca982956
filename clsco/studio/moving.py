"""Objects that are dragged in the picture: from pixels to the key that says where an object is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.optics.exposure import middle_time
from clsco.optics.lens import ray_step
from clsco.optics.motion import Eye, eye_pose, static_rotation
from clsco.scene.model import Camera, Plane
from clsco.studio.session import Document

PLACES = {"cone": "apex", "plane": "distance", "depth_map": "", "background": ""}
"""Keys that say where an object is, by shape; "": none. That of all others is `center`."""
STEEPEST = 1e-3  # cosine of the angle of a plane's normal with the axis, below which it moves along z alone
ALONG = 500.0  # px
_DIGITS = 4  # of mm that are kept: less than a thousandth of a pixel


@dataclass(frozen=True)
class Grip:
    """An object that the pointer holds.

    Attributes
    ----------
    path : str
        Path of the key that says where it is: "object.0.center".
    start : tuple of float
        Its value before, mm; of a plane the distance alone.
    normal : ndarray of float64, (3,)
        Normal of a plane, with 1 as its last component; else along z.
    depth : float
        Depth of the point that is held, mm.
    axes : ndarray of float64, (3, 3)
        From the camera's axes at the middle of the shutter to those of the scene.
    """

    path: str
    start: tuple[float, ...]
    normal: NDArray[np.float64]
    depth: float
    axes: NDArray[np.float64]

    def value(self, camera: Camera, across: float, down: float, is_along: bool) -> float | list[float]:
        """Position of the object after the pointer has moved by a distance.

        Parameters
        ----------
        camera : Camera
        across, down : float
            Pixels of the frame, to the right and down, since the object was taken hold of.
        is_along : bool
            Move along z: ALONG pixels up multiply the depth by e.

        Returns
        -------
        float or list of float
            New value of the key, mm.

        Notes
        -----
        At constant depth the held point stays under the pointer: x = s0 X / Z (thesis, 2.4). Validated by projections.
        """
        if is_along:
            by = np.array([0.0, 0.0, self.depth * math.expm1(-down / ALONG)])
        else:
            by = np.array([across, -down, 0.0]) * (self.depth * ray_step(camera))
        by = self.axes @ by
        if len(self.start) == 1:  # where the plane, moved as a whole, meets the axis
            return round(self.start[0] + float(self.normal @ by), _DIGITS)
        return [round(old + float(new), _DIGITS) for old, new in zip(self.start, by, strict=True)]


def grip(session: Document, index: int, object_id: int, depth: float, eye: Eye = "left") -> Grip:
    """Take hold of an object.

    Parameters
    ----------
    session : Document
    index : int
        Number of the frame.
    object_id : int
        As the frame has it, in which a box is six objects.
    depth : float
        Depth of the point that is held, mm.
    eye : {"left", "right"}
        View of a stereo pair.

    Raises
    ------
    SceneError
        Nothing is there, or what is there has no place of its own.
    """
    entries = session.object_entries
    if not 0 <= object_id < len(entries):
        raise SceneError("move: there must be an object; got none")
    scene, number = session.scene, entries[object_id]
    surface, shape = scene.objects[object_id], session.state.objects[number]["shape"]
    if not (key := PLACES.get(shape, "center")):
        raise SceneError(f"move: must be an object with a place of its own; got a {shape.replace('_', ' ')}")
    path = f"object.{number}.{key}"
    known = session.known(path)
    start = known if isinstance(known, list) else [known]
    normal, axes = np.array([0.0, 0.0, 1.0]), np.eye(3)
    if isinstance(surface, Plane):
        tilted = static_rotation(surface) @ np.array([-surface.slope_x, -surface.slope_y, 1.0])
        normal = tilted / tilted[2] if abs(tilted[2]) > STEEPEST else normal
    if scene.moves or scene.stereo is not None:
        axes = eye_pose(scene, eye, middle_time(scene.sequence, index)).rotation
    return Grip(path, tuple(map(float, start)), normal, depth, axes)
