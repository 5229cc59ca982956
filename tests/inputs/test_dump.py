"""Scenes to text and files and back: equal scenes, for every shape, section and example; arrays beside the file."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import FileError, SceneError
from clsco.inputs.dump import dump_scene
from clsco.scene.arrays import ArrayInput
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from clsco.scene.sweep import load_sweep
from tests.scenes import EXAMPLES, refusals

BOUNDS = [[-1e9, 1.5], [-0.1, 2], [-3, 1e-7]]
ITEMS: list[dict[str, Any]] = [
    {"shape": "plane", "slope_x": 0.1 + 0.2, "distance": 1e9, "bounds": BOUNDS},
    {"shape": "cylinder", "axis": [0.3, 1, 0]},
    {"shape": "sphere", "name": 'a "ball" \\ \u00e9 \U0001f600 .'},
    {"shape": "sphere", "texture": "." * 200 + "/wall.png"},
    {"shape": "cone", "nappe": "towards", "motion": {"velocity": [1, 0, 0]}},
    {"shape": "ellipsoid", "semi_axes": [1, 2, 1e-6], "motion": {}},
    {"shape": "quadric", "coefficients": [1e30, -1e-30, *[0.0] * 7, 1e22]},
    {"shape": "depth_map", "depth": "z.npy", "unit": "disparity", "baseline": 9.0, "offset": 0},
    {"shape": "background", "texture": "#c86432"},
    {"shape": "rectangle", "rotation": [30.0, 0.0, 90.0], "group": "cart"},
    {"shape": "disc", "radius": 9.0, "offset": -3.0},
    {"shape": "cone", "rotation": {"axis": [0.0, 1.0, 0.0], "angle": 30.0}},
    {"shape": "sphere", "rotation": {"quaternion": [0.966, 0.0, 0.259, 0.0]}, "group": "cart"},
    {"shape": "box", "size": [10.0, 20.0, 30.0], "group": "cart"},
]
SECTIONS: list[dict[str, Any]] = [
    {},
    {"title": "Two words = 'one'; # no comment [table]", "psf": {"model": "gaussian", "tilt": False}},
    {"camera": {"f_number": 2, "focus_distance": 300, "resolution": [64, 48], "motion": {"velocity": [0, 0, 1]}}},
    {"camera": {}, "aperture": {"shape": "polygon", "blades": 5}, "image": {"transfer": "linear"}},
    {"motion": {"warp": "forward"}, "fill": {"method": "none"}, "sequence": {"samples": "auto", "frames": 3}},
    {"stereo": {"baseline": 65, "toe_in": 1.5}, "sequence": {"samples": 9}, "psf": {"occlusion": "layered"}},
]


@pytest.mark.parametrize("sections", SECTIONS)
def test_every_shape_and_section(sections: dict[str, Any]) -> None:
    cart = {"name": "cart", "motion": {"velocity": [1.0, 0.0, 0.0]}}
    scene = parse_scene({**sections, "object": ITEMS, "group": [cart]})
    text = dump_scene(scene)
    again = parse_scene(text)
    assert again == scene
    named = [["name" in item.model_fields_set for item in each.objects] for each in (again, scene)]
    assert named[0] == named[1]
    assert dump_scene(again) == text


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples(path: Path, tmp_path: Path) -> None:
    for scene in load_sweep(path).scenes:
        assert scene.title
        assert parse_scene(dump(scene)) == scene
        text = dump_scene(scene, tmp_path / "scene.toml")
        assert text == dump_scene(scene) == (tmp_path / "scene.toml").read_text("utf-8")
        assert parse_scene(text) == clsco.load_scene(tmp_path / "scene.toml") == scene


def test_a_text_holds_what_was_given() -> None:
    scene = clsco.Scene(camera=clsco.Camera(f_number=4.0), objects=(clsco.Sphere(center=(0, 0, 300)), clsco.Plane()))
    assert dump_scene(scene) == (
        '[camera]\nf_number = 4.0\n\n[[object]]\nshape = "sphere"\ncenter = [0.0, 0.0, 300.0]\n\n'
        '[[object]]\nshape = "plane"\n'
    )
    assert tomllib.loads(dump_scene(scene))["camera"] == {"f_number": 4.0}


DEPTH = np.full((6, 8), 250.0)
ARRAYS = clsco.Scene(objects=(clsco.Plane(texture=np.ones((6, 8), np.uint8)), clsco.DepthMap(depth=DEPTH)))


def test_arrays_need_a_file() -> None:
    rule = "must be a name or a path to be written as text; give dump_scene a path for arrays"
    for message, key in zip(refusals(dump_scene, ARRAYS), ("0].texture", "1].depth"), strict=True):
        assert message.startswith(f"scene: object[{key}: {rule}; got array of ")


def test_arrays_lie_beside_the_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    assert 'texture = "scene_object_0_texture.npy"' in dump_scene(ARRAYS, path)
    assert {file.name for file in tmp_path.iterdir()} == {
        path.name,
        *(f"scene_object_{n}.npy" for n in ("0_texture", "1_depth")),
    }
    loaded = clsco.load_scene(path)
    for item, read in zip(ARRAYS.objects, loaded.objects, strict=True):
        for key, array in item.arrays().items():
            again = ArrayInput(np.load(read.files()[key]), array.kind)
            assert again == array
    np.testing.assert_array_equal(clsco.render_frame(loaded).color, clsco.render_frame(ARRAYS).color)


def test_relative_paths_become_absolute_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    scene = clsco.Scene(objects=(clsco.Plane(texture="wall.png"),))
    dump_scene(scene, "other/scene.toml")
    assert clsco.load_scene("other/scene.toml").objects[0].texture == str(tmp_path / "wall.png")
    assert parse_scene(dump_scene(scene)) == scene


def test_all_files_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SceneError, match=r"scene.json: a scene is written to a file that ends in .toml; got '.json'"):
        dump_scene(ARRAYS, tmp_path / "scene.json")
    with pytest.raises(FileError, match=r"none/scene.toml: the files must be writable"):
        dump_scene(ARRAYS, tmp_path / "none" / "scene.toml")

    def fails(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(FileError, match=r"scene_object_0_texture.npy: the file must be writable; got No space left"):
        dump_scene(ARRAYS, tmp_path / "scene.toml")
    assert list(tmp_path.iterdir()) == []
