"""Static rotations in scenes: their forms, faults, and what they leave in front of the lens."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import numpy as np
import pytest

from clsco.frame.provenance import units
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene, Sphere
from clsco.scene.rotations import AxisAngle, UnitQuaternion, rotation_rows
from tests.scenes import refusals

BEHIND = "must leave part of the object in front of the lens (z > 0)"
TURN_Y = "rotation = [0, 90, 0]"


def one(keys: str) -> Scene:
    return parse_scene(tomllib.loads(f"object = [{{{keys}}}]"))


def faults(keys: str) -> tuple[str, ...]:
    return tuple(message.removeprefix("scene: ") for message in refusals(one, keys))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[10, 20.5, -30]", (10.0, 20.5, -30.0)),
        ("{axis = [0, 0, 2], angle = 45}", AxisAngle(axis=(0.0, 0.0, 2.0), angle=45.0)),
        ("{quaternion = [2, 0, 0, 1]}", UnitQuaternion(quaternion=(2.0, 0.0, 0.0, 1.0))),
    ],
)
def test_forms(text: str, expected: Any) -> None:
    scene = one(f'shape = "cone", rotation = {text}')
    assert scene.objects[0].rotation == expected
    assert parse_scene(json.loads(json.dumps(dump(scene)))) == scene
    assert scene.replace("object.0.rotation", scene.objects[0].rotation) == scene
    assert Sphere(rotation=expected).rotation == expected


def test_faults_of_a_rotation_come_with_the_others() -> None:
    assert faults('shape = "cone", rotation = {axis = [1, 0], angle = nan}, half_angle = 90') == (
        "object[0].rotation.axis: must be a list of 3 numbers; got [1, 0]",
        "object[0].rotation.angle: must be a finite number; got nan",
        "object[0].half_angle: must be between 0 and 90 deg, ends excluded; got 90",
    )


@pytest.mark.parametrize(
    ("keys", "place"),
    [
        (f'shape = "ellipsoid", semi_axes = [10, 9, 50], center = [0, 0, {{}}], {TURN_Y}', (-9.99, -10.0)),
        ('shape = "ellipsoid", semi_axes = [10, 9, 50], center = [0, 0, {}], rotation = [90, 0, 0]', (-8.99, -9.0)),
        ('shape = "ellipsoid", semi_axes = [3, 1, 4], center = [0, 0, {}], rotation = [0, 45, 0]', (-3.53, -3.54)),
        ('shape = "ellipsoid", center = [0, 0, {}]', (-49.0, -50.0)),
        ('shape = "sphere", center = [0, 0, {}]', (-29.0, -30.0)),
        ('shape = "rectangle", size = [8, 6], center = [0, 0, {}], rotation = [0, 30, 0]', (-1.99, -2.0)),
        ('shape = "rectangle", size = [8, 6], center = [0, 0, {}]', (0.01, 0.0)),
        ('shape = "disc", radius = 4, center = [0, 0, {}], rotation = [0, 30, 0]', (-1.99, -2.0)),
        ('shape = "disc", radius = 4, center = [0, 0, {}], rotation = [180, 0, 0], offset = -9', (-8.99, -9.0)),
        ('shape = "cylinder", radius = 5, center = [0, 0, {}]', (-4.99, -5.0)),
        ('shape = "cylinder", radius = 5, center = [0, 0, {}], rotation = [0, 0, 33]', (-4.99, -5.0)),
        (
            'shape = "cylinder", radius = 5, axis = [0, 0, 1], center = [0, 0, {}], rotation = [37, 90, 0]',
            (-4.99, -5.0),
        ),
        (f'shape = "cone", nappe = "towards", apex = [0, 0, {{}}], {TURN_Y}, half_angle = 1', (-1e5, None)),
        ('shape = "cylinder", center = [0, 0, {}], axis = [0, 1, 1e-3]', (-1000.0, None)),
        ('shape = "cone", apex = [0, 0, {}]', (-1000.0, None)),
        ('shape = "cone", apex = [0, 0, {}], nappe = "towards"', (1.0, 0.0)),
        ('shape = "cone", apex = [0, 0, {}], rotation = [0, 180, 0]', (0.01, 0.0)),
        ('shape = "cone", apex = [0, 0, {}], rotation = [130, 0, 0], half_angle = 39.9', (0.01, 0.0)),
        ('shape = "cone", apex = [0, 0, {}], rotation = [130, 0, 0], half_angle = 40.1', (-1e5, None)),
    ],
)
def test_what_is_left_in_front_of_the_lens(keys: str, place: tuple[float, float | None]) -> None:
    seen, behind = place
    one(keys.format(seen))
    if behind is not None:
        (message,) = faults(keys.format(behind))
        assert BEHIND in message


def test_rotated_bounds_in_front_of_the_lens() -> None:
    keys = 'shape = "plane", distance = 9, bounds = [[10, 20], [-1, 1], [-90, -80]], rotation = [0, {}, 0]'
    one(keys.format(-90))
    (message,) = faults(keys.format(90))
    assert message == f"object[0].bounds: {BEHIND}; got [[10.0, 20.0], [-1.0, 1.0], [-90.0, -80.0]]"


def test_units_are_those_of_the_form() -> None:
    def found(text: str) -> dict[str, str]:
        known = units(one(f'shape = "cone", rotation = {text}'))
        return {key: unit for key, unit in known.items() if "rotation" in key and key.startswith("object")}

    assert found("[1, 2, 3]") == {"object[0].rotation": "deg"}
    assert found("{axis = [0, 1, 0], angle = 3}") == {"object[0].rotation.angle": "deg"}
    assert found("{quaternion = [0, 1, 0, 3]}") == {}


def test_quarter_turns_are_exact() -> None:
    for angles in ((90, 0, 0), (0, 180, 0), (0, 0, -90), (-270, 450, 180), (90.0, 90.0, 90.0)):
        x, y, z = map(float, angles)
        rows = np.array(rotation_rows((x, y, z)))
        assert set(np.abs(rows).ravel()) == {0.0, 1.0}
    about_y = AxisAngle(axis=(0.0, 5.0, 0.0), angle=-90.0)
    assert rotation_rows(about_y) == rotation_rows((0.0, -90.0, 0.0))
