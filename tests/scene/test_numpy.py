"""NumPy's numbers and arrays where a scene has numbers and lists: the same scenes, and the same messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.scene.file import parse_scene
from clsco.scene.sweep import parse_sweep
from tests.scenes import refusals

COEFFICIENTS = [1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -40.0, 0.0]
MIXED = {"center": (np.float32(0), 1, np.array(280.0)), "radius": np.longdouble(2.5)}
# Keys by their table, with a value in Python and the same in NumPy.
VALUES: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("camera", {"f_number": 4.0, "focal_length": 25}, {"f_number": np.float32(4), "focal_length": np.uint8(25)}),
    ("camera", {"resolution": [64, 48]}, {"resolution": np.array([64, 48])}),
    ("camera", {"motion": {"velocity": [1.0, 2.0, 3.0]}}, {"motion": {"velocity": np.array([1, 2, 3])}}),
    ("psf", {"tilt": False, "silhouette_samples": 2}, {"tilt": np.bool_(0), "silhouette_samples": np.int8(2)}),
    ("sequence", {"samples": 7, "frames": 3}, {"samples": np.int64(7), "frames": np.uint16(3)}),
    ("sphere", {"center": [0.0, 1.0, 280.0]}, {"center": np.array([0, 1, 280.0])}),
    ("sphere", {"center": [0.0, 1.0, 280.0], "radius": 2.5}, MIXED),
    ("sphere", {"bounds": [[-1, 1], [-2, 2], [-3, 3]]}, {"bounds": np.array([[-1, 1], [-2, 2], [-3, 3]])}),
    ("sphere", {"bounds": [[-1, 1], [-2, 2], [-3, 3]]}, {"bounds": [np.array([-k, k]) for k in (1, 2, 3)]}),
    ("cylinder", {"axis": [1.0, 1.0, 0.0]}, {"axis": np.array([1, 1, 0], np.float16)}),
    ("ellipsoid", {"semi_axes": [1.0, 2.0, 3.0]}, {"semi_axes": np.arange(1.0, 4.0)}),
    ("quadric", {"coefficients": COEFFICIENTS}, {"coefficients": np.array(COEFFICIENTS)}),
    ("plane", {"motion": {"angular_velocity": [0.0, 9.0, 0.0]}}, {"motion": {"angular_velocity": np.array([0, 9, 0])}}),
]  # fmt: skip


def mapping(table: str, keys: dict[str, Any]) -> dict[str, Any]:
    if table in ("camera", "psf", "sequence"):
        return {table: keys, "object": [{"shape": "plane"}]}
    return {"object": [{"shape": table, **keys}]}


@pytest.mark.parametrize(("table", "listed", "arrays"), VALUES)
def test_scenes_are_the_same(table: str, listed: dict[str, Any], arrays: dict[str, Any]) -> None:
    scene = parse_scene(mapping(table, arrays))
    assert scene == parse_scene(mapping(table, listed))
    assert parse_sweep(mapping(table, arrays)).scenes == (scene,)
    assert scene.model_dump_json() == parse_scene(mapping(table, listed)).model_dump_json()


def test_shapes_take_them() -> None:
    ball = clsco.Sphere(center=np.array([0, 0, 280.0]), radius=np.float32(30))  # type: ignore[arg-type]
    assert ball == clsco.Sphere(center=(0.0, 0.0, 280.0), radius=30.0)
    assert {type(value) for value in (*ball.center, ball.radius)} == {float}


WRONG: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("camera", {"f_number": -4.0}, {"f_number": np.float32(-4)}),
    ("camera", {"f_number": [4.0]}, {"f_number": np.array([4.0])}),
    ("camera", {"resolution": [64.0, 48]}, {"resolution": (np.float64(64), 48)}),
    ("psf", {"tilt": 1, "silhouette_samples": 2.0}, {"tilt": np.int8(1), "silhouette_samples": np.float32(2)}),
    ("sphere", {"center": [0.0, 1.0]}, {"center": np.array([0.0, 1.0])}),
    ("sphere", {"center": 3}, {"center": np.array(3)}),
    ("sphere", {"center": [[0, 1, 2]] * 3}, {"center": np.array([[0, 1, 2]] * 3)}),
    ("quadric", {"coefficients": [0.0] * 10}, {"coefficients": np.zeros(10)}),
    ("plane", {"distance": None}, {"distance": np.array(None)}),
]


@pytest.mark.parametrize(("table", "listed", "arrays"), WRONG)
def test_messages_are_the_same(table: str, listed: dict[str, Any], arrays: dict[str, Any]) -> None:
    assert refusals(parse_scene, mapping(table, listed)) == refusals(parse_scene, mapping(table, arrays))


def test_an_image_is_no_list() -> None:
    with pytest.raises(SceneError, match=r"center: must be a list of 3 numbers; got an array of float64 \(90, 90\)$"):
        parse_scene(mapping("sphere", {"center": np.zeros((90, 90))}))


def test_values_of_a_sweep() -> None:
    listed = {
        "camera": {"f_number": [2.0, 4.0], "motion": {"velocity": {"from": [0, 0, 1], "to": [0, 0, 2], "steps": 2}}}
    }
    ends = {"from": np.array([0, 0, 1]), "to": np.array([0, 0, 2]), "steps": np.int64(2)}
    arrays = {"camera": {"f_number": np.array([2.0, 4.0]), "motion": {"velocity": ends}}}
    item = {"object": [{"shape": "plane"}]}
    assert parse_sweep(arrays | item) == parse_sweep(listed | item)
    assert len(parse_sweep(arrays | item).scenes) == 4
