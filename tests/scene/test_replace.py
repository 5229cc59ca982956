"""Scene.replace: validated, without what contradicts the new value, and a dump that parses again."""

from __future__ import annotations

import numpy as np
import pytest

import clsco
from clsco.scene.changes import dump
from clsco.scene.examples import EXAMPLES, example
from clsco.scene.file import parse_scene

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


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("camera.f_numbr", 4.0, "unknown key \\(did you mean f_number"),
        ("camera.f_number", -4.0, "camera.f_number: must be .*; got -4"),
        ("object.7.radius", 4.0, "object has 2 entries, counted from 0; got 7"),
        ("title.deep", 4.0, "must be a table"),
        ("camera.f_number", object(), "camera.f_number: must be a number"),
    ],
)
def test_what_cannot_be_is_refused(path: str, value: object, message: str) -> None:
    with pytest.raises(clsco.SceneError, match=message):
        SCENE.replace(path, value)


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_a_dump_parses_again(name: str) -> None:
    scene = example(name)
    assert parse_scene(dump(scene)) == scene
    assert scene.replace("title", scene.title) == scene
