"""The light of a scene file: where it may be, its way back, and scenes whose surfaces cannot be shaded."""

from __future__ import annotations

from typing import Any

import pytest

import clsco
from clsco.scene.file import parse_scene
from clsco.scene.sweep import parse_sweep
from tests.scenes import refusals

BALL: dict[str, Any] = {"shape": "sphere", "motion": {"velocity": [1.0, 0.0, 0.0]}}
FAR = {"direction": [0.3, 0.8, 1.0], "ambient": 0.2}
REFUSED = 'light: belongs to scenes of analytic surfaces with motion.warp = "inverse"; got a light'


def test_one_place_takes_that_of_the_other() -> None:
    scene = parse_scene({"object": [BALL], "light": FAR})
    near = scene.replace("light.position", [1, 2, 3])
    assert near.light == clsco.Light(position=(1.0, 2.0, 3.0), ambient=0.2)
    assert near.replace("light.direction", FAR["direction"]) == scene
    assert near.replace("light.position[1]", 7).light == clsco.Light(position=(1.0, 7.0, 3.0), ambient=0.2)
    assert scene.replace("light", None) == parse_scene({"object": [BALL]})


def test_lights_are_swept() -> None:
    sweep = parse_sweep({"object": [BALL], "light": FAR | {"direction": [[0, 0, 1], [1, 0, 0]], "ambient": [0, 1]}})
    lights = [scene.light for scene in sweep.scenes]
    assert lights == [clsco.Light(direction=d, ambient=a) for d in ((0, 0, 1), (1, 0, 0)) for a in (0, 1)]


@pytest.mark.parametrize(
    "sections",
    [
        {"motion": {"warp": "forward"}},
        {"object": [{"shape": "depth_map", "depth": "z.npy"}]},
        {"motion": {"warp": "forward"}, "object": [{"shape": "sphere"}], "stereo": {"baseline": 6.0}},
    ],
)
def test_what_has_no_rays_has_no_light(sections: dict[str, Any]) -> None:
    assert refusals(parse_scene, {"object": [BALL], "light": FAR, **sections}) == (f"scene: {REFUSED}",)
    still = parse_scene({"object": [{"shape": "sphere"}], "light": FAR, "motion": {"warp": "forward"}})
    assert still.light is not None
