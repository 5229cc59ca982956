"""The light of a scene in the frame of its camera (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.optics.motion import TOWARDS_CAMERA, Eye, eye_pose
from clsco.scene.model import Scene


@dataclass(frozen=True)
class PlacedLight:
    """A light in the frame of the camera at one time.

    place: unit vector (3,) towards the light, or its position in mm if `is_near`. ambient: fraction of a texture's
    radiance that is visible without the light. members: bit mask of the objects that it lights: all but the background.
    """

    place: NDArray[np.float64]
    is_near: bool
    ambient: float
    members: int


def place_light(scene: Scene, time: float, eye: Eye = "left") -> PlacedLight | None:
    """The light of a scene, if any, in the frame of a camera that moves while the light stands still; time in s."""
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
