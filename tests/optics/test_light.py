"""Lights before cameras that move: in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np

from clsco.optics.light import PlacedLight, place_light
from clsco.optics.motion import Eye
from clsco.scene.model import Background, Camera, CameraMotion, Light, Scene, Sphere, Stereo

TURNING = Camera(motion=CameraMotion(velocity=(3.0, 0.0, 2.0), angular_velocity=(0.0, 90.0, 0.0)))


def placed(light: Light, time: float = 7.0, eye: Eye = "left", **sections: Any) -> PlacedLight:
    found = place_light(Scene(objects=(Sphere(), Background()), light=light, **sections), time, eye)
    assert found is not None
    return found


def test_before_a_camera_at_rest() -> None:
    assert place_light(Scene(objects=(Sphere(),)), 0.0) is None
    far = placed(Light(direction=(0.0, 3.0, 4.0)))
    np.testing.assert_allclose(far.place, [0.0, 0.6, -0.8])
    assert (far.is_near, far.ambient, far.members) == (False, 0.0, 0b01)
    near = placed(Light(position=(1.0, 2.0, 3.0), ambient=0.5))
    assert (near.place.tolist(), near.is_near, near.ambient, near.members) == ([1.0, 2.0, 3.0], True, 0.5, 1)


def test_it_stands_still_where_the_camera_does_not() -> None:
    """A turn about the upward axis brings the right side nearer: of a camera, that it looks to the right."""
    for light, place in (
        (Light(direction=(0.0, 0.0, 1.0)), [1.0, 0.0, 0.0]),
        (Light(direction=(0.0, 1.0, 0.0)), [0.0, 1.0, 0.0]),
        (Light(position=(3.0, 0.0, 102.0)), [-100.0, 0.0, 0.0]),
    ):
        np.testing.assert_allclose(placed(light, 1.0, camera=TURNING).place, place, rtol=0, atol=5e-10)


def test_each_of_two_eyes_has_its_own_place_for_it() -> None:
    light, pair = Light(position=(1.0, 2.0, 3.0)), Stereo(baseline=6.0)
    left, right = placed(light, 0.0, "left", stereo=pair), placed(light, 0.0, "right", stereo=pair)
    assert (left.place - right.place).tolist() == [6.0, 0.0, 0.0]
