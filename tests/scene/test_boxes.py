"""Boxes: the rectangles that a scene has in place of them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.optics.motion import poses_at
from clsco.optics.quadrics import place
from clsco.reference.common.geometry import nearest_surface
from clsco.reference.trace.trace import everything
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from clsco.scene.model import Rectangle, Scene
from clsco.scene.rotations import after, rotation_rows
from tests.scenes import refusals

SIDES = ("front", "back", "left", "right", "top", "bottom")
ANY = (35.0, -50.0, 110.0)
MOTION = {"velocity": [3.0, -2.0, 9.0], "angular_velocity": [25.0, -40.0, 60.0]}


def box(*others: dict[str, Any], **keys: Any) -> Scene:
    return parse_scene({"object": [{"shape": "box", **keys}, *others]})


def faults(*objects: dict[str, Any]) -> tuple[str, ...]:
    return tuple(message.removeprefix("scene: ") for message in refusals(parse_scene, {"object": list(objects)}))


def test_a_box_is_six_rectangles() -> None:
    scene = box({"shape": "plane"}, texture="checkerboard", motion=MOTION)
    assert [item.name for item in scene.objects] == [*(f"box {side}" for side in SIDES), "plane"]
    for face in scene.objects[:-1]:
        assert isinstance(face, Rectangle)
        assert (face.texture, face.center) == ("checkerboard", (0.0, 0.0, 280.0))
        assert face.motion.velocity == (3.0, -2.0, 9.0)
    assert parse_scene(json.loads(json.dumps(dump(scene)))) == scene
    assert Scene(objects=scene.objects) == scene


def test_names_of_several_boxes() -> None:
    items = [{"shape": "box"}, {"shape": "box"}, {"shape": "box", "name": "crate"}]
    names = [item.name for item in parse_scene({"object": items}).objects]
    assert names == [f"{name} {side}" for name in ("box", "box 2", "crate") for side in SIDES]
    rule = "names of its faces must differ from those of other objects"
    other = {"shape": "plane", "name": "crate left"}
    assert faults(other, {"shape": "box", "name": "crate"}) == (f'object[1].name: {rule}; got "crate"',)


def test_boxes_that_cannot_be() -> None:
    assert faults({"shape": "box", "size": [1, 2]}) == ("object[0].size: must be a list of 3 numbers; got [1, 2]",)
    behind = "must leave part of the object in front of the lens (z > 0)"
    turned = {"shape": "box", "size": [8, 1, 1], "rotation": [0, 90, 0]}
    assert faults(turned | {"center": [0, 0, -4]}) == (f"object[0].center: {behind}; got [0, 0, -4]",)
    parse_scene({"object": [turned | {"center": [0, 0, -3.9]}]})
    rule = "must hold 1 to 64 objects, and a box is six"
    assert faults(*({"shape": "box"},) * 11) == (f"object: {rule}; got 66",)


def test_a_room_around_the_lens_has_no_wall_behind_it() -> None:
    room = box(size=[600.0, 400.0, 800.0], center=[0.0, 0.0, 100.0])
    assert [item.name for item in room.objects] == [f"box {side}" for side in SIDES if side != "front"]


def test_rotations_one_after_the_other() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        first, then = (tuple(rng.uniform(-360, 360, 3).tolist()) for _ in range(2))
        both = np.array(rotation_rows(after(first, then)))
        expected = np.array(rotation_rows(then)) @ np.array(rotation_rows(first))
        np.testing.assert_allclose(both, expected, rtol=0, atol=2e-15)
    assert after(None, None) is None
    assert after(ANY, None) == after(None, ANY) == ANY


def box_depth(size: Any, center: Any, turn: Any, shift: Any, rays: Any) -> tuple[Any, Any]:
    """Depth at which rays enter a box, by its slabs; infinite where they miss it, and the number of the face."""
    origin = -(np.asarray(center) + shift) @ turn
    way = rays @ turn
    half = 0.5 * np.asarray(size)
    one, two = (-half - origin) / way, (half - origin) / way
    first, last = np.minimum(one, two), np.maximum(one, two)
    enters = first.max(axis=1)
    axis = first.argmax(axis=1)
    low = np.take_along_axis(one < two, axis[:, None], axis=1)[:, 0]
    # front, back: -z, +z; left, right: -x, +x; top, bottom: +y, -y
    face = np.array([[3, 2], [4, 5], [1, 0]])[axis, low.astype(int)]
    hit = enters < last.min(axis=1)
    return np.where(hit, enters, np.inf), np.where(hit, face, -1)


@pytest.mark.parametrize("rotation", [None, (0.0, 0.0, 90.0), ANY], ids=["straight", "quarter", "any"])
@pytest.mark.parametrize("time", [0.0, 0.6])
def test_rays_enter_the_box_by_its_faces(rotation: Any, time: float) -> None:
    """Every ray, those through edges too: no gaps and nothing beside."""
    keys = {} if rotation is None else {"rotation": list(rotation)}
    size, center = (40.0, 30.0, 22.0), (39.0, -27.0, 280.0)
    scene = box(size=list(size), center=list(center), motion=MOTION, **keys)
    poses = poses_at(scene, time)
    surfaces = [place(item, pose) for item, pose in zip(scene.objects, poses, strict=True)]
    slopes = np.random.default_rng(3).uniform((0.0, -0.25), (0.3, 0.1), (20000, 2))
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    w, _, number = nearest_surface(surfaces, [item.bounds for item in scene.objects], everything(scene), rays)
    turn = poses[0].rotation @ np.array(rotation_rows(rotation))
    depth, face = box_depth(size, center, turn, poses[0].shift, rays)
    assert (face >= 0).sum() > 1000
    assert len(np.unique(face)) >= 3
    np.testing.assert_array_equal(number, face)
    np.testing.assert_allclose(w, 1.0 / depth, rtol=1e-12, atol=0)
    # Points of the edges and corners of a face, moved, from the lens: something is hit at their depth or before.
    t = np.linspace(-1.0, 1.0, 501)
    ends = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    edges = [np.insert(np.broadcast_to(end, (t.size, 2)), axis, t, axis=1) for axis in range(3) for end in ends]
    points = np.concatenate(edges) * 0.5 * np.asarray(size) @ turn.T + np.asarray(center) + poses[0].shift
    at = points / points[:, 2:]
    w, _, _ = nearest_surface(surfaces, [item.bounds for item in scene.objects], everything(scene), at)
    assert (w * points[:, 2] > 1.0 - 1e-12).all()


def test_a_box_takes_arrays() -> None:
    pixels = np.linspace(0.0, 1.0, 12, dtype=np.float32).reshape(3, 4)
    keys: dict[str, Any] = {"texture": pixels, "rotation": np.array([20.0, 30.0, 0.0])}
    scene = clsco.Scene(objects=(clsco.Box(**keys),))
    assert len({id(face.texture) for face in scene.objects}) == 1
    assert scene.objects[0].rotation == (20.0, 30.0, 0.0)
    front = scene.replace("object.0.size.0", 10.0).objects[0]
    assert isinstance(front, Rectangle)
    assert front.size == (10.0, 30.0)
