"""Scene.replace: validated, without what contradicts the new value, and a dump that parses again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from tests.scenes import refusals

DEEP: Any = 4.0
for _ in range(3000):
    DEEP = [DEEP]
SCENE = clsco.Scene(objects=(clsco.Sphere(center=(0, 0, 280), radius=30), clsco.Plane()))


def test_an_f_number_replaces_the_aperture() -> None:
    wide = SCENE.replace("camera.aperture_diameter", 40.0)
    stopped = wide.replace("camera.f_number", np.float64(8.0))
    assert (wide.camera.aperture_diameter, wide.camera.f_number) == (40.0, None)
    assert stopped.camera.f_number == 8.0
    assert stopped.camera.aperture_diameter == stopped.camera.focal_length / 8.0
    assert stopped.replace("camera.aperture_diameter", 40.0) == wide


@pytest.mark.parametrize("path", ["object.0.radius", "object[0].radius", "objects.0.radius"])
def test_a_key_of_an_object(path: str) -> None:
    assert SCENE.replace(path, 20.0).objects[0] == clsco.Sphere(center=(0, 0, 280), radius=20.0)


def test_objects_as_values() -> None:
    assert SCENE.replace("object", (clsco.Plane(distance=300.0),)).objects == (clsco.Plane(distance=300.0),)
    assert SCENE.replace("psf", clsco.Psf(model="gaussian")).psf.model == "gaussian"
    assert SCENE.replace("camera.resolution", np.array([64, 48])).camera.resolution == (64, 48)
    camera = clsco.Camera(f_number=2.0, focus_distance=300.0)
    assert SCENE.replace("camera", camera).camera == camera
    assert SCENE.replace("camera", {"f_number": 2, "focus_distance": 300}).camera == camera


def test_defaults_follow_the_new_value() -> None:
    assert SCENE.replace("camera.focal_length", 40).camera == clsco.Camera(focal_length=40.0)
    assert SCENE.replace("sequence.interval", 0.04).sequence.shutter == 0.04
    assert SCENE.replace("psf.model", "gaussian").replace("psf.edge", "sampled").psf.truncation == 2.0
    own = SCENE.replace("camera.normalization_distance", 25.0)
    assert own.replace("camera.focal_length", 40).camera.normalization_distance == 25.0
    spheres = clsco.Scene(objects=(clsco.Sphere(), clsco.Sphere(), clsco.Plane()))
    named = spheres.replace("object[1].name", "sphere")
    assert [item.name for item in named.objects] == ["sphere 2", "sphere", "plane"]


@pytest.mark.parametrize("key", ["object[0].center[2]", "object.0.center.2"])
def test_a_component_of_a_default(key: str) -> None:
    plain = clsco.Scene(objects=(clsco.Sphere(),))
    (ball,) = plain.replace(key, 300).objects
    assert ball == clsco.Sphere(center=(0.0, 0.0, 300.0))
    assert plain.replace("camera.motion.velocity[0]", 5).camera.motion.velocity == (5.0, 0.0, 0.0)
    bounded = plain.replace("object[0].bounds", [[-1, 1], [-2, 2], [-3, 3]])
    assert bounded.replace("object[0].bounds[1][0]", -4).objects[0].bounds == ((-1.0, 1.0), (-4.0, 2.0), (-3.0, 3.0))


def paths(table: Any, place: str = "") -> list[tuple[str, Any]]:
    """Every key with its value, in the form of sweeps and overrides."""
    if not isinstance(table, dict):
        return [(place, table)]
    found = []
    for key, value in table.items():
        if key == "object":
            found += [each for k, item in enumerate(value) for each in paths(item, f"object[{k}]")]
        else:
            found += paths(value, f"{place}.{key}" if place else key)
    return found


SHAPES: dict[str, dict[str, Any]] = {
    "all": {"stereo": {"baseline": 60.0}, "psf": {"model": "gaussian"}, "aperture": {"shape": "circle"}},
    "polygon": {"aperture": {"shape": "polygon"}, "motion": {"warp": "forward"}, "camera": {"f_number": 2.0}},
}
ITEMS: list[dict[str, Any]] = [
    {"shape": "plane", "bounds": [[-1.0, 1.0], [-2.0, 2.0], [-3.0, 3.0]]},
    {"shape": "sphere"},
    {"shape": "cylinder"},
    {"shape": "cone"},
    {"shape": "ellipsoid"},
    {"shape": "quadric", "coefficients": [1.0] * 10},
    {"shape": "depth_map", "depth": "z.npy", "unit": "disparity", "baseline": 9.0, "offset": 0.0},
    {"shape": "background"},
]


@pytest.mark.parametrize("name", SHAPES)
def test_every_key_is_checked_as_in_a_file(name: str) -> None:
    scene = parse_scene({**SHAPES[name], "object": ITEMS})
    listed = paths(dump(scene))
    assert len(listed) > 80
    for key, value in listed:
        assert scene.replace(key, value) == scene, key
        if isinstance(value, float) and value.is_integer():  # an integer where a float is wanted
            assert scene.replace(key, int(value)) == scene, key
        messages = refusals(scene.replace, key, {"wrong": 1})
        assert all(message.replace('"', "").startswith(f"scene: {key}") for message in messages), key


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("camera.f_numbr", 4.0, "unknown key \\(did you mean f_number"),
        ("camera.f_number", -4.0, "camera.f_number: must be .*; got -4"),
        ("object.7.radius", 4.0, "object has 2 entries, counted from 0; got 7"),
        ("title.deep", 4.0, "must be a table"),
        ("camera.f_number", DEEP, "camera.f_number: nested too deeply; got a list of 1 entries"),
        ("camera.f_number", object(), "camera.f_number: must be a number"),
    ],
)
def test_what_cannot_be_is_refused(path: str, value: object, message: str) -> None:
    with pytest.raises(clsco.SceneError, match=message):
        SCENE.replace(path, value)
