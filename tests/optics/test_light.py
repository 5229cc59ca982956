"""Lights before cameras that move: in closed form."""

from __future__ import annotations

import numpy as np

from clsco.optics.light import place_light
from clsco.scene.model import Background, Camera, CameraMotion, Light, Motion, Scene, Sphere, Stereo

TURNING = Camera(motion=CameraMotion(velocity=(3.0, 0.0, 2.0), angular_velocity=(0.0, 90.0, 0.0)))


def test_before_a_camera_at_rest() -> None:
    assert place_light(Scene(objects=(Sphere(),)), 0.0) is None
    far = place_light(Scene(objects=(Sphere(), Background()), light=Light(direction=(0.0, 3.0, 4.0))), 7.0)
    assert far is not None
    np.testing.assert_allclose(far.place, [0.0, 0.6, -0.8])
    assert (far.is_near, far.ambient, far.members) == (False, 0.0, 0b01)
    near = place_light(Scene(objects=(Sphere(),), light=Light(position=(1.0, 2.0, 3.0), ambient=0.5)), 7.0)
    assert near is not None
    assert (near.place.tolist(), near.is_near, near.ambient, near.members) == ([1.0, 2.0, 3.0], True, 0.5, 1)


def test_it_stands_still_where_the_camera_does_not() -> None:
    def placed(light: Light, time: float) -> list[float]:
        found = place_light(Scene(objects=(Sphere(),), camera=TURNING, light=light, motion=Motion()), time)
        assert found is not None
        return [round(x, 9) for x in found.place.tolist()]

    # A turn about the upward axis brings the right side nearer: of a camera, that it looks to the right.
    assert placed(Light(direction=(0.0, 0.0, 1.0)), 1.0) == [1.0, 0.0, 0.0]
    assert placed(Light(direction=(0.0, 1.0, 0.0)), 1.0) == [0.0, 1.0, 0.0]
    assert placed(Light(position=(3.0, 0.0, 102.0)), 1.0) == [-100.0, 0.0, 0.0]


def test_each_of_two_eyes_has_its_own_place_for_it() -> None:
    scene = Scene(objects=(Sphere(),), stereo=Stereo(baseline=6.0), light=Light(position=(1.0, 2.0, 3.0)))
    left, right = (place_light(scene, 0.0, eye) for eye in ("left", "right"))
    assert left is not None
    assert right is not None
    assert (left.place - right.place).tolist() == [6.0, 0.0, 0.0]
