"""Groups of objects in scene files: keys, faults, the way back, sweeps and changes."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import pytest

from clsco.errors import SceneError
from clsco.frame.provenance import record, scene_sha256, units
from clsco.plan.notes import unused_keys
from clsco.plan.prepare import prepare
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from clsco.scene.groups import group_origin
from clsco.scene.model import Group, ObjectMotion, Scene
from clsco.scene.sweep import parse_sweep
from tests.scenes import refusals

CART = """
camera.resolution = [32, 24]
camera.pixel_pitch = 0.2
[[group]]
name = "cart"
motion.velocity = [5, 0, 0]
[[object]]
shape = "plane"
[[object]]
shape = "sphere"
group = "cart"
[[object]]
shape = "cone"
group = "cart"
motion.angular_velocity = [0, 90, 0]
"""


def cart(**group: Any) -> dict[str, Any]:
    data = tomllib.loads(CART)
    data["group"][0] |= group
    return data


def faults(data: Any) -> tuple[str, ...]:
    return tuple(message.removeprefix("scene: ") for message in refusals(parse_scene, data))


def test_a_file_with_a_group() -> None:
    scene = parse_scene(cart())
    assert scene.groups == (Group(name="cart", motion=ObjectMotion(velocity=(5.0, 0.0, 0.0))),)
    assert [item.group for item in scene.objects] == [None, "cart", "cart"]
    assert group_origin(scene.groups[0], scene.objects) == (0.0, 0.0, 280.0)
    assert scene.moves


def test_dump_is_the_way_back() -> None:
    scene = parse_scene(cart(origin=[1, 2, 300]))
    data = json.loads(json.dumps(dump(scene)))
    assert data["group"][0]["origin"] == [1.0, 2.0, 300.0]
    assert parse_scene(data) == scene
    assert Scene.model_validate({"objects": scene.objects, "groups": scene.groups, "camera": scene.camera}) == scene


def test_unknown_groups_are_reported_with_the_other_faults() -> None:
    data = cart()
    data["object"][0]["group"] = "card"
    assert faults(data) == ('object[0].group: must be the name of a group, "cart"; got "card"',)
    data["object"][1]["radius"] = -1
    assert faults(data) == (
        "object[1].radius: must be greater than 0 mm; got -1",
        'object[0].group: must be the name of a group, "cart"; got "card"',
    )
    del data["group"]
    assert faults(data)[1:] == tuple(
        f'object[{k}].group: must be the name of a group; there is none; got "{name}"'
        for k, name in enumerate(("card", "cart", "cart"))
    )
    assert faults({"object": [{"shape": "plane", "group": 3}]}) == ("object[0].group: must be text; got 3",)
    assert faults({"object": [{"shape": "plane", "group": ""}]}) == ('object[0].group: must not be empty; got ""',)


def test_replace_reaches_groups() -> None:
    scene = parse_scene(cart())
    for path in ("group.0.motion.velocity", "groups[0].motion.velocity"):
        assert scene.replace(path, [0.0, 1.0, 0.0]).groups[0].motion.velocity == (0.0, 1.0, 0.0)
    assert scene.replace("group.0.origin", (0.0, 0.0, 9.0)).groups[0].origin == (0.0, 0.0, 9.0)
    assert scene.replace("object.1.group", None).objects[1].group is None
    with pytest.raises(SceneError, match=r'object\[1\].group: must be the name of a group, "cart"; got "x"'):
        scene.replace("object.1.group", "x")


def test_sweeps_reach_the_motion_of_groups() -> None:
    sweep = parse_sweep(cart(motion={"velocity": [[1, 0, 0], [2, 0, 0]], "angular_velocity": [0, 5, 0]}))
    assert sweep.labels == ("group_0_velocity_1_0_0", "group_0_velocity_2_0_0")
    assert [scene.groups[0].motion.velocity[0] for scene in sweep.scenes] == [1.0, 2.0]
    ranged = cart(motion={"velocity": {"from": [0, 0, 0], "to": [4, 0, 0], "steps": 3}})
    assert [scene.groups[0].motion.velocity[0] for scene in parse_sweep(ranged).scenes] == [0.0, 2.0, 4.0]
    with pytest.raises(SceneError, match=r"group\[0\].motion.velocity\[1\]: must be a list of 3 numbers; got \[2, 0\]"):
        parse_sweep(cart(motion={"velocity": [[1, 0, 0], [2, 0]]}))


def test_provenance_has_groups() -> None:
    scene = parse_scene(cart(origin=[1, 2, 300]))
    assert record(scene)["scene"]["group"][0]["name"] == "cart"
    found = units(scene)
    assert (found["group[0].origin"], found["group[0].motion.angular_velocity"]) == ("mm", "deg/s")
    assert scene_sha256(scene.replace("group.0.origin", [1.0, 2.0, 301.0])) != scene_sha256(scene)


def test_a_group_without_objects_is_reported() -> None:
    lonely = {**cart(), "group": [*cart()["group"], {"name": "ship", "motion": {"velocity": [1, 0, 0]}}]}
    found = dict(unused_keys(prepare(parse_scene(lonely)).plan))
    assert found == {"group[1].motion": "no object is in it", "group[1].name": "no object is in it"}
