"""The light of a scene as its camera sees it (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.optics.motion import TOWARDS_CAMERA, Eye, eye_pose
from clsco.scene.model import Scene


@dataclass(frozen=True)
class PlacedLight:
    """A light in the frame of the camera at one time.

    Attributes
    ----------
    place : ndarray of float64, (3,)
        The unit vector towards it, or where it is, in mm.
    is_near : bool
        The light is at a place, and not far away.
    ambient : float
        Share of a texture that is seen without it.
    members : int
        A bit for each object on which it falls: all but the background.
    """

    place: NDArray[np.float64]
    is_near: bool
    ambient: float
    members: int


def place_light(scene: Scene, time: float, eye: Eye = "left") -> PlacedLight | None:
    """The light of a scene, if it has one, before a camera that moves while the light stands still.

    Parameters
    ----------
    scene : Scene
    time : float
        Seconds since the reference pose.
    eye : {"left", "right"}

    Returns
    -------
    PlacedLight, optional
    """
    light = scene.light
    if light is None:
        return None
    camera = eye_pose(scene, eye, time)
    if light.position is not None:
        place = camera.rotation.T @ (np.asarray(light.position) - camera.shift)
    else:
        towards = TOWARDS_CAMERA @ np.asarray(light.direction)
        place = camera.rotation.T @ (towards / np.linalg.norm(towards))
    members = sum(1 << k for k, item in enumerate(scene.objects) if not item.is_background)
    return PlacedLight(place, light.position is not None, light.ambient, members)
