"""Rotated objects from scene to frame: the device against the reference, and against the same scene in other words."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest

import clsco
from clsco.scene.model import Scene
from tests.pipeline.common import CAMERA, PLAIN
from tests.scenes import assert_agree, assert_same, plan_of, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

ANY = [35.0, -50.0, 110.0]
GOING = {"velocity": [6.0, -4.0, 12.0], "angular_velocity": [5.0, 20.0, -10.0]}
WALL = {"shape": "plane", "distance": 380.0, "texture": "checkerboard", "rotation": [0.0, 0.0, 30.0]}
EGG = {"shape": "ellipsoid", "center": [-6.0, 2.0, 260.0], "semi_axes": [24.0, 9.0, 14.0], "rotation": ANY}
HALF_EGG = EGG | {"bounds": [[-30.0, 30.0], [-20.0, 4.0], [-20.0, 9.0]]}
CARD = {"shape": "plane", "distance": 240.0, "bounds": [[-22.0, 18.0], [-9.0, 14.0], [-1.0, 1.0]]}
CARD |= {"rotation": {"axis": [1.0, 2.0, -0.5], "angle": 40.0}, "texture": "siemens_star"}
HAT = {"shape": "cone", "apex": [3.0, 12.0, 240.0], "half_angle": 25.0, "rotation": [-70.0, 20.0, 10.0]}
HAT |= {"bounds": [[-30.0, 30.0], [-30.0, 30.0], [0.0, 30.0]]}
SHEET = {"shape": "rectangle", "center": [-4.0, 3.0, 255.0], "size": [26.0, 18.0], "rotation": [40.0, 30.0, 20.0]}
COIN = {"shape": "disc", "center": [-4.0, 3.0, 235.0], "radius": 12.0, "rotation": [40.0, 30.0, 20.0]}
CRATE = {"shape": "box", "center": [2.0, -3.0, 262.0], "size": [24.0, 18.0, 20.0], "rotation": [25.0, 35.0, 10.0]}
scene = partial(scene_from, {"camera": CAMERA})
SCENES: dict[str, Scene] = {
    "card": scene(CARD),
    "hat": scene(HAT, WALL, psf={"silhouette_samples": 2}),
    "half egg behind a card": scene(CARD, HALF_EGG, WALL, psf={"silhouette_samples": 2}),
    "moving": scene(HALF_EGG | {"motion": GOING}, psf=PLAIN, sequence={"samples": 2}),
    "forward": scene(HALF_EGG | {"motion": GOING}, psf=PLAIN, sequence={"samples": 2}, motion={"warp": "forward"}),
    "disc, mapped": scene(COIN | {"texture_mapping": "surface", "texture": "siemens_star"}, WALL, psf=PLAIN),
    "disc, moving": scene(COIN | {"motion": GOING}, WALL, psf=PLAIN, sequence={"samples": 2}),
    "box": scene(CRATE, WALL, psf={"silhouette_samples": 2}),
    "stereo": scene(CARD, EGG, psf=PLAIN, stereo={"baseline": 20.0, "toe_in": 1.0}),
}
SOME = ("disc, moving", "moving")


@pytest.mark.parametrize("name", mostly_slow(SCENES, SOME))
def test_device_against_reference(name: str) -> None:
    assert_agree(rendered(SCENES[name], precision="double"), reference_frames(SCENES[name]))


def test_a_rectangle_has_the_bits_of_a_card() -> None:
    """A plane on the optical axis, cut as the rectangle is."""
    given = {"rotation": ANY, "motion": GOING, "texture": "siemens_star"}
    card = {"shape": "plane", "distance": 255.0, "bounds": [[-13.0, 13.0], [-9.0, 9.0], [-13.0, 13.0]], **given}
    sheet = SHEET | {"center": [0.0, 0.0, 255.0], **given}
    options: dict[str, Any] = {"psf": PLAIN, "sequence": {"samples": 2}}
    (found,), (expected,) = rendered(scene(sheet, WALL, **options)), rendered(scene(card, WALL, **options))
    assert_same(found, expected)


def test_a_card_upside_down_shows_the_same_texture() -> None:
    """The texture is the image of the rotated object: half a turn of a symmetric card about z changes nothing."""
    motion = {"velocity": [6.0, -4.0, 12.0], "angular_velocity": [0.0, 20.0, 0.0]}
    card = CARD | {"bounds": [[-20.0, 20.0], [-9.0, 9.0], [-1.0, 1.0]], "motion": motion}
    options: dict[str, Any] = {"psf": PLAIN, "sequence": {"samples": 2}}
    plain = rendered(scene({k: v for k, v in card.items() if k != "rotation"}, WALL, **options))
    for angle in (0.0, 180.0):
        assert_agree(rendered(scene(card | {"rotation": [0.0, 0.0, angle]}, WALL, **options)), plain)


def test_a_moving_rotated_body_is_the_body_in_other_words() -> None:
    """A cylinder along x and one turned there, moving and cut: texture, flow and normals are the same."""
    motion = {"velocity": [3.0, -2.0, 5.0], "angular_velocity": [10.0, 20.0, 30.0]}
    tube = {"shape": "cylinder", "center": [4.0, 0.0, 260.0], "radius": 12.0, "motion": motion}
    box = [[-14.0, 14.0], [-18.0, 10.0], [-20.0, 20.0]]
    turned = tube | {"rotation": [0.0, 0.0, 90.0], "bounds": box}
    lying = tube | {"axis": [1.0, 0.0, 0.0], "bounds": [[-18.0, 10.0], [-14.0, 14.0], box[2]]}
    options: dict[str, Any] = {"psf": PLAIN, "sequence": {"samples": 2, "frames": 2}}
    assert_agree(rendered(scene(turned, **options)), rendered(scene(lying, **options)))


def test_constant_blur_is_seen_where_it_is() -> None:
    """A plane turned about z alone has one radius; about x or y it has not, and turned by its slope it has again."""

    def blur(**keys: Any) -> str:
        plane = clsco.Plane(distance=280.0, **keys)
        return plan_of(plane).blur

    assert blur(rotation=(0.0, 0.0, 30.0)) == blur(rotation=(0.0, 180.0, 0.0)) == blur() == "convolve"
    assert blur(rotation=(0.0, 1.0, 0.0)) == blur(rotation=(1.0, 0.0, 0.0)) == blur(slope_x=0.1) == "gather"
